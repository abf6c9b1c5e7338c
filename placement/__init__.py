"""Positions and resting poses of vehicles on terrain (paper, section 2.1.5)."""
