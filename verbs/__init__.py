"""The verbs of the `hulldown` command: their arguments, what they show while they work, what they print."""
