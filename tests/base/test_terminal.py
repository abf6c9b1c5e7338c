"""Progress bars on stderr."""

import io

from hulldown.base import terminal
from hulldown.base.terminal import Terminal, one_bar_for_all_titles, track_items


def test_a_bar_of_images_shows_workers_speed_and_remaining_time(monkeypatch):
    out, now = io.StringIO(), [0.0]
    console = Terminal(file=out, force_terminal=True, width=150, get_time=lambda: now[0])
    monkeypatch.setattr(terminal, "STDERR_TERMINAL", console)
    with one_bar_for_all_titles(unit="images") as advance:
        advance("rendering on 1 worker", 10, 40)  # images of an earlier run, which don't count for the speed
        for finished in (11, 12):
            now[0] += 5.0
            advance("rendering on 2 workers", finished, 40)
    last = out.getvalue().splitlines()[-2]
    for shown in ("rendering on 2 workers", "12/40", "0.2 images/s", "0:02:20"):
        assert shown in last


def test_tracked_items_move_a_bar_that_an_error_ends(monkeypatch):
    out = io.StringIO()
    monkeypatch.setattr(terminal, "STDERR_TERMINAL", Terminal(file=out, force_terminal=True, width=150))
    assert list(track_items("checking", iter("abc"), 3)) == ["a", "b", "c"]
    assert "3/3" in out.getvalue()
    try:
        for item in track_items("checking", [1, 0], 2):
            raise KeyError(item)
    except KeyError:
        assert "0/2" in out.getvalue()
        assert out.getvalue().endswith("\x1b[?25h")  # the cursor is shown again


def test_tracked_items_have_no_bar_in_a_file(monkeypatch):
    out = io.StringIO()
    monkeypatch.setattr(terminal, "STDERR_TERMINAL", Terminal(file=out))
    assert list(track_items("checking", "abc", 3)) == ["a", "b", "c"]
    assert out.getvalue() == ""
