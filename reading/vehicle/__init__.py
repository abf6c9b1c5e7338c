"""Interpret a vehicle's pieces: axes, nose, moving parts, keypoints, and paint."""
