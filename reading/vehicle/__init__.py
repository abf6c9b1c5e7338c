"""What a vehicle's pieces are: its axes, its front, its moving parts, and its paint."""
