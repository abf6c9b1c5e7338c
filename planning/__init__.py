"""How plans are made: inputs, the search for poses and cameras, light and paint (paper, sections 2.1.1 to 2.1.8)."""
