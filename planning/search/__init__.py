"""The search for positions: candidates, clearance, cameras, and views, as batches of instances."""
