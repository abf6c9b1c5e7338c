"""Boxes, silhouettes, keypoints, and masks: the geometry of labels, known before rendering (paper, section 2.1.7)."""
