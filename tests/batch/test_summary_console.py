"""The console begins with what holds; statistics come when they are asked for, and small sets have small summaries."""

import json

import numpy as np
import pytest

import jaxgrasp
from jaxgrasp.batch.chunk_statistics import without_rounding
from jaxgrasp.batch.summary import from_json, to_json
from jaxgrasp.batch.summary_text import ranked_value, summary_text
from tests.batch.conftest import make_sets


@pytest.fixture(scope="module")
def evaluation():
    return jaxgrasp.evaluate(make_sets([3, 4, 5, 4, 3, 3]), quality=("force-closure", "least-singular-value"))


def test_statistics_come_with_the_details_alone(evaluation):
    long, short = (summary_text(evaluation.summary, evaluation.times, 1.0, details) for details in (True, False))
    assert short.splitlines()[2].startswith(f"{evaluation.summary.ranked.holds} of 6 grasps hold")
    for words in ("price of friction", "distance in force", "time per grasp", "found fast"):
        assert words in long and words not in short
    assert long.splitlines()[:3] == short.splitlines()[:3]


def test_values_that_grasps_are_ranked_by_have_units(evaluation):
    lines = summary_text(evaluation.summary, evaluation.times, 1.0, details=False).splitlines()
    ranked = [line for line in lines if line.startswith(("best by", "worst by"))]
    assert any(
        line.startswith("best by force-closure [margin, N of wrench per N of normal force]: ") for line in ranked
    )
    assert all("[" in line or " deg" in line for line in ranked) and len(ranked) >= 3


@pytest.mark.parametrize("value, shown", [(1e-15, "0"), (-1e-15, "0"), (1e-9, "1e-09"), (0.0718, "0.0718")])
def test_margins_of_rounding_are_zero(value, shown):
    assert ranked_value("force-closure", value) == shown
    assert without_rounding(value) == (0 if shown == "0" else value)


def test_the_summary_of_a_few_grasps_is_small_and_reads_back(evaluation):
    text = json.dumps(to_json(evaluation.summary))
    assert len(text) < 55_000  # zeros alone were 70 KB
    back = from_json(json.loads(text))
    assert json.dumps(to_json(back)) == text
    for name, method in evaluation.summary.methods.items():
        np.testing.assert_array_equal(back.methods[name].angles, method.angles)
        dense = json.loads(text)
        dense["methods"][name]["angles"] = method.angles.tolist()
        np.testing.assert_array_equal(from_json(dense).methods[name].angles, method.angles)
