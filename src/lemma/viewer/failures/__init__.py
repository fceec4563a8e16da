"""The page of failures: episodes of results, each at the moment of its mistake."""
