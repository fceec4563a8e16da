"""Recipes: recorded episodes as Parquet, their generation and replay."""
