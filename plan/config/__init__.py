"""The config: its keys, its file, and the template that `hulldown init` writes."""
