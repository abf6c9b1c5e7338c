"""Plans and datasets in notebooks."""

from __future__ import annotations

import os
from abc import abstractmethod
from base64 import b64encode
from functools import cached_property
from html import escape
from io import BytesIO
from typing import TYPE_CHECKING

from hulldown.base.errors import HulldownError

if TYPE_CHECKING:
    from PIL import Image


class ShownInNotebooks(os.PathLike[str]):
    """A result that notebooks show as its path, a table of facts, and a few pictures if they can be read."""

    @abstractmethod
    def _table_facts(self) -> dict[str, object]: ...

    @abstractmethod
    def _notebook_picture(self) -> Image.Image: ...

    @cached_property
    def _preview_png(self) -> bytes:
        file = BytesIO()
        self._notebook_picture().save(file, format="PNG")
        return file.getvalue()

    def _repr_html_(self) -> str:
        facts, image = self._table_facts(), ""
        try:
            image = f'<img src="data:image/png;base64,{b64encode(self._preview_png).decode()}">'
        except HulldownError as error:
            facts["no pictures"] = error
        rows = "".join(f"<tr><th>{escape(key)}</th><td>{escape(str(value))}</td></tr>" for key, value in facts.items())
        return f"<div><b>{escape(os.fspath(self))}</b><table>{rows}</table>{image}</div>"

    def _repr_png_(self) -> bytes | None:
        try:
            return self._preview_png
        except HulldownError:
            return None
