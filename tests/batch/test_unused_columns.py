"""Columns of a table of grasps that no reader uses are named once, with the nearest known name where it is close."""

import csv
import re
import subprocess
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest

import jaxgrasp
from jaxgrasp import load_grasps, save_grasps
from jaxgrasp.batch.batch_evaluator import BatchEvaluator
from jaxgrasp.batch.csv_file import COLUMNS
from jaxgrasp.batch.file_error import GraspFileError, describe_unknown
from jaxgrasp.cli.main import main

ROOT = Path(__file__).parents[2]


@pytest.fixture
def table(folder) -> Path:
    """Return the template's grasps, with all columns that a CSV file may have."""
    assert main(["template", "csv", "--out", "grasps.csv"]) == 0
    sets = load_grasps("grasps.csv")
    labels = {name: [text] * len(sets) for name, text in (("source", "by hand"), ("object", "mug"), ("hand", "human"))}
    save_grasps("grasps.csv", sets, **labels)
    return folder / "grasps.csv"


def with_columns(path: Path, **columns: str) -> Path:
    """Write a table with more columns, of the same text in each row; None as text takes a column away."""
    with open(path, newline="") as stream:
        header, *rows = list(csv.reader(stream))
    kept = [k for k, name in enumerate(header) if columns.get(name, "") is not None]
    added = {name: text for name, text in columns.items() if text is not None}
    with open(changed := path.with_name("changed.csv"), "w", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow([*(header[k] for k in kept), *added])
        writer.writerows([*(row[k] for k in kept), *added.values()] for row in rows)
    return changed


def test_known_columns_and_labels_are_not_named(table):
    with open(table) as stream:
        assert {"grasp", "source", "object", "hand"} <= {*stream.readline().strip().split(",")} <= COLUMNS
    load_grasps(table)


@pytest.mark.parametrize(
    "columns, message",
    [
        ({"weight": "1"}, "weight"),
        ({"Normal_Min": "0.01"}, r"Normal_Min \(did you mean normal_min\?\)"),
        ({"normal_mx": "3", "note": "a"}, r"normal_mx \(did you mean normal_max\?\), note"),
        ({"p_x": "1"}, "p_x"),
        ({"": "", "a\x1b[2Jb": ""}, r"a\\x1b\[2Jb"),
    ],
)
def test_a_column_that_is_not_used_is_named_once(table, columns, message):
    changed = with_columns(table, **columns)
    with pytest.warns(UserWarning) as caught:
        sets = load_grasps(changed)
    assert len(caught) == 1
    assert re.fullmatch(f"{re.escape(str(changed))}: columns that are not used: {message}", str(caught[0].message))
    np.testing.assert_array_equal(sets.points, load_grasps(table).points)


def test_a_misspelled_column_that_is_needed_is_recognised(table):
    changed = with_columns(table, friction=None, frcition="0.5")
    with pytest.raises(
        GraspFileError, match=r"lacks the columns friction; it has frcition \(did you mean friction\?\)"
    ):
        load_grasps(changed)


@pytest.mark.parametrize("ending", ["npz", "parquet", "h5"])
def test_other_kinds_of_files_name_them_too(table, ending):
    pytest.importorskip({"npz": "numpy", "parquet": "pyarrow", "h5": "h5py"}[ending])
    path = table.with_name(f"grasps.{ending}")
    save_grasps(path, sets := load_grasps(table))
    load_grasps(path)
    add_column(path, "normal_mx", np.zeros(len(sets)))
    with pytest.warns(UserWarning, match=r"columns that are not used: normal_mx \(did you mean normal_max\?\)$"):
        load_grasps(path)


def test_the_shipped_grips_are_read_without_a_word_and_their_columns_in_other_files_are_named(folder):
    """The shipped file says how its grips were simulated; a user's mass or stiffness is not used."""
    shipped = Path(jaxgrasp.__file__).parent / "data" / "simulated_grips.npz"
    load_grasps(shipped)
    with np.load(shipped) as arrays:
        np.savez("partly.npz", **{name: array for name, array in arrays.items() if name != "seed"})
    with pytest.warns(UserWarning, match="stiffness.*mass"):
        load_grasps("partly.npz")


def add_column(path: Path, name: str, values: np.ndarray) -> None:
    if path.suffix == ".npz":
        with np.load(path) as file:
            arrays = dict(file)
        np.savez(path, **arrays, **{name: values})
    elif path.suffix == ".h5":
        import h5py

        with h5py.File(path, "a") as file:
            file[name] = values
    else:
        from pyarrow import array, parquet

        table = parquet.read_table(path).append_column(name, array(values))
        parquet.write_table(table.append_column("__index_level_0__", array(values)), path)


def test_batches_of_a_pipeline_keep_their_other_columns_in_silence(table):
    sets = load_grasps(table)
    padded = sets.padded(sets.largest)
    columns = {name: np.asarray(getattr(padded, name)) for name in ("points", "normals", "friction", "squeeze")}
    size = np.flatnonzero(sets.sizes == sets.largest)[:1]
    batch = {name: values[size] for name, values in columns.items()} | {"wrench": sets.wrench[size, 0], "id": size}
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        BatchEvaluator(methods=("B",))(batch)


def test_the_console_says_it_in_one_line_without_this_packages_code(table):
    changed = with_columns(table, weight="1")
    command = [sys.executable, "-m", "jaxgrasp.cli.main", "validate", str(changed)]
    finished = subprocess.run(command, capture_output=True, text=True, timeout=120, cwd=ROOT)
    assert finished.returncode == 0
    lines = [line for line in finished.stderr.splitlines() if "columns" in line]
    assert lines == [f"warning: {changed}: columns that are not used: weight"]


@pytest.mark.parametrize("name", sorted(COLUMNS))
def test_every_misspelled_column_of_four_letters_or_more_is_recognised(name):
    """Any two neighbours exchanged, of each column: the suggestion is the column that is missing."""
    misspelled = {name[:k] + name[k + 1] + name[k] + name[k + 2 :] for k in range(len(name) - 1)} - COLUMNS
    if len(name) < 4:
        return
    for wrong in misspelled:
        assert describe_unknown([*(COLUMNS - {name}), wrong], COLUMNS) == [f"{wrong} (did you mean {name}?)"]
