"""How a dataset is stored: journal, document, names, and ids."""
