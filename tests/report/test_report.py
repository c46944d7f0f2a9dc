"""The report is one file that fetches nothing, says what the summary says, and bears whatever it is given."""

import json
import re
import sys
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest

import jaxgrasp
from jaxgrasp.batch.contact_sets import ContactSets
from jaxgrasp.batch.engine import MethodResult, Times
from jaxgrasp.batch.summary import Summary, summarise
from jaxgrasp.model.solution import METHODS, Verdict
from jaxgrasp.report import bundle
from jaxgrasp.report.figures import verdict_bars
from jaxgrasp.report.grasp_in_3d import Case, scene
from jaxgrasp.report.look import number, percentage, share
from jaxgrasp.report.page import report_html, write_report
from jaxgrasp.report.sections import tiles
from jaxgrasp.report.worst_cases import DrawnCases, grasp_table_html, short_title
from tests.batch.conftest import make_sets

go = pytest.importorskip("plotly.graph_objects")

HOSTILE = "</script><img src=x onerror=alert(1)> & \"quoted\" 'too'"
TIMES = Times(2.5, dict.fromkeys(METHODS, 0.002), 10)


def contact_sets(count: int) -> ContactSets:
    """Return grasps of three contacts around a circle of 5 cm."""
    turn = 2 * np.pi * np.arange(3) / 3
    ring = np.column_stack([np.cos(turn), np.sin(turn), np.zeros(3)])
    return ContactSets(
        points=np.tile(0.05 * ring, (count, 1)),
        normals=np.tile(-ring, (count, 1)),
        friction=np.full(3 * count, 0.5),
        squeeze=np.full(3 * count, 2.0),
        offsets=3 * np.arange(count + 1),
        wrench=np.tile([0.0, 0, 1, 0, 0, 0], (count, 1, 1)),
        labels={"name": np.array([HOSTILE] * count)},
    )


def fake_result(sets: ContactSets, verdicts: list[Verdict], lift: float, objective: float) -> MethodResult:
    """Return a result in which every contact presses with 2 N and lifts with ``lift``."""
    forces = 2 * sets.normals[:, None] + lift * np.array([0, 0, 1.0])
    column = np.ones((len(sets), 1))
    return MethodResult(
        forces=forces,
        verdict=np.array(verdicts)[:, None],
        residual=1e-15 * column,
        objective=objective * column,
        steps=3 * column.astype(int),
        route=column.astype(int),
        certificate=np.zeros((len(sets), 1, 6)),
        force_bound=1e7 * column,
        margin=column * (np.arctan(0.5) - np.arctan2(lift, 2)),
        violation=column * max(0, lift - 1),
    )


def fake_summary(methods=tuple(METHODS), count: int = 10, **more) -> Summary:
    """Return the summary of ten grasps, of which six need friction and one is infeasible."""
    sets = contact_sets(count)
    slips, infeasible = np.arange(count) < 0.6 * count, np.arange(count) == count - 1
    closed = np.where(slips | infeasible, Verdict.OUTSIDE_CONES, Verdict.CLOSED_FORM_OPTIMAL)
    optimum = np.where(slips, Verdict.OPTIMAL, np.where(infeasible, Verdict.INFEASIBLE, Verdict.CLOSED_FORM_OPTIMAL))
    results = {
        name: fake_result(sets, optimum, 0.9, 4.0) if METHODS[name].constrained else fake_result(sets, closed, 3, 3.0)
        for name in methods
    }
    return summarise(sets, results, numbers=np.arange(len(sets)), **more)


def page(summary: Summary, **details) -> str:
    return report_html(summary, TIMES, title="A report", details=details)


class Tags(HTMLParser):
    """Collects tags with their attributes, and the text that a reader sees."""

    def __init__(self, html: str):
        super().__init__()
        self.tags, self.words, self._hidden = [], [], False
        self.feed(html)

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        self._hidden = tag in ("script", "style")

    def handle_endtag(self, tag):
        self._hidden = False

    def handle_data(self, data):
        if not self._hidden:
            self.words.append(data)


