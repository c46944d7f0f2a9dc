"""Grasp files: what is written is read back, and everything that can be wrong with one is said clearly."""

import dataclasses
import os
import zipfile

import numpy as np
import pytest

import jaxgrasp
from jaxgrasp.batch.npz_file import open_npz
from jaxgrasp.batch.sources import Adjustments, open_source
from tests.batch.conftest import make_sets
from tests.batch.test_contact_sets import assert_same


def columns(sets, **changes) -> dict:
    names = ("points", "normals", "friction", "squeeze", "offsets")
    arrays = {name: getattr(sets, name) for name in names} | {"wrench": sets.wrench[:, 0]}
    return {name: array for name, array in (arrays | changes).items() if array is not None}


@pytest.mark.parametrize("suffix", ["npz", "csv"])
@pytest.mark.parametrize("sizes", [[3, 5, 2], [4, 4, 4]])
def test_round_trip(folder, suffix, sizes):
    sets = make_sets(sizes)
    names = np.array(["a, with comma", 'a "quote"', "plain"])
    jaxgrasp.save_grasps(f"set.{suffix}", sets, name=names)
    read = jaxgrasp.load_grasps(f"set.{suffix}")
    assert_same(read, sets)
    np.testing.assert_array_equal(read.labels["name"], names)
    assert os.listdir(folder) == [f"set.{suffix}"]


def test_many_wrenches_round_trip(folder):
    sets = make_sets([3, 4], wrenches=3)
    jaxgrasp.save_grasps("set.npz", sets)
    assert_same(jaxgrasp.load_grasps("set.npz"), sets)
    with pytest.raises(ValueError, match="3 wrenches a grasp"):
        jaxgrasp.save_grasps("set.csv", sets)


@pytest.mark.parametrize("sizes", [[3, 5, 2, 4, 4, 2, 1], [4] * 7])
@pytest.mark.parametrize("size", [1, 3, 100])
@pytest.mark.parametrize("start", [0, 2])
def test_chunks_are_the_whole(folder, sizes, size, start):
    sets = make_sets(sizes)
    jaxgrasp.save_grasps("set.npz", sets)
    with open_npz("set.npz") as source:
        parts = list(source.chunks(size, start))
    assert sum(map(len, parts)) == 7 - start
    for number, part in enumerate(parts):
        assert_same(part, sets.rows(slice(start + number * size, start + (number + 1) * size)))


def test_compressed_archives_and_integer_columns_are_read(folder):
    sets = make_sets([3, 3])
    np.savez_compressed("set.npz", **columns(sets, squeeze=np.arange(6), wrench=np.ones((2, 6), int)))
    read = jaxgrasp.load_grasps("set.npz")
    assert read.squeeze.dtype == np.float64
    np.testing.assert_array_equal(read.squeeze, np.arange(6))


def test_mixed_precision_is_read_in_the_finest(folder):
    sets = make_sets([3, 3])
    np.savez("set.npz", **columns(sets, friction=sets.friction.astype(np.float32)))
    assert jaxgrasp.load_grasps("set.npz").friction.dtype == np.float64
    single_precision = {name: a.astype(np.float32) for name, a in columns(sets, offsets=None).items()}
    np.savez("set.npz", offsets=sets.offsets, **single_precision)
    assert jaxgrasp.load_grasps("set.npz").points.dtype == np.float32


