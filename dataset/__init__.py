"""COCO datasets on disk: records, journal, append, join, verify, split, overlay, exports (paper, section 2.1.7)."""