def stored_figures(html: str) -> list[dict]:
    """Return all figures of a page, as the browser would read them."""
    stored = [json.loads(t) for t in re.findall(r'<script type="application/json"[^>]*>(.*?)</script>', html, re.S)]
    return [figure for item in stored for figure in (item if isinstance(item, list) else [item])]


def test_nothing_is_fetched():
    html = page(fake_summary())
    for tag, attributes in Tags(html).tags:
        assert tag not in ("link", "img", "iframe", "object", "embed", "base", "audio", "video")
        assert not {"src", "href", "srcset", "data"} & set(attributes), tag
    assert "@import" not in bundle.asset("style.css")
    assert "url(" not in bundle.asset("style.css")
    assert "default-src 'none'" in html


def test_data_are_not_offered_to_a_cloud():
    script = bundle.asset("library.js")
    assert "showSendToCloud: false" in script
    assert 'plotlyServerURL: ""' in script


@pytest.fixture(scope="module")
def evaluation() -> jaxgrasp.Evaluation:
    """Return the evaluation of three grasps that hold, and of a fourth that would turn about its two contacts."""
    sets = make_sets([3, 5, 2, 4])
    sets.wrench[2] = [0, 0, 0, 0, 0, 5.0]
    sets = replace(sets, labels={"name": np.array([HOSTILE, "second", "third", "fourth"])})
    return jaxgrasp.evaluate(sets, quality=("least-singular-value",))


def page_of(evaluation: jaxgrasp.Evaluation) -> str:
    return report_html(evaluation.summary, evaluation.times, title="A report", details={}, rows=evaluation.table())


def test_which_grasps_are_good_comes_first_and_by_name(evaluation):
    html = page_of(evaluation)
    headings = re.findall(r"<h2>(.*?)</h2>", html)
    assert headings.index("Which grasps hold, and which are the best") < headings.index("Closed forms and their optima")
    words = Tags(html).words
    assert "3 of 4 grasps hold" in words
    assert "no torque about the line through its contacts" in words
    assert "By least-singular-value [of the grasp matrix]" in words and "least-singular-value" in words
    assert {"second", "third", "fourth", short_title(HOSTILE)} <= set(words)


def test_every_button_shows_a_grasp_that_is_drawn(evaluation):
    html = page_of(evaluation)
    scenes = json.loads(re.search(r'<script type="application/json" id="scenes">(.*?)</script>', html, re.S)[1])
    buttons = [attributes for tag, attributes in Tags(html).tags if attributes.get("class") == "pick"]
    assert len(scenes) == 4 and {int(button["data-case"]) for button in buttons} == set(range(4))
    panels = [attributes for tag, attributes in Tags(html).tags if attributes.get("class") == "panel"]
    assert [int(panel["data-case"]) for panel in panels] == list(range(4))
    for figure in scenes:
        go.Figure(figure)


def test_the_table_of_all_grasps_says_what_the_results_say(evaluation):
    html = page_of(evaluation)
    rows = re.search(r'<table id="grasps">(.*?)</table>', html, re.S)[1]
    assert re.findall(r'data-holds="(\w+)"', rows) == ["yes", "yes", "no", "yes"]
    for value in evaluation.table()["B.margin_deg"][[0, 1, 3]]:
        assert f'data-value="{value}"' in rows
    assert "<img" not in html.replace(bundle.plotly_bundle(), "")


def test_a_long_table_is_cut_and_says_so():
    rows = {
        name: np.repeat(column, 3000) for name, column in {"grasp": np.arange(1), "holds": np.array(["yes"])}.items()
    }
    html = grasp_table_html(rows, 3000, DrawnCases(False))
    assert html.count("<tr data-holds") == 2000 and "The first 2\u202f000 of 3\u202f000 rows" in html


def test_library_unpacks():
    from base64 import b64decode
    from gzip import decompress

    packed = re.search(r'<script type="text/plain" id="library">(.*?)</script>', page(fake_summary()), re.S)
    assert b"plotly.js" in decompress(b64decode(packed[1]))[:200]


