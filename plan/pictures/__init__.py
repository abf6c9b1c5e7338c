"""Pictures of a plan without Blender: previews and passes."""
