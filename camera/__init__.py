"""Camera poses, framing, what a camera sees, and how the weather changes that (paper, section 2.1.6)."""
