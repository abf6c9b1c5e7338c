"""The detectors that can be trained: RF-DETR and a small network."""
