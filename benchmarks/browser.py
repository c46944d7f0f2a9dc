"""A real browser without a network: Chromium, headless, driven by playwright; for tests and for pictures of pages."""

import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
"""Its program; None where there is none."""
ARGUMENTS = [
    *("--no-sandbox", "--disable-gpu", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"),
    *("--disable-quic", "--no-first-run", "--disable-background-networking", "--disable-component-update"),
    # No name is found: what is not of this machine cannot be asked for.
    *("--disable-sync", "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1"),
]
SIZE = {"width": 1280, "height": 820}
PANEL = 400
"""Width of the words beside a scene [pixels]."""


class Browser:
    """A browser page with its requests and failures."""

    def __init__(self, page: Any):
        self.page = page
        self.failed: list[str] = []
        self.requests: list[str] = []
        self.errors: list[str] = []
        page.on("requestfailed", lambda request: self.failed.append(request.url))
        page.on("request", lambda request: self.requests.append(request.url))
        page.on("pageerror", lambda error: self.errors.append(str(error)))
        page.on("console", lambda message: self.errors.append(message.text) if message.type == "error" else None)

    def open(self, address: str) -> None:
        self.page.goto(address)
        self.page.wait_for_selector("canvas", timeout=60_000)

    def says(self, words: str) -> bool:
        """Return True where the words stand on the page."""
        return words in self.page.inner_text("body")

    def waits_for(self, condition: Callable[[], bool], seconds: float = 120.0) -> None:
        """Let the browser go on until something is so."""
        for _ in range(int(10 * seconds)):
            if condition():
                return
            self.page.wait_for_timeout(100)
        raise AssertionError(f"not so after {seconds:g} s")

    def close_notes(self) -> None:
        """Close the viewer's notes about drawing without a graphics card, which cover the scene."""
        for close in self.page.locator(".mantine-Notification-closeButton").all():
            close.click()
        self.page.wait_for_timeout(1000)


@contextmanager
def chromium(profile: Path) -> Iterator[Browser]:
    """Start Chromium with a profile of its own; ``CHROMIUM`` must be there, and playwright."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        started = playwright.chromium.launch_persistent_context(
            profile, executable_path=CHROMIUM, args=ARGUMENTS, viewport=SIZE
        )
        try:
            yield Browser(started.pages[0])
        finally:
            started.close()
