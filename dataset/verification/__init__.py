"""Check that a dataset's pictures and records show the same thing."""
