"""HDRIs: checked, mended, and reported."""
