"""The search for positions: candidates, clearance, cameras, and labels, as batches of instances."""
