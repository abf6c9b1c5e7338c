"""What a vehicle and a scenery are once Blender has read them: plain arrays, and the bundle files that hold them."""
