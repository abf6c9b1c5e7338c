"""What is known of a file's objects: their names, roles, and surfaces, the options for them, and the report."""
