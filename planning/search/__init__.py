"""The search for positions: weather, candidates, clearance, cameras, and views, as batches of instances."""
