"""Types of labels, one module each: record fields, their computation, their check, and how they're drawn."""
