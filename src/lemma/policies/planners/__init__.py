"""Planners by name: language models behind chat servers, and rules without a model."""
