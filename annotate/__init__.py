"""Boxes and masks: the geometry of labels, known before a pixel is rendered (paper, section 2.1.7)."""
