"""Pictures by hulldown replace only pictures by hulldown."""

import numpy as np
import pytest
from PIL import Image

from hulldown.annotate.sheets import refuse_foreign, save_sheet
from hulldown.geometry.errors import HulldownError
from hulldown.planning.summary import summarize

SHEET = Image.fromarray(np.zeros((4, 6, 3), np.uint8))


@pytest.mark.parametrize("write", [lambda path: save_sheet(SHEET, path), lambda path: summarize([]).draw(path)])
def test_foreign_files_are_not_replaced(tmp_path, write):
    path = tmp_path / "tank.png"
    SHEET.save(path)
    before = path.read_bytes()
    with pytest.raises(HulldownError, match=r"tank\.png: exists and wasn't drawn by hulldown; name another"):
        write(path)
    assert path.read_bytes() == before
    path.unlink()
    write(path)
    write(path)
    refuse_foreign(path)
    assert [found.name for found in tmp_path.iterdir()] == ["tank.png"]