BAD = {
    "missing": ({"normals": None}, r"lacks 'normals' and holds points"),
    "missing friction": ({"friction": None}, r"lacks 'friction'.*--friction gives one value"),
    "shape": ({"normals": np.zeros((8, 2))}, r"normals has shape \(8, 2\): expected \(8, 3\)"),
    "short": ({"friction": np.ones(7)}, r"friction has shape \(7,\): expected \(8,\)"),
    "offsets end": ({"offsets": np.array([0, 3, 7])}, r"offsets\[2\] is 7: expected .* 0 to 8"),
    "offsets start": ({"offsets": np.array([1, 3, 8])}, r"offsets\[0\] is 1"),
    "offsets fall": ({"offsets": np.array([0, 9, 8])}, r"offsets\[2\] is 8"),
    "offsets kind": ({"offsets": np.array([0.0, 3, 8])}, r"offsets is float64"),
    "no offsets": ({"offsets": None}, r"points has shape \(8, 3\): expected \(N, n, 3\)"),
    "wrench": ({"wrench": np.zeros((3, 6))}, r"wrench has shape \(3, 6\): expected \(2, 6\)"),
    "text": ({"friction": np.array(["x"] * 8)}, r"friction holds <U1: expected numbers"),
    "version": ({"version": np.array(2)}, r"version is 2: this jaxgrasp reads version 1"),
    "labels": ({"name": np.array(["a"])}, r"name has shape \(1,\): expected \(2,\)"),
    "empty": (
        {name: np.zeros((0, 3)) for name in ("points", "normals")}
        | {name: np.zeros(0) for name in ("friction", "squeeze")}
        | {"offsets": np.zeros(1, int), "wrench": np.zeros((0, 6))},
        r"holds no grasps",
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_a_bad_file_says_what_is_wrong(folder, name):
    changes, message = BAD[name]
    np.savez("set.npz", **columns(make_sets([3, 5]), **changes))
    with pytest.raises(jaxgrasp.GraspFileError, match=message):
        jaxgrasp.load_grasps("set.npz")


def test_pickles_are_refused_unopened(folder):
    trap = np.array([Trap()] * 8, dtype=object)
    np.savez("set.npz", **columns(make_sets([3, 5]), friction=trap))
    with pytest.raises(jaxgrasp.GraspFileError, match="'friction' holds pickled objects"):
        jaxgrasp.load_grasps("set.npz")


class Trap:
    def __reduce__(self):
        return os.abort, ()


@pytest.mark.parametrize("keep", [0, 10, 500, -200])
def test_truncated_files_are_refused(folder, keep):
    jaxgrasp.save_grasps("set.npz", make_sets([3, 5]))
    data = (folder / "set.npz").read_bytes()
    (folder / "set.npz").write_bytes(data[:keep])
    with pytest.raises(jaxgrasp.GraspFileError, match=r"not a complete .npz archive"):
        jaxgrasp.load_grasps("set.npz")


def test_a_damaged_column_is_refused(folder):
    jaxgrasp.save_grasps("set.npz", make_sets([30, 50]))
    data = bytearray((folder / "set.npz").read_bytes())
    with zipfile.ZipFile("set.npz") as archive:
        inside = archive.getinfo("points.npy").header_offset + 600
    data[inside] ^= 0xFF
    (folder / "set.npz").write_bytes(data)
    with pytest.raises(jaxgrasp.GraspFileError, match=r"'points' .*CRC"):
        jaxgrasp.load_grasps("set.npz")


def test_a_column_shorter_than_it_claims_is_refused(folder):
    np.savez("set.npz", **columns(make_sets([3, 5])))
    with zipfile.ZipFile("set.npz") as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    members["friction.npy"] = members["friction.npy"][:-8]
    with zipfile.ZipFile("set.npz", "w") as archive:
        for name, data in members.items():
            archive.writestr(name, data)
    with pytest.raises(
        jaxgrasp.GraspFileError, match="'friction' of shape .* takes 64 bytes and has 56: the file is truncated"
    ):
        jaxgrasp.load_grasps("set.npz")


def test_other_files_and_folders_are_refused(folder):
    (folder / "set.npz").write_text("points, normals")
    with pytest.raises(jaxgrasp.GraspFileError, match="not a complete"):
        jaxgrasp.load_grasps("set.npz")
    with pytest.raises(jaxgrasp.GraspFileError, match="directory"):
        jaxgrasp.load_grasps(folder)
    with pytest.raises(FileNotFoundError):
        jaxgrasp.load_grasps("nowhere.npz")


def test_an_entry_that_is_not_usable_is_named(folder):
    sets = make_sets([3, 5])
    np.savez("set.npz", **columns(sets, friction=np.where(np.arange(8) == 4, -2, sets.friction)))
    with pytest.raises(jaxgrasp.GraspError, match=r"friction\[1, 1\] is -2.0: expected a finite number, zero or more"):
        jaxgrasp.load_grasps("set.npz")


def test_nothing_unusable_is_written(folder):
    sets = dataclasses.replace(make_sets([3]), friction=np.full(3, np.nan))
    with pytest.raises(jaxgrasp.GraspError):
        jaxgrasp.save_grasps("set.npz", sets)
    assert os.listdir(folder) == []


def test_a_failed_write_leaves_the_old_file(folder, monkeypatch):
    jaxgrasp.save_grasps("set.npz", make_sets([3]))
    before = (folder / "set.npz").read_bytes()
    monkeypatch.setattr(np, "savez", lambda stream, **_: stream.write(b"half") and 1 / 0)
    with pytest.raises(ZeroDivisionError):
        jaxgrasp.save_grasps("set.npz", make_sets([4]))
    assert (folder / "set.npz").read_bytes() == before
    assert os.listdir(folder) == ["set.npz"]


def test_missing_columns_are_filled_on_request(folder):
    sets = make_sets([3, 5])
    np.savez("set.npz", **columns(sets, friction=None, squeeze=None))
    adjustments = Adjustments(outward_normals=True, friction=0.5, squeeze=2.0)
    (read,) = open_source("set.npz", adjustments).chunks(10)
    read = adjustments.apply(read)
    assert np.all(read.friction == 0.5) and np.all(read.squeeze == 2)
    np.testing.assert_array_equal(read.normals, -sets.normals)


def test_millimetres_are_suspected(folder):
    sets = make_sets([3, 5])
    jaxgrasp.save_grasps("set.npz", dataclasses.replace(sets, points=1000 * sets.points))
    with pytest.warns(UserWarning, match="millimetres"):
        jaxgrasp.load_grasps("set.npz")


CSV = "grasp,px,py,pz,ax,ay,az,friction,squeeze,fx,fy,fz,tx,ty,tz\n"
ROW = "0,0.1,0,0,-1,0,0,0.5,2,0,0,1,0,0,0\n"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "lacks the columns grasp, px"),
        (CSV, "holds no grasps"),
        (CSV.replace("az,", "") + ROW, "lacks the columns az"),
        (CSV + ROW.replace("0.5", "half"), "line 2, column friction is 'half': expected a number"),
        (CSV + ROW.replace(",2,", ","), "line 2 has fewer cells"),
        (CSV + ROW.strip() + ",7\n", "line 2 has more cells"),
        (CSV + ROW + ROW.replace("0,0,1", "0,0,2"), "line 3 has another wrench"),
        (CSV + ROW + "1" + ROW[1:] + ROW, "line 4 returns to grasp '0'"),
    ],
)
def test_a_bad_csv_names_the_line(folder, text, message):
    (folder / "set.csv").write_text(text)
    with pytest.raises(jaxgrasp.GraspFileError, match=message):
        jaxgrasp.load_grasps("set.csv")


