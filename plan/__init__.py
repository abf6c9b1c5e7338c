"""The plan: its config, its rows on disk, the assets that it names, and what it shows without Blender."""
