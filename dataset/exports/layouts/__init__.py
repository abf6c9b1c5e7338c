"""Layouts of an export: one module for each family of readers."""
