"""Files of grasps from anywhere: whatever stands in a field, they are read, or refused by one line that names them."""

import json
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from jaxgrasp.interop import (
    hand_from_mujoco,
    load_mjcf,
    read_acronym,
    read_bodex,
    read_dexgraspbench,
    read_dexgraspnet,
    read_dexonomy,
    read_graspit,
)
from tests.cli.test_refused_files import VALUES, damaged, paths, replaced
from tests.interop.test_bodex import record as bodex_file
from tests.interop.test_dexgraspbench import grasp as dexgraspbench_file
from tests.interop.test_dexgraspnet import record as dexgraspnet_record
from tests.interop.test_dexonomy import balanced as dexonomy_file
from tests.interop.test_graspit import ORDER, world
from tests.interop.test_gripper_files import FORMATS, grasps
from tests.interop.two_fingers import JOINTS, model, pickled
from tests.turns import later

ARRAYS = (
    *(np.zeros(0), np.zeros((0, 3)), np.zeros((3, 3)), np.array("text"), np.array([None, 1], object)),
    *(np.full((1, 3, 4, 3), np.nan), np.array(1e308), np.array(True), np.zeros((2, 2, 2, 2, 2, 2)), b"bytes", 1j),
)


@pytest.fixture
def hand(folder):
    (folder / "hand.xml").write_text(model())
    return hand_from_mujoco(load_mjcf("hand.xml"), "palm").hand


def read_or_refused(read: Callable[[str], Any], path: str) -> None:
    try:
        with warnings.catch_warnings():
            # A replaced value may bring names of its own.
            warnings.filterwarnings("ignore", ".*fields that are not used", UserWarning)
            assert len(read(path)) >= 1
    except ValueError as error:
        assert str(error).startswith(path) and "\n" not in str(error) and len(str(error)) < 1200


def as_plain(name: str, hand: Any) -> tuple[Any, Callable[[str], Any]]:
    kinds = {
        "dexgraspnet": (dexgraspnet_record(0.1, 0.2), lambda path: read_dexgraspnet(path, JOINTS)),
        "dexgraspbench": (dexgraspbench_file(), lambda path: read_dexgraspbench(path, hand)),
        "dexonomy": (dexonomy_file(), read_dexonomy),
        "bodex": (bodex_file(), read_bodex),
    }
    return kinds[name]


@pytest.mark.parametrize("name", ["dexgraspnet", "dexgraspbench", *later("dexonomy", "bodex")])
def test_pickled_files(folder, hand, name):
    good, read = as_plain(name, hand)

    def write(content: Any) -> None:
        several = np.empty(1, object)
        several[0] = content
        np.save("file.npy", several, allow_pickle=True) if name == "dexgraspnet" else pickled("file.npy", content)

    write(good)
    assert len(read("file.npy")) >= 1
    original = Path("file.npy").read_bytes()
    for path in paths(good):
        for value in (*VALUES, *ARRAYS):
            write(replaced(good, path, value))
            read_or_refused(read, "file.npy")
    for content in damaged(original):
        Path("file.npy").write_bytes(content)
        read_or_refused(read, "file.npy")


@pytest.mark.parametrize("name", ["isaac-grasp", "graspgen"])
def test_files_of_text(folder, name):
    yaml = pytest.importorskip("yaml") if name == "isaac-grasp" else None
    file, write, read = FORMATS[name]
    write(folder / file, grasps()[:1], **({} if yaml else {"held": [True]}))
    original = Path(file).read_bytes()
    good = yaml.safe_load(original) if yaml else json.loads(original)
    assert len(read(file)) == 1
    for path in paths(good):
        for value in VALUES:
            content = replaced(good, path, value)
            Path(file).write_text(yaml.safe_dump(content) if yaml else json.dumps(content))
            read_or_refused(read, file)
    for content in damaged(original):
        Path(file).write_bytes(content)
        read_or_refused(read, file)


def test_worlds_of_graspit(folder, hand):
    for content in damaged(world().encode()):
        Path("file.xml").write_bytes(content)
        read_or_refused(lambda path: read_graspit(path, hand, ORDER), "file.xml")


def test_hdf5(folder):
    h5py = pytest.importorskip("h5py")
    file, write, read = FORMATS["acronym"]
    write(folder / file, grasps())
    original = Path(file).read_bytes()
    for content in damaged(original):
        Path(file).write_bytes(content)
        read_or_refused(read_acronym, file)
    for place in (
        "grasps/transforms",
        "object/file",
        "object/scale",
        "object/com",
        "grasps/qualities/flex/object_in_gripper",
    ):
        for value in (np.zeros(0), np.full((3, 3), np.nan), "text", [b"a", b"b"], 1e308, -1, None):
            Path(file).write_bytes(original)
            with h5py.File(file, "a") as changed:
                del changed[place]
                if value is not None:
                    changed[place] = value
            read_or_refused(read_acronym, file)
