"""A hand of two fingers that pinches a cube, and files as other projects pickle them."""

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

SAMPLES = Path(__file__).parents[3] / "shared" / "samples"
JOINTS = ("left", "right")
PALM = 0.034
"""Above the world of the model: as in hands whose first body does not stand where the file's root does."""
PINCH = (0.02, -0.02)
BELOW = np.array([0.0, 0.0, -0.06])
"""The palm, under a cube whose edge is 70 mm."""
SIZE = 0.07
HAND = """
<mujoco>
  <compiler angle="radian"/>
  <option {unknown}/>
  <asset>
    <texture name="skin" type="2d" file="skin.png"/>
    <material name="skin" texture="skin"/>
    <mesh name="shell" file="shell.obj"/>
  </asset>
  <worldbody>
    <body name="palm" pos="0 0 {height}">
      <geom type="box" size="0.05 0.02 0.01" material="skin"/>
      <geom type="mesh" mesh="shell"/>
      <body name="left finger" pos="-0.045 0 0">
        <joint name="left" axis="0 1 0" range="-1 1"/>
        <geom type="capsule" fromto="0 0 0 0 0 0.08" size="0.01"/>
      </body>
      <body name="right finger" pos="0.045 0 0">
        <joint name="right" axis="0 1 0" range="-1 1"/>
        <geom type="capsule" fromto="0 0 0 0 0 0.08" size="0.01"/>
      </body>
    </body>
  </worldbody>
</mujoco>
"""


def model(height: float = 0.0) -> str:
    """Return the MJCF text as data sets carry it: made for an older MuJoCo, without its pictures."""
    return HAND.format(unknown='apirate="200"', height=height)


def written(path: Path | str, *records: object) -> None:
    """Write a pickled array of records."""
    several = np.empty(len(records), object)
    several[:] = records
    np.save(path, several, allow_pickle=True)


def pickled(path: Path | str, record: object) -> None:
    """Write one pickled record."""
    alone = np.empty((), object)
    alone[()] = record
    np.save(path, alone, allow_pickle=True)


def seven(place: np.ndarray, turn: Rotation) -> np.ndarray:
    """Return x, y, z and the quaternion w, x, y, z."""
    return np.concatenate([place, np.roll(turn.as_quat(), 1)])


def matrix(place: np.ndarray, turn: Rotation) -> np.ndarray:
    transform = np.eye(4)
    transform[:3, :3], transform[:3, 3] = turn.as_matrix(), place
    return transform


def on_opposite_faces(points: np.ndarray, normals: np.ndarray, object_: np.ndarray, half: float = SIZE / 2) -> None:
    """Assert that contacts in the world lie in the middle of the cube's faces at both ends of its x axis, and press."""
    local = (points - object_[:3, 3]) @ object_[:3, :3]
    # The balls that the cube is made of leave out a little.
    np.testing.assert_allclose(np.abs(local[:, 0]), half, atol=1.5e-3)
    assert {-1.0, 1.0} == set(np.sign(local[:, 0]))
    # The fingers lie along the whole height: a palm that stood as much lower as PALM would show here.
    np.testing.assert_allclose(local[:, 2], 0, atol=5e-3)
    assert (np.sum(local * (normals @ object_[:3, :3]), -1) < 0).all()
