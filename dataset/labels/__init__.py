"""Types of labels, one module each: the record fields, how they're computed, and their check. `types` lists them."""