def test_text_from_outside_is_escaped():
    html = report_html(fake_summary(), TIMES, title=HOSTILE, details={HOSTILE: HOSTILE})
    parsed = Tags(html)
    assert "img" not in {tag for tag, _ in parsed.tags}
    assert "<img" not in html.replace(bundle.plotly_bundle(), "")
    # The title twice, the name and the text of the detail, and each worst case by its name: drawn whole, offered and
    # listed without its middle.
    cases = len(fake_summary().worst)
    assert "".join(parsed.words).count(HOSTILE) == 4 + cases
    assert "".join(parsed.words).count(short_title(HOSTILE)) == 2 * cases


def test_embedded_data_cannot_end_its_script():
    assert "</script>" not in bundle.embedded("x", {"text": "</script><b>"}).removesuffix("</script>")


@pytest.mark.parametrize(
    "methods",
    [
        ("A",),
        ("B",),
        ("A-optimum",),
        ("B-optimum",),
        ("A", "B"),
        ("A-optimum", "B-optimum"),
        ("A", "A-optimum"),
        ("B", "A-optimum"),
    ],
    ids="+".join,
)
def test_any_methods_make_a_page(methods):
    summary = fake_summary(methods)
    for figure in stored_figures(page(summary)):
        go.Figure(figure)


def test_every_figure_is_one_that_plotly_knows():
    figures = stored_figures(page(fake_summary()))
    # Verdicts, three distributions, slip angles, and a scene for each worst case.
    assert len(figures) == 5 + len(fake_summary().worst)
    for figure in figures:
        go.Figure(figure)


def test_one_grasp_makes_a_page():
    html = page(fake_summary(count=1))
    assert "1 grasp with 3 contacts" in html
    assert "1 grasps" not in html


def test_no_worst_case_makes_a_page():
    html = page(replace(fake_summary(), worst=[]))
    assert 'id="scene"' not in html


def test_nothing_at_all_makes_a_page():
    empty = fake_summary()
    for method in empty.methods.values():
        method.verdicts[:], method.angles[:], method.steps, method.smallest_margin = 0, 0, 0, np.inf
    for comparison in empty.comparisons.values():
        comparison.compared = comparison.already_optimal = 0
        for histogram in (comparison.price, comparison.distance, comparison.violation):
            histogram.counts[:], histogram.zeros, histogram.largest = 0, 0, 0.0
    summary = replace(empty, grasps=0, contacts=0, problems=0, sizes=np.zeros(0, int), worst=[])
    html = report_html(summary, Times(), title="", details={})
    assert stored_figures(html) == []
    assert "nan" not in " ".join(Tags(html).words).lower().split()


def test_size_does_not_grow_with_the_data():
    summary = fake_summary()
    few = len(page(summary))
    for _ in range(17):
        summary = summary.merged(summary)
    assert summary.grasps > 1_000_000
    assert len(page(summary)) < few + 100_000


def test_tiles_say_what_the_summary_says():
    summary = fake_summary()
    tile_by_heading = {tile.heading: tile for tile in tiles(summary)}
    optimum, comparison = summary.methods["A-optimum"], summary.comparisons["B"]
    holds = optimum.count(Verdict.CLOSED_FORM_OPTIMAL, Verdict.OPTIMAL)
    assert (holds, comparison.compared, comparison.already_optimal) == (9, 9, 3)
    assert tile_by_heading["Hold with friction"].numbers == [("", "90.0%")]
    assert "9 of 10 grasps" in tile_by_heading["Hold with friction"].sentence
    assert tile_by_heading["Closed form B is right as it stands"].numbers[0][1] == share(3, 9)
    assert "3 of the 9 that hold" in tile_by_heading["Closed form B is right as it stands"].sentence
    assert tile_by_heading["Price of friction"].numbers[1][1].endswith("25%")
    assert percentage(comparison.price.largest) == "25%"
    assert [value for _, value in tile_by_heading["The closed form deceives"].numbers] == ["60.0%", "60.0%"]
    assert (
        "A: 6 though allowed forces exist, and 1 where none do" in tile_by_heading["The closed form deceives"].sentence
    )
    assert tile_by_heading["Cannot hold"].numbers == [("", "10.0%")]


