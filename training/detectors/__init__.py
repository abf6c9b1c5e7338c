"""Trainable detectors: RF-DETR and a small network."""
