"""Rows rendered by a Dask cluster."""
