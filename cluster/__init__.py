"""A Dask cluster for tasks of any stage."""
