"""A headless browser for pages by hulldown."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from selenium import webdriver
from selenium.webdriver.chrome.service import Service

BROWSERS, DRIVERS = ("chromium", "chromium-browser", "google-chrome"), ("chromedriver",)
QUIET = (
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-sync",
    "--disable-background-networking", "--disable-component-update", "--window-size=1200,900",
)  # fmt: skip


@contextmanager
def chromium(profile: Path) -> Iterator[webdriver.Chrome]:
    """A Chromium with an empty profile, without the network."""
    options = webdriver.ChromeOptions()
    options.binary_location = installed(BROWSERS)
    for flag in (*QUIET, f"--user-data-dir={profile}"):
        options.add_argument(flag)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    driver = webdriver.Chrome(options=options, service=Service(installed(DRIVERS)))
    try:
        yield driver
    finally:
        driver.quit()


def installed(names: tuple[str, ...]) -> str:
    """The first program of a list that exists.

    Raises
    ------
    FileNotFoundError
        With instructions. Page tests are never skipped.
    """
    for name in names:
        if path := shutil.which(name):
            return path
    raise FileNotFoundError(
        f"{names[0]} is not installed: `make browser` installs it on Debian and Ubuntu as root; "
        "elsewhere install Chromium and the chromedriver of its version"
    )
