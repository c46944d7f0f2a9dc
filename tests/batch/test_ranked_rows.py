"""Ranking by any column: the order of the whole table, whatever its shards, and what is refused."""

import numpy as np
import pytest

import jaxgrasp
from jaxgrasp.batch.evaluation import evaluate
from jaxgrasp.batch.file_error import GraspFileError
from jaxgrasp.batch.result_table import ranked_rows
from jaxgrasp.batch.shards import ResultFolder
from jaxgrasp.batch.sources import MemorySource
from jaxgrasp.batch.stream import StreamPlan, evaluate_stream
from jaxgrasp.cli.main import main
from tests.batch.conftest import make_sets

SIZES = [3, 5, 2, 4, 5, 3]


@pytest.fixture(scope="module")
def sets():
    return make_sets(SIZES)


def test_rows_are_those_of_the_whole_table_in_order(sets, folder):
    source, plan = MemorySource(sets), StreamPlan(("B",), chunk=2, quality=("volume",))
    results = ResultFolder(folder, plan.identity("x", source), False)
    evaluate_stream(source, plan, results)
    expected = evaluate(sets, methods=("B",), quality=("volume",)).quality["volume.value"]
    rows = ranked_rows(folder, "volume", 4)
    np.testing.assert_array_equal(rows["grasp"], np.argsort(-expected, kind="stable")[:4])
    np.testing.assert_allclose(rows["volume.value"], np.sort(expected)[::-1][:4], rtol=1e-9)
    smallest = ranked_rows(folder, "volume.value", 100, smallest=True)
    np.testing.assert_array_equal(smallest["grasp"], np.argsort(expected, kind="stable"))
    with pytest.raises(GraspFileError, match=r"by is 'epsilon': expected one of B.margin_deg, .*volume.value"):
        ranked_rows(folder, "epsilon", 4)
    with pytest.raises(GraspFileError, match="by is 'why'"):
        ranked_rows(folder, "why", 4)


def test_the_command_lists_them_and_refuses_what_is_no_result(sets, folder, capsys):
    jaxgrasp.save_grasps(folder / "grasps.npz", sets)
    assert main(["rank", str(folder), "--by", "volume"]) == 1
    assert "it has no manifest.json: expected a folder that jaxgrasp evaluate wrote" in capsys.readouterr().err
    assert main(["evaluate", "grasps.npz", "--methods", "B", "--no-report", "--quality", "volume"]) == 0
    capsys.readouterr()
    assert main(["rank", "jaxgrasp-results", "--by", "volume", "--top", "2"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 3 and lines[0].split()[-1] == "volume.value"
    assert main(["rank", "jaxgrasp-results", "--by", "volume", "--top", "0"]) == 1
    assert "top is 0: expected 1 or more" in capsys.readouterr().err
