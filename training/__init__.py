"""Detectors trained on datasets of pictures and evaluated on photographs (paper, sections 2.2, 2.3 and 3)."""
