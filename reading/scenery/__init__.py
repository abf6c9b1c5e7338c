"""Classify a scenery's pieces: ground, water, obstacles, and sky."""
