"""Camera poses, framing, what a camera sees, and how its sensor and the weather change that (paper, section 2.1.6)."""