def test_the_line_of_a_fault_counts_blank_lines(folder):
    (folder / "set.csv").write_text(CSV + ROW + "\n\n" + ROW.replace("0.5", "half"))
    with pytest.raises(jaxgrasp.GraspFileError, match="line 5, column friction"):
        jaxgrasp.load_grasps("set.csv")


def test_other_encodings_are_refused(folder):
    (folder / "set.csv").write_bytes((CSV + ROW).replace("0.5", "\xe9").encode("latin-1"))
    with pytest.raises(jaxgrasp.GraspFileError, match="not CSV in UTF-8"):
        jaxgrasp.load_grasps("set.csv")


def test_any_memory_order_is_written(folder):
    sets = make_sets([3, 5])
    wrenches = np.asfortranarray(sets.wrench[:, 0])
    jaxgrasp.save_grasps("set.npz", dataclasses.replace(sets, points=np.asfortranarray(sets.points)), wrenches)
    assert_same(jaxgrasp.load_grasps("set.npz"), sets)


def test_given_wrenches_replace_those_of_the_sets(folder):
    jaxgrasp.save_grasps("set.npz", make_sets([3, 5]), np.ones((2, 6)))
    assert np.all(jaxgrasp.load_grasps("set.npz").wrench == 1)


@pytest.mark.parametrize(
    ("labels", "message"),
    [({"names": ["a", "b"]}, "label 'names' is unknown"), ({"name": ["a"]}, r"name has shape \(1,\): expected \(2,\)")],
)
def test_labels_are_checked(folder, unchecked, labels, message):
    with pytest.raises(ValueError, match=message):
        jaxgrasp.save_grasps("set.npz", make_sets([3, 5]), **labels)
    assert os.listdir(folder) == []


def test_damage_anywhere_in_a_compressed_file_is_one_clear_error(folder):
    np.savez_compressed("good.npz", version=1, **columns(make_sets([30, 50])))
    data = (folder / "good.npz").read_bytes()
    for place in range(0, len(data), 97):
        spoiled = bytearray(data)
        spoiled[place] ^= 0xFF
        (folder / "set.npz").write_bytes(spoiled)
        try:
            jaxgrasp.load_grasps("set.npz")
        except (jaxgrasp.GraspFileError, jaxgrasp.GraspError):
            pass
