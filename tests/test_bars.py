"""Progress bars on stderr."""

import io

from hulldown.geometry import terminal
from hulldown.geometry.terminal import Terminal, titled_bar


def test_a_bar_of_images_shows_workers_speed_and_remaining_time(monkeypatch):
    out, now = io.StringIO(), [0.0]
    console = Terminal(file=out, force_terminal=True, width=150, get_time=lambda: now[0])
    monkeypatch.setattr(terminal, "STDERR", console)
    with titled_bar(unit="images") as advance:
        advance("rendering on 1 worker", 10, 40)  # images of an earlier run, which don't count for the speed
        for finished in (11, 12):
            now[0] += 5.0
            advance("rendering on 2 workers", finished, 40)
    last = out.getvalue().splitlines()[-2]
    for shown in ("rendering on 2 workers", "12/40", "0.2 images/s", "0:02:20"):
        assert shown in last
