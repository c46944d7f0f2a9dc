"""Every kind of file gives back the sets that were written, and refuses what is not one of them, in one line."""

import csv
import re
import sys
from dataclasses import replace

import numpy as np
import pytest

import jaxgrasp
from jaxgrasp.batch.contact_sets import ContactSets
from jaxgrasp.batch.csv_file import read_csv, write_csv
from jaxgrasp.batch.file_error import GraspFileError
from jaxgrasp.batch.sources import FORMATS, open_source
from tests.batch.conftest import make_sets

KINDS = pytest.mark.parametrize("ending", list(FORMATS))
NAMES = np.array(["mug, left", 'a "cup"', "плошка", ""])


def needs(ending: str) -> None:
    library = {".parquet": "pyarrow", ".h5": "h5py", ".hdf5": "h5py"}.get(ending)
    if library:
        pytest.importorskip(library)


def assert_same(read: ContactSets, written: ContactSets) -> None:
    for name, array in written.columns.items():
        np.testing.assert_array_equal(getattr(read, name), array, err_msg=name)
    np.testing.assert_array_equal(read.offsets, written.offsets)
    np.testing.assert_array_equal(read.wrench, written.wrench)
    assert set(read.columns) == set(written.columns) and set(read.labels) == set(written.labels)
    for name, values in written.labels.items():
        assert read.labels[name].tolist() == values.tolist()


def ragged(**more) -> ContactSets:
    sets = make_sets([3, 5, 2, 4])
    return replace(sets, labels={"name": NAMES, "object": np.array(["mug"] * 4)}, torsion=0.01 * sets.friction, **more)


@KINDS
@pytest.mark.parametrize("sizes", [(3, 5, 2, 4), (3, 3, 3, 3)], ids=["of several sizes", "of one size"])
def test_what_is_written_is_read_back(folder, ending, sizes):
    needs(ending)
    written = replace(make_sets(sizes), labels={"name": NAMES})
    jaxgrasp.save_grasps(f"grasps{ending}", written)
    assert_same(jaxgrasp.load_grasps(f"grasps{ending}"), written)
    with open_source(f"grasps{ending}") as source:
        parts = list(source.chunks(3))
    assert [len(part) for part in parts] == [3, 1]
    np.testing.assert_array_equal(np.concatenate([part.points for part in parts]), written.points)


@KINDS
def test_what_a_kind_cannot_hold_is_refused_before_anything_is_written(folder, ending):
    needs(ending)
    sets = ragged()
    maps = np.random.default_rng(0).normal(size=(len(sets.points), 4, 2))
    limited = replace(sets, torque_map=maps, torque_max=np.ones((4, 2)), wrench=np.repeat(sets.wrench, 2, axis=1))
    if ending == ".csv":
        with pytest.raises(ValueError, match="wrench has 2 wrenches a grasp: a CSV file holds one"):
            jaxgrasp.save_grasps("grasps.csv", limited)
        assert not list(folder.iterdir())
        return
    jaxgrasp.save_grasps(f"grasps{ending}", limited)
    read = jaxgrasp.load_grasps(f"grasps{ending}")
    assert_same(read, limited)
    np.testing.assert_array_equal(read.torque_max, limited.torque_max)


@pytest.mark.parametrize("name", ["grasps.json", "grasps", "grasps.npy"])
def test_other_endings_are_refused_by_name(folder, name):
    message = rf"{re.escape(name)}: its name ends in '.*': expected \.npz, \.csv, \.parquet, \.h5 or \.hdf5"
    with pytest.raises(GraspFileError, match=message):
        jaxgrasp.save_grasps(name, ragged())
    with pytest.raises(GraspFileError, match=message):
        jaxgrasp.load_grasps(name)


@pytest.mark.parametrize(("ending", "library"), [(".parquet", "pyarrow"), (".h5", "h5py")])
def test_a_missing_library_is_one_line_with_the_command(folder, monkeypatch, ending, library):
    monkeypatch.setitem(sys.modules, library, None)
    for call in (lambda: jaxgrasp.save_grasps(f"x{ending}", ragged()), lambda: jaxgrasp.load_grasps(f"x{ending}")):
        with pytest.raises(ImportError, match=rf"files need {library}: pip install 'jaxgrasp\[\w+\]'$"):
            call()
    assert not list(folder.iterdir())


@KINDS
def test_what_is_no_such_file_is_said_in_one_line(folder, ending):
    needs(ending)
    for content in (b"", b"nonsense\n", b"\x00" * 4096):
        (folder / f"bad{ending}").write_bytes(content)
        with pytest.raises(GraspFileError) as caught:
            jaxgrasp.load_grasps(f"bad{ending}")
        assert f"bad{ending}" in str(caught.value) and "\n" not in str(caught.value)
    with pytest.raises(FileNotFoundError):
        jaxgrasp.load_grasps(f"nowhere{ending}")


def test_grasps_of_a_csv_file_keep_their_names(folder):
    write_csv("grasps.csv", make_sets([2, 3]))
    assert "name" not in read_csv("grasps.csv").labels
    text = (folder / "grasps.csv").read_text().replace("\n0,", "\nleft,").replace("\n1,", "\nright,")
    (folder / "grasps.csv").write_text("# by hand\n" + text)
    assert read_csv("grasps.csv").labels["name"].tolist() == ["left", "right"]


