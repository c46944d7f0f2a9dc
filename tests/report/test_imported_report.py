"""Reports of imported sets, whose names and labels are long: values stand beside them, and nothing is cut off."""

import re
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.browser import Browser
from jaxgrasp.batch.chunk_statistics import rank
from jaxgrasp.batch.reasons import Reason
from jaxgrasp.batch.summary import Summary, summarise
from jaxgrasp.model.solution import METHODS, Verdict
from tests.report.test_report import TIMES, contact_sets, fake_result
from tests.view.conftest import browser  # noqa: F401, a fixture

pytest.importorskip("plotly.graph_objects")
report = pytest.importorskip("jaxgrasp.report.page")

OBJECTS = ("core-mug-8570d9a8d24cb0acbebd3c0c0c70fb03", "sem-Bottle-437678d4bc6be981c8724d5673a063a6")
COUNT = 12
OVERFLOWING = """() => {
  const shown = [...document.querySelectorAll("main *")].filter((element) => element.offsetParent !== null);
  const words = (element) => element.className + ": " + element.innerText.slice(0, 60);
  const hides = (element) => getComputedStyle(element).overflowX !== "visible";
  return {
    scrolled: shown.filter((e) => e.matches(".scroll") && e.scrollWidth > e.clientWidth).map(words),
    clipped: shown.filter((e) => !e.matches(".scroll, .figure, .figure *") && hides(e) &&
      e.scrollWidth > e.clientWidth + 1).map(words),
    page: document.documentElement.scrollWidth - document.documentElement.clientWidth,
  };
}"""


def imported_summary() -> Summary:
    """Return a set of two objects, as importers name and label grasps, of which some need friction."""
    sets = contact_sets(COUNT)
    objects = [OBJECTS[k % 2] for k in range(COUNT)]
    sets.labels.update(
        name=np.array([f"{object_} {k}" for k, object_ in enumerate(objects)]),
        object=np.array(objects),
        source=np.array(["DexGraspNet"] * COUNT),
        hand=np.array(["shadow_hand_wrist_free"] * COUNT),
    )
    needs_friction = np.arange(COUNT) % 3 > 0
    closed = np.where(needs_friction, Verdict.OUTSIDE_CONES, Verdict.CLOSED_FORM_OPTIMAL)
    optimum = np.where(needs_friction, Verdict.OPTIMAL, Verdict.CLOSED_FORM_OPTIMAL)
    results = {
        name: fake_result(sets, optimum, 0.9, 4.0) if METHODS[name].constrained else fake_result(sets, closed, 3, 3.0)
        for name in METHODS
    }
    why = np.where(needs_friction, Reason.HARDER, Reason.HOLDS)[:, None]
    why[-2:] = Reason.FRICTION
    quality = {"force-closure.margin": np.linspace(-4.2e-4, 0.0844, COUNT), "min-weight.value": np.full(COUNT, 0.5)}
    factors = np.full((COUNT, 1), 1.74)
    ranked = rank(sets, results, why, quality, factors, np.arange(COUNT), factors)
    return replace(summarise(sets, results, numbers=np.arange(COUNT)), ranked=ranked)


def imported_page() -> str:
    values = np.linspace(-22.058157, 0.0069774, COUNT)
    measured = ("least_friction", "force-closure.closed", "force-closure.margin", "min-weight.value")
    numbers = ("A.margin_deg", "A.price", "B.margin_deg", "B.price", "squeeze_factor", *measured)
    rows = {
        "grasp": np.arange(COUNT),
        "name": np.array([f"{OBJECTS[k % 2]} {k}" for k in range(COUNT)]),
        "contacts": np.full(COUNT, 3),
        "holds": np.array(["harder"] * COUNT),
        "why": np.array(["holds if it squeezes harder"] * COUNT),
        **dict.fromkeys((*numbers, "ferrari-canny-l1.lower", "ferrari-canny-l1.upper"), values),
    }
    return report.report_html(imported_summary(), TIMES, title="imported.npz", details={}, rows=rows)


def test_labels_that_all_rows_share_stand_once_and_long_ones_lose_their_middle():
    table = re.search(r'<table class="overview">.*?</table>(.*?)</p>', imported_page(), re.S)
    assert "All have the source DexGraspNet. All have the hand shadow_hand_wrist_free." in table[1]
    assert "DexGraspNet" not in table[0].replace(table[1], "") and ">object</span>" in table[0]
    for object_ in OBJECTS:
        assert f'title="{object_}"' in table[0] and f">{object_}<" not in table[0]
        assert f"{object_[-20:]}</span>" in table[0]


@pytest.mark.slow
@pytest.mark.always
@pytest.mark.parametrize("width", [1280, 1600])
def test_values_are_seen_without_scrolling_and_nothing_is_clipped(browser: Browser, tmp_path, width):  # noqa: F811
    (tmp_path / "report.html").write_text(imported_page())
    browser.page.set_viewport_size({"width": width, "height": 820})
    browser.open((tmp_path / "report.html").as_uri())
    assert browser.page.locator("table.ranking").count() and browser.page.locator("table.overview").count()
    assert browser.page.evaluate(OVERFLOWING) == {"scrolled": [], "clipped": [], "page": 0}


@pytest.mark.slow
@pytest.mark.always
def test_names_stay_in_sight_where_the_table_is_wider_than_the_page(browser: Browser, tmp_path):  # noqa: F811
    (tmp_path / "report.html").write_text(imported_page())
    browser.page.set_viewport_size({"width": 700, "height": 820})
    browser.open((tmp_path / "report.html").as_uri())
    name = browser.page.locator("#grasps td.title").first
    box = browser.page.locator(".scroll.tall")
    box.evaluate("(element) => { element.scrollLeft = element.scrollWidth; }")
    assert box.evaluate("(element) => element.scrollLeft") > 200
    assert abs(name.bounding_box()["x"] - box.bounding_box()["x"]) < 2
