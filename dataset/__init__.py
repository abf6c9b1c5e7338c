"""COCO datasets on disk: append, join, verify, report, split, export (paper, section 2.1.7)."""
