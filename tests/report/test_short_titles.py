"""Names of imported sets are long and begin alike: what a report shows of them tells them apart."""

import pytest

from jaxgrasp.report.worst_cases import LONGEST_TITLE, pick, shared_start, short_title

IMPORTED = [
    f"dexgraspnet/core-mug-8012f52dd0a4d2f718a93a45bf780820/grasp {k:05d}, wrench {w}" for k in (7, 8) for w in (0, 1)
]


@pytest.mark.parametrize(
    "names", [IMPORTED, [f"{k:04d}-{'x' * 200}-{k}" for k in range(20)], ["mug", "box"], ["a" * 300]]
)
def test_short_titles_are_short_and_tell_all_apart(names):
    shown = [short_title(name, shared_start(names)) for name in names]
    assert len(set(shown)) == len(set(names)) and max(map(len, shown)) <= LONGEST_TITLE


def test_the_number_at_the_end_stays_and_the_shared_start_goes():
    start = shared_start(IMPORTED)
    assert start == "dexgraspnet/core-mug-8012f52dd0a4d2f718a93a45bf780820/grasp "
    assert short_title(IMPORTED[0], start) == "\N{HORIZONTAL ELLIPSIS}00007, wrench 0"
    assert short_title(IMPORTED[0]).endswith("grasp 00007, wrench 0")
    assert short_title("another", start) == "another"


@pytest.mark.parametrize("names", [[], ["only one"], ["mug 1", "mug 2"], ["same name twice"] * 2])
def test_short_starts_are_kept(names):
    assert shared_start(names) == ""


def test_a_button_has_the_whole_name_where_one_points():
    assert 'title="whole &lt;name&gt;"' in pick(0, "whole <name>", "short")
    assert "title=" not in pick(0, "mug")
