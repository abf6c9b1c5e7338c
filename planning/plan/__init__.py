"""The file format of plans."""
