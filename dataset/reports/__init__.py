"""A dataset or a plan as a page, charts, and sheets."""
