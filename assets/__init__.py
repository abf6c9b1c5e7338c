"""Vehicles, sceneries, and skies as plain arrays, and the files that hold them."""
