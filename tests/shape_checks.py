"""The checker of annotated types for jaxtyping's import hook; an int is a float, as for mypy (PEP 484)."""

from beartype import BeartypeConf, beartype

checked = beartype(conf=BeartypeConf(is_pep484_tower=True))
