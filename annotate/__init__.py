"""Labels: their fields, computation, check, and drawing, known before rendering (paper, section 2.1.7)."""
