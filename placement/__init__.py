"""Where a vehicle may stand on the terrain, and how it stands there (paper, section 2.1.5)."""
