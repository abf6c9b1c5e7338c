"""Boxes, masks and COCO files (paper, section 2.1.7)."""
