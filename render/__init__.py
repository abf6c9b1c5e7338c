"""Everything that needs Blender: reading .blend files, rendering planned poses. The only folder that imports bpy."""