def test_bars_add_up():
    figure = verdict_bars(fake_summary())
    assert np.allclose(np.sum([trace["x"] for trace in figure["data"]], axis=0), 100)


def test_set_aside_and_skipped_are_told():
    html = page(fake_summary(set_aside=4))
    assert "4 grasps set aside for faults" in html
    assert "3 (30.0%)" in html
    assert "Compiling took 2.5 s more" in html


def test_padding_is_told():
    html = report_html(fake_summary(), replace(TIMES, problems=16), title="", details={})
    assert "Timed on 16 problems, 6 of them padding" in html


def arrow_tips(figure: dict, legend: str) -> np.ndarray:
    """Return the tips of the arrows: the apexes of their cones."""
    heads = next(t for t in figure["data"] if t["type"] == "mesh3d" and t.get("legendgroup") == legend)
    corners = np.column_stack([heads[axis] for axis in "xyz"])
    # Each cone's triangles start from its apex, and for its base from the base's middle.
    return corners[np.unique(heads["i"])[::2]]


def test_arrows_are_forces_to_scale():
    case = Case(fake_summary().worst[0])
    tips = arrow_tips(scene(case), "closed form B")
    assert np.allclose(tips, case.points + case.closed * case.length / case.newtons, atol=1e-6)


def test_optimum_of_far_larger_forces_has_its_own_scale():
    data = fake_summary().worst[0]
    assert Case(data).newtons == Case(data).optimum_newtons
    larger = Case(data | {"optimum": (100 * np.array(data["optimum"])).tolist()})
    assert larger.optimum_newtons > 10 * larger.newtons
    assert f"= {number(larger.optimum_newtons)} N" in json.dumps(scene(larger))


def test_scene_bears_degenerate_grasps():
    data = fake_summary().worst[0]
    zeros = np.zeros((3, 3)).tolist()
    for change in (
        {"closed": zeros, "optimum": zeros, "wrench": [0.0] * 6},
        {"points": zeros},
        {"friction": [0.0, 0.5, 1e6]},
    ):
        go.Figure(json.loads(json.dumps(scene(Case(data | change)), allow_nan=False)))


def test_plotly_missing_is_one_line(monkeypatch, tmp_path):
    bundle.plotly_bundle.cache_clear()
    monkeypatch.setitem(sys.modules, "plotly.offline", None)
    with pytest.raises(
        ImportError, match=re.escape("the report needs plotly: pip install 'jaxgrasp[report]'")
    ) as caught:
        write_report(tmp_path / "report.html", fake_summary(), TIMES, title="", details={})
    assert "\n" not in str(caught.value)
    assert list(tmp_path.iterdir()) == []


def test_file_is_replaced_whole(tmp_path, monkeypatch):
    path = tmp_path / "report.html"
    write_report(path, fake_summary(), TIMES, title="first", details={})
    first = path.read_text(encoding="utf-8")
    assert "<h1>first</h1>" in first
    with monkeypatch.context() as broken:
        broken.setattr("os.fsync", lambda _: (_ for _ in ()).throw(OSError("disk full")))
        with pytest.raises(OSError, match="disk full"):
            write_report(path, fake_summary(), TIMES, title="second", details={})
    assert path.read_text(encoding="utf-8") == first
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize(
    ("value", "shown"),
    [
        (0, "0"),
        (1234.5, "1234"),
        (0.5, "0.5"),
        (100, "100"),
        (-0.25, "\N{MINUS SIGN}0.25"),
        (float("inf"), "∞"),
        (float("nan"), "\N{EN DASH}"),
    ],
)
def test_numbers_read_well(value, shown):
    assert number(value) == shown


def test_shares_are_never_rounded_to_all_or_nothing():
    assert share(0, 10**6) == "0%"
    assert share(1, 10**6) == "<0.1%"
    assert share(10**6 - 1, 10**6) == ">99.9%"
    assert share(5, 5) == "100%"
    assert percentage(0.99996) == "99.996%"
