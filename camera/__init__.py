"""Camera poses, framing, and what a camera sees (paper, section 2.1.6)."""
