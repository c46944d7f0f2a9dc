"""The page in a real browser, whose network is blocked: it draws, it says, and its sliders move what it draws."""

import os
import threading
from pathlib import Path

import numpy as np
import pytest

from benchmarks.browser import PANEL, SIZE, Browser
from jaxgrasp.grip.monitor import Touch
from jaxgrasp.grip.scene_entries import TableEntry
from jaxgrasp.grip.scene_file import SceneFile, gripped_scene
from jaxgrasp.model.solution import Verdict
from jaxgrasp.report.look import METHOD_COLOURS, SKIN_COLOUR, TOUCH_COLOURS, VERDICT_TITLES
from jaxgrasp.view.live_page import LivePage
from jaxgrasp.view.live_scene import LiveHand
from jaxgrasp.view.viewer_server import serving
from tests.view.conftest import of_colour, picture_of

pytestmark = [pytest.mark.slow, pytest.mark.always]


@pytest.fixture(scope="module")
def hand() -> LiveHand:
    made = gripped_scene(SceneFile(table=TableEntry(below=0.4)))
    return LiveHand(made, "optimum")


@pytest.fixture
def screenshots(tmp_path) -> Path:
    """Return the folder in which screenshots are kept for a person to look at."""
    folder = Path(os.environ.get("JAXGRASP_TEST_SCREENSHOTS") or tmp_path)
    folder.mkdir(parents=True, exist_ok=True)
    return folder


@pytest.fixture
def page(hand):
    """Run a live page in a loop of its own."""
    over = threading.Event()
    with serving(port=0) as server:
        live = LivePage(server, hand)
        live.frame()
        loop = threading.Thread(target=live.run, args=(lambda: not over.is_set(),))
        loop.start()
        try:
            yield live, f"http://127.0.0.1:{server.get_port()}"
        finally:
            over.set()
            loop.join()


def drawn(browser: Browser, path: Path) -> np.ndarray:
    """Return the picture of the scene without the panel."""
    return picture_of(browser, path)[:, : SIZE["width"] - PANEL]


def test_the_live_hand_is_drawn_and_follows_its_sliders(browser, page, screenshots):
    live, address = page
    browser.open(address)
    browser.waits_for(lambda: of_colour(drawn(browser, screenshots / "live.png"), SKIN_COLOUR) > 10_000)
    # The browser may still be drawing what was sent first.
    browser.page.wait_for_timeout(2000)
    first = drawn(browser, screenshots / "live.png")
    for name in ("B", "B-optimum"):
        assert of_colour(first, METHOD_COLOURS[name]) > 100, name
    assert of_colour(first, TOUCH_COLOURS[Touch.HOLDS]) > 300
    assert browser.says("It holds, though the closed form slips")
    assert browser.says(VERDICT_TITLES[Verdict.OPTIMAL]) and browser.says(Verdict.OPTIMAL.advice)

    before = live.controls().friction
    number = browser.page.get_by_role("textbox").first
    number.fill("0")
    number.press("Enter")
    browser.waits_for(lambda: live.controls().friction == 0 != before)
    browser.waits_for(lambda: browser.says("It escapes: no forces hold it"))
    assert browser.says("Proven for forces of up to")
    picture = drawn(browser, screenshots / "escapes.png")
    assert of_colour(picture, METHOD_COLOURS["B-optimum"]) == 0
    # The object moves a little along its twist, to and fro.
    browser.waits_for(lambda: np.abs(drawn(browser, screenshots / "escapes.png") - picture).max() > 0.2)

    # A second browser sees the same; the first one leaves in the middle of a frame.
    second_page = browser.page.context.new_page()
    second_page.goto(address)
    second_page.wait_for_selector("canvas", timeout=60_000)
    browser.page.close()
    browser.page = second_page
    browser.waits_for(lambda: browser.says("It escapes: no forces hold it"))
    assert browser.failed == [] and browser.errors == []
    assert all(url.startswith((address, "blob:", "data:")) for url in browser.requests), browser.requests


def test_a_saved_page_opens_offline(browser, hand, screenshots):
    path = screenshots / "saved.html"
    with serving(port=0) as server:
        path.write_text(LivePage(server, hand).html())
    assert path.stat().st_size < 5e6
    browser.open(path.as_uri())
    browser.waits_for(lambda: of_colour(picture_of(browser, screenshots / "saved.png"), SKIN_COLOUR) > 10_000)
    picture = picture_of(browser, screenshots / "saved.png")
    assert of_colour(picture, METHOD_COLOURS["B-optimum"]) > 100
    assert browser.says("It holds, though the closed form slips") and browser.says("thumb distal")
    assert browser.failed == [] and browser.errors == []
    assert all(url.startswith(("file:", "blob:", "data:")) for url in browser.requests), browser.requests
