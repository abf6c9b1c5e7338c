"""How a dataset is stored: journal, document, names, ids, and seals."""
