"""Check, repair, and report HDRIs."""
