"""A whole dataset as a list of poses: config, budgets, the plan file, its preview (paper, sections 2.1.1 and 2.1.8)."""
