"""The scarcity study: the value of synthetic images when photographs are few (paper, sections 2.2, 3, and 4)."""
