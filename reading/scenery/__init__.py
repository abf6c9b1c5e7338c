"""What a scenery's pieces are: ground, water, obstacles, and sky."""
