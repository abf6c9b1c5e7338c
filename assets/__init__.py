"""Vehicles and sceneries as plain arrays, and the bundle files that store them."""
