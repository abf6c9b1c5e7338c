"""The scarcity study: what synthetic images are worth where real ones are few (paper, sections 2.2, 3 and 4)."""
