"""Sentences as vectors: vocabulary, encoders, paraphrases."""
