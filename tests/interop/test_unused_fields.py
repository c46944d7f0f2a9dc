"""Fields of other projects' files that no reader uses are named, once for all files of a kind."""

import json
import warnings

import numpy as np
import pytest

from jaxgrasp.interop.acronym import read_acronym
from jaxgrasp.interop.graspgen import read_graspgen

h5py = pytest.importorskip("h5py")


def write_acronym(path, **more):
    with h5py.File(path, "w") as file:
        file["grasps/transforms"] = np.eye(4)[None]
        file["object/inertia"] = np.eye(3)
        for name, value in more.items():
            file[name] = value
    return path


def write_graspgen(path, **more):
    whole = {"object": {"file": "mug.obj", "scale": 1.0}, "grasps": {"transforms": [np.eye(4).tolist()], **more}}
    path.write_text(json.dumps(whole))
    return path


@pytest.mark.parametrize(
    "read, write, file, kind, name",
    [
        (read_acronym, write_acronym, "mug.h5", "ACRONYM", "object_pose"),
        (read_graspgen, write_graspgen, "mug.json", "GraspGen", "grasps.confidence"),
    ],
)
def test_a_field_that_is_not_used_is_named(tmp_path, read, write, file, kind, name):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        read(write(tmp_path / file))
    with pytest.warns(UserWarning, match=f"^{kind}: fields that are not used: {name}$"):
        read(write(tmp_path / file, **{name.removeprefix("grasps."): [1.0]}))
