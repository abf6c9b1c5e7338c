"""The verbs of the `hulldown` command: arguments, progress, and output."""
