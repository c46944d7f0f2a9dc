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
    """Return the site's folder, from ``JAXGRASP_TEST_SITE`` or built here; a broken reference is an error."""
    site_path = os.environ.get("JAXGRASP_TEST_SITE")
    if site_path:
        return (ROOT / site_path).resolve()
    for library in ("sphinx", "furo", "myst_nb", "latex2mathml"):
        pytest.importorskip(library, reason="the site needs the extra docs")
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "sphinx", "-q", "-W", "--keep-going", "-c", "docs", ".", str(folder)]
    built = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert built.returncode == 0, built.stderr
    return folder


@pytest.fixture(scope="module")
def pages(site) -> list[Path]:
    """Return all pages but those of the source code, and the one at the root, which only leads on."""
    html_files = [page for page in sorted(site.rglob("*.html")) if "_modules" not in page.parts]
    html_files.remove(site / "index.html")
    assert len(html_files) > 60
    return html_files


@pytest.fixture(scope="module")
def browser(tmp_path_factory) -> Iterator[Browser]:
    """Start Chromium, where it is installed."""
    pytest.importorskip("playwright.sync_api", reason="the browser is driven by playwright")
    if CHROMIUM is None:
        pytest.skip("there is no Chromium on this machine")
    with chromium(tmp_path_factory.mktemp("profile")) as started:
        yield started


def test_every_page_says_its_version(pages):
    version = re.search(r'^version = "(.*)"', (ROOT / "pyproject.toml").read_text(), re.M)[1]
    for page in pages:
        assert f"jaxgrasp {version}</title>" in page.read_text(), page


def public_names() -> list[tuple[str, str]]:
    """List every public name with its module."""
    rooms = (jaxgrasp, *(getattr(jaxgrasp, name) for name in jaxgrasp._ROOMS))
    return [(room.__name__, name) for room in rooms for name in room.__all__ if name not in jaxgrasp._ROOMS]


def test_every_public_name_has_one_entry_and_its_source(site):
    """On its room's page, or on that of a group in the room's folder."""
    reference = site / "docs" / "reference"
    for room, name in public_names():
        page = room.rpartition(".")[2]
        texts = [path.read_text() for path in (reference / f"{page}.html", *sorted((reference / page).glob("*.html")))]
        entries = [text for text in texts if f'id="{room}.{name}"' in text]
        assert len(entries) == 1, (room, name)
        assert "_modules/jaxgrasp/" in entries[0]


def test_every_public_name_has_a_line_in_the_index(site):
    text = (site / "docs" / "reference" / "index.html").read_text()
    rows = re.findall(r'<tr class="row-\w+"><td>(.*?)</td>\s*<td>(.*?)</td>', text, re.DOTALL)
    lines = {re.search(r'href="[^"]*#([\w.]+)"', name)[1]: re.sub("<.*?>", "", line).strip() for name, line in rows}
    assert sorted(lines) == sorted(f"{room}.{name}" for room, name in public_names())
    for name, line in lines.items():
        assert 10 < len(line) < 200 and "\n" not in line, name


def test_every_command_has_its_help_on_one_page_and_a_line_that_leads_there(site):
    reference = site / "docs" / "reference"
    overview = (reference / "command_line.html").read_text()
    links = re.findall(r'href="(command_line/\w+\.html)#([\w-]+)"><code[^>]*>(?:<span[^>]*>)?jaxgrasp', overview)
    assert len(links) > 30
    pages = {path: (reference / path).read_text() for path, _ in links}
    for path, anchor in links:
        assert [page for page, text in pages.items() if f'id="{anchor}"' in text] == [path], anchor


def test_links_have_titles(pages):
    for page in pages:
        texts = re.findall(r"<a [^>]*>(.*?)</a>", page.read_text(), re.DOTALL)
        named = [
            text for text in texts if re.fullmatch(r"[\w./-]+\.(md|ipynb|html)", re.sub("<.*?>", "", text).strip())
        ]
        assert not named, (page, named)


def test_every_page_names_its_copyright(pages):
    for page in pages:
        if page.name not in ("search.html", "genindex.html", "py-modindex.html"):
            assert re.search(r"Copyright &#169; \d{4}, the authors of jaxgrasp", page.read_text()), page


def test_no_page_of_the_reference_is_endless(site, browser):
    """But the index, which has a line for each name."""
    reference = site / "docs" / "reference"
    for page in sorted(set(reference.rglob("*.html")) - {reference / "index.html"}):
        browser.page.goto(page.as_uri())
        assert browser.page.evaluate("document.documentElement.scrollHeight") < 14_000, page


def test_no_page_asks_for_anything_from_elsewhere(site, pages, browser):
    browser.page.goto((site / "index.html").as_uri())
    # It leads on by itself: another page asked for meanwhile would cut that off.
    browser.page.wait_for_url((site / "docs" / "index.html").as_uri())
    for page in pages:
        browser.page.goto(page.as_uri())
    assert not browser.failed and not browser.errors
    assert {address.partition(":")[0] for address in browser.requests} <= {"file", "data"}


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
