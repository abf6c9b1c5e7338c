"""What tests of several modules share."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from tests.messy_export import Messy


@pytest.fixture(scope="session")
def messy(tmp_path_factory: pytest.TempPathFactory) -> Messy:
    """The messy files, built and exported once for the whole run."""
    from tests.messy_export import build  # not before a test asks: it needs most of the code

    return build(tmp_path_factory.mktemp("messy"))
