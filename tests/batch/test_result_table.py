"""The table of results says of each grasp, by its own name, what the arrays of results say."""

import csv
from dataclasses import replace

import numpy as np
import pytest

import jaxgrasp
from jaxgrasp.batch.result_table import table_columns, write_table
from jaxgrasp.batch.shards import arrays_of
from jaxgrasp.files.csv_rows import text_of_formula
from jaxgrasp.model.solution import Verdict
from tests.batch.conftest import make_sets

NAMES = np.array(["mug, left", 'a "cup"', "плошка", "=1+1"])


@pytest.fixture(scope="module", params=[1, 2], ids=["one wrench", "two wrenches"])
def evaluation(request):
    sets = make_sets([3, 5, 2, 4], wrenches=request.param)
    # The third cannot hold this.
    sets.wrench[2] = [0, 0, 0, 0, 0, 5.0]
    return jaxgrasp.evaluate(replace(sets, labels={"name": NAMES}))


def shard(evaluation) -> dict:
    return arrays_of(evaluation.sets, evaluation.results, evaluation.why, evaluation.numbers, evaluation.quality)


def test_a_row_for_each_grasp_and_wrench(evaluation):
    table = evaluation.table()
    wrenches = evaluation.sets.wrenches
    assert table["name"].tolist() == np.repeat(NAMES, wrenches).tolist()
    assert ("wrench" in table) == (wrenches > 1)
    for name, result in evaluation.results.items():
        verdicts = [Verdict[word] for word in table[f"{name}.verdict"]]
        assert verdicts == result.verdict.ravel().tolist()
        for row in range(len(verdicts)):
            grasp, wrench = divmod(row, wrenches)
            rows = slice(*evaluation.sets.offsets[grasp : grasp + 2])
            forces = result.forces[rows, wrench]
            if verdicts[row] == Verdict.INFEASIBLE:
                assert np.isnan(table[f"{name}.largest_force_N"][row])
            else:
                largest = max(np.linalg.norm(forces, axis=1))
                np.testing.assert_allclose(table[f"{name}.largest_force_N"][row], largest, rtol=1e-12)
    closed, optimum = (evaluation.results[name].objective.ravel() for name in ("B", "B-optimum"))
    priced = np.isin(evaluation.results["B-optimum"].verdict.ravel(), [Verdict.OPTIMAL])
    np.testing.assert_allclose(table["B.price"][priced], (1 - closed / optimum)[priced], atol=1e-12)
    assert table["holds"][2 * wrenches] == "no" and np.isnan(table["B.price"][2 * wrenches])


def test_csv_reads_back_to_the_last_digit(evaluation, tmp_path):
    write_table(tmp_path / "t.csv", [shard(evaluation)])
    with open(tmp_path / "t.csv", newline="", encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    for column, values in table_columns(shard(evaluation)).items():
        read = [row[column] for row in rows]
        if values.dtype.kind == "f":
            read = np.array([float(cell or "nan") for cell in read])
            np.testing.assert_array_equal(read, values)
        else:
            assert [text_of_formula(cell) for cell in read] == values.astype(str).tolist()


def test_parquet_holds_the_forces_of_each_row(evaluation, tmp_path):
    parquet = pytest.importorskip("pyarrow.parquet")
    write_table(tmp_path / "t.parquet", [shard(evaluation), shard(evaluation)])
    rows = parquet.read_table(tmp_path / "t.parquet").to_pylist()
    wrenches, count = evaluation.sets.wrenches, len(evaluation.sets)
    assert len(rows) == 2 * count * wrenches
    for number, row in enumerate(rows):
        grasp, wrench = divmod(number % (count * wrenches), wrenches)
        contact_rows = slice(*evaluation.sets.offsets[grasp : grasp + 2])
        assert row["name"] == NAMES[grasp]
        np.testing.assert_array_equal(
            row["A-optimum.forces"], evaluation.results["A-optimum"].forces[contact_rows, wrench]
        )


def test_a_missing_pyarrow_is_one_line_and_leaves_no_file(evaluation, tmp_path, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "pyarrow", None)
    with pytest.raises(ImportError, match=r"^Parquet files need pyarrow: pip install 'jaxgrasp\[table\]'$"):
        write_table(tmp_path / "t.parquet", [shard(evaluation)])
    assert not list(tmp_path.iterdir())


def test_an_evaluation_shows_itself_in_one_line(evaluation):
    assert repr(evaluation).startswith("Evaluation(4 grasps") and len(repr(evaluation)) < 150
    assert str(evaluation).count("\n") < 60 and "mug, left" in str(evaluation)


def test_the_ends_of_an_order_are_the_largest_and_smallest_values(evaluation):
    ranking = evaluation.summary.ranked.rankings["friction margin"]
    margin = np.where(evaluation.results["B"].verdict == Verdict.INFEASIBLE, np.nan, evaluation.results["B"].margin)
    assert ranking.best[0]["value"] == np.nanmax(margin)
    assert ranking.worst[0]["value"] == np.nanmin(margin)
    assert evaluation.sets.labels["name"][ranking.best[0]["grasp"]] == ranking.best[0]["labels"]["name"]
