"""Train detectors on datasets, and evaluate them on photographs (paper, sections 2.2, 2.3, and 3)."""
