"""The site: every page opens without a network and says its version, formulas are drawn, and search finds things."""

import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import jaxgrasp
from benchmarks.browser import CHROMIUM, Browser, chromium

ROOT = Path(__file__).parent.parent.parent
pytestmark = [pytest.mark.slow, pytest.mark.always]


@pytest.fixture(scope="module")
def site(tmp_path_factory) -> Path:
    """The site's folder: what ``JAXGRASP_TEST_SITE`` names, or built here, where a broken reference is an error."""
    given = os.environ.get("JAXGRASP_TEST_SITE")
    if given:
        return (ROOT / given).resolve()
    for library in ("sphinx", "furo", "myst_nb", "latex2mathml"):
        pytest.importorskip(library, reason="the site needs the extra docs")
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "sphinx", "-q", "-W", "--keep-going", "-c", "docs", ".", str(folder)]
    built = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert built.returncode == 0, built.stderr
    return folder


@pytest.fixture(scope="module")
def pages(site) -> list[Path]:
    """All pages but those of the source code, and the one at the root, which only leads on."""
    found = [page for page in sorted(site.rglob("*.html")) if "_modules" not in page.parts]
    found.remove(site / "index.html")
    assert len(found) > 60
    return found


@pytest.fixture(scope="module")
def browser(tmp_path_factory) -> Iterator[Browser]:
    """Chromium, where there is one."""
    pytest.importorskip("playwright.sync_api", reason="the browser is driven by playwright")
    if CHROMIUM is None:
        pytest.skip("there is no Chromium on this machine")
    with chromium(tmp_path_factory.mktemp("profile")) as started:
        yield started


def test_every_page_says_its_version(pages):
    version = re.search(r'^version = "(.*)"', (ROOT / "pyproject.toml").read_text(), re.M)[1]
    for page in pages:
        assert f"jaxgrasp {version}</title>" in page.read_text(), page


def test_every_public_name_has_its_entry_and_its_source(site):
    for room in (jaxgrasp, *(getattr(jaxgrasp, name) for name in jaxgrasp._ROOMS)):
        text = (site / "docs" / "reference" / f"{room.__name__.rpartition('.')[2]}.html").read_text()
        for name in room.__all__:
            if name not in jaxgrasp._ROOMS:
                assert f'id="{room.__name__}.{name}"' in text, name
        assert "_modules/jaxgrasp/" in text


def test_no_page_asks_for_anything_from_elsewhere(site, pages, browser):
    browser.page.goto((site / "index.html").as_uri())
    # It leads on by itself: another page asked for meanwhile would cut that off.
    browser.page.wait_for_url((site / "docs" / "index.html").as_uri())
    for page in pages:
        browser.page.goto(page.as_uri())
    assert not browser.failed and not browser.errors
    assert {address.partition(":")[0] for address in browser.asked} <= {"file", "data"}


def test_formulas_are_drawn(site, browser):
    """A fraction is taller than a letter: the browser lays it out."""
    browser.page.goto((site / "docs" / "mathematics.html").as_uri())
    heights = "(all) => all.map((one) => one.getBoundingClientRect().height)"
    fractions = browser.page.eval_on_selector_all("math mfrac", heights)
    letters = browser.page.eval_on_selector_all("math mi", heights)
    assert fractions and min(fractions) > 1.3 * sorted(letters)[len(letters) // 2] > 0


def test_search_finds_a_function_and_a_verdict(site, browser):
    for words, page in (("wrench_margin", "reference/jaxgrasp"), ("infeasible", "reference/outcomes")):
        browser.page.goto(f"{(site / 'search.html').as_uri()}?q={words}")
        # Results come one after the other.
        browser.waits_for(lambda page=page: browser.page.locator(f'#search-results li a[href*="{page}"]').count(), 20)