@pytest.mark.parametrize("name", ["=1+1", "'=1+1", "''@x", "-2+3", "-1.5", "'cup'", "a\nb", "+"])
def test_names_in_a_csv_file_are_no_formulas_and_read_back(folder, name):
    sets = make_sets([2, 3])
    write_csv("grasps.csv", replace(sets, labels={"name": np.array([name, "other"])}))
    with open("grasps.csv", newline="", encoding="utf-8") as stream:
        cell = next(csv.DictReader(stream))["name"]
    assert cell == "-1.5" or not cell.startswith(("=", "+", "-", "@"))
    assert read_csv("grasps.csv").labels["name"].tolist() == [name, "other"]


def hdf5(path, **changed):
    h5py = pytest.importorskip("h5py")
    jaxgrasp.save_grasps(path, ragged())
    with h5py.File(path, "a") as file:
        for name, value in changed.items():
            del file[name]
            file[name] = value(h5py) if callable(value) else value


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"friction": np.ones(3)}, "friction has shape (3,): expected (14,), to fit points"),
        ({"friction": lambda h5py: h5py.ExternalLink("other.h5", "/x")}, "friction is a link: expected a data set"),
        ({"points": lambda h5py: h5py.SoftLink("/normals")}, "points is a link"),
        ({"wrench": np.array([b"text"] * 4)}, "wrench holds |S4: expected numbers"),
        ({"version": np.array(9)}, "its version is 9"),
    ],
    ids=["shape", "external link", "soft link", "text", "version"],
)
def test_hostile_hdf5_is_one_line(folder, changed, message):
    hdf5("bad.h5", **changed)
    with pytest.raises(GraspFileError, match=re.escape(message)):
        jaxgrasp.load_grasps("bad.h5")


def test_hdf5_that_claims_more_than_it_stores_takes_no_memory(folder):
    h5py = pytest.importorskip("h5py")
    jaxgrasp.save_grasps("bad.h5", ragged())
    with h5py.File("bad.h5", "a") as file:
        del file["points"]
        file.create_dataset("points", (10**12, 3), "f8", chunks=(1000, 3))
    with pytest.raises(GraspFileError, match="points of shape .* takes 24,000,000,000,000 bytes and stores 0"):
        jaxgrasp.load_grasps("bad.h5")


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"friction": [[1.0], [1.0, 1.0]]}, "friction[0] has 1 contacts: expected 2, as the others"),
        ({"friction": [None, [1.0, 1.0]]}, "friction has 1 empty cells"),
        ({"friction": [[1.0, None], [1.0, 1.0]]}, "friction holds double or empty cells: expected numbers"),
        ({"friction": [1.0, 1.0]}, "friction holds double: expected a list for each grasp"),
        ({"points": [[[1.0, 2.0], [1.0]], [[1.0], [2.0]]]}, "points holds lists of different lengths"),
        ({"wrench": [["a"] * 6] * 2}, "wrench holds string or empty cells: expected numbers"),
        ({"wrench": None}, "it lacks 'wrench'"),
    ],
    ids=str,
)
def test_hostile_parquet_is_one_line(folder, changed, message):
    arrow = pytest.importorskip("pyarrow")
    parquet = pytest.importorskip("pyarrow.parquet")
    jaxgrasp.save_grasps("bad.parquet", make_sets([2, 2]))
    table = parquet.read_table("bad.parquet")
    for name, values in changed.items():
        table = table.drop_columns([name])
        if values is not None:
            table = table.append_column(name, arrow.array(values))
    parquet.write_table(table, "bad.parquet")
    with pytest.raises(GraspFileError, match=re.escape(message)):
        jaxgrasp.load_grasps("bad.parquet")


@pytest.mark.parametrize(
    ("values", "message"),
    [
        (["x" * 100_000, "short"], "name holds text of 100,000 characters: expected 1,000 at most"),
        ([1, 2], "name holds int64: expected text"),
        ([b"\xff", b"a"], "name holds binary: expected text"),
        ([["a"], ["b"]], "name holds list<"),
    ],
    ids=["long", "numbers", "bytes", "lists"],
)
def test_names_in_parquet_are_text_of_bounded_length(folder, values, message):
    arrow = pytest.importorskip("pyarrow")
    parquet = pytest.importorskip("pyarrow.parquet")
    jaxgrasp.save_grasps("bad.parquet", make_sets([2, 2]))
    table = parquet.read_table("bad.parquet")
    table = table.drop_columns([name for name in table.column_names if name == "name"])
    parquet.write_table(table.append_column("name", arrow.array(values)), "bad.parquet")
    with pytest.raises(GraspFileError, match=re.escape(message)):
        jaxgrasp.load_grasps("bad.parquet")


def test_names_as_categories_and_columns_that_come_twice(folder):
    arrow = pytest.importorskip("pyarrow")
    parquet = pytest.importorskip("pyarrow.parquet")
    jaxgrasp.save_grasps("some.parquet", make_sets([2, 2]))
    table = parquet.read_table("some.parquet")
    table = table.drop_columns([name for name in table.column_names if name == "name"])
    named = table.append_column("name", arrow.array(["cup", "cup"]).dictionary_encode())
    parquet.write_table(named, "named.parquet")
    assert jaxgrasp.load_grasps("named.parquet").labels["name"].tolist() == ["cup", "cup"]
    twice = arrow.table([*table.columns, table["friction"]], names=[*table.column_names, "friction"])
    parquet.write_table(twice, "twice.parquet")
    with pytest.raises(GraspFileError, match="twice.parquet: it has the column 'friction' twice"):
        jaxgrasp.load_grasps("twice.parquet")
