"""Vehicles, sceneries, skies, and photographs as plain arrays, and the files that hold them."""
