"""A real browser without a network, and what colours it draws."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from benchmarks.browser import CHROMIUM, Browser, chromium


@pytest.fixture
def browser(tmp_path) -> Iterator[Browser]:
    """Start Chromium, where it is installed."""
    pytest.importorskip("playwright.sync_api", reason="the browser is driven by playwright")
    pytest.importorskip("viser", reason="the live scene needs viser")
    if CHROMIUM is None:
        pytest.skip("there is no Chromium on this machine")
    with chromium(tmp_path / "profile") as started:
        yield started


def picture_of(browser: Browser, path: Path) -> np.ndarray:
    """Take and keep a screenshot; return its pixels ``(height, width, 3)`` from 0 to 1."""
    from matplotlib.image import imread

    browser.page.screenshot(path=path)
    return imread(path)[..., :3]


def of_colour(picture: np.ndarray, colour: str) -> int:
    """Count the pixels of a colour, in whatever light."""
    rgb = np.array([int(colour[k : k + 2], 16) for k in (1, 3, 5)]) / 255
    (hue, strength), (hues, strengths) = _hue(rgb), _hue(picture.reshape(-1, 3))
    return int(((hues @ hue > 0.98) & (strengths > 0.35 * strength)).sum())


def _hue(colours: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Split colours into the direction of their hue and their distance from grey."""
    apart = colours - colours.min(-1, keepdims=True)
    strength = np.linalg.norm(apart, axis=-1)
    return apart / np.where(strength > 0, strength, 1)[..., None], strength
