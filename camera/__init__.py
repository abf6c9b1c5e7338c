"""Where the camera stands, what it frames and what it sees (paper, section 2.1.6)."""
