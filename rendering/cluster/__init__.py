"""Render rows on a Dask cluster."""
