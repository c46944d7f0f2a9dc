"""Hands out of URDF files: where the file itself puts their links, meshes as capsules, and errors that help."""

from importlib.metadata import PackageNotFoundError, files
from pathlib import Path
from xml.etree import ElementTree

import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrasp.hand import Pose, Posture, pose_hand
from jaxgrasp.interop import hand_from_urdf

pytest.importorskip("mujoco")

GRIPPER = """
<robot name="gripper">
  <link name="palm"><collision><geometry><box size="0.04 0.1 0.1"/></geometry></collision></link>
  <link name="tip">
    <visual><geometry><mesh filename="package://elsewhere/none.stl"/></geometry></visual>
    <collision><geometry><mesh filename="MESH" scale="0.001 0.001 0.001"/></geometry></collision>
  </link>
  <joint name="knuckle" type="revolute">
    <parent link="palm"/><child link="tip"/>
    <axis xyz="0 1 0"/><limit lower="0" upper="1.5" effort="1" velocity="1"/>
    <origin xyz="0 0 0.05"/>
  </joint>
</robot>
"""
MESH = "package://gripper/meshes/tip.obj"
SIDES = (20, 20, 60)


@pytest.fixture
def package(tmp_path) -> Path:
    """Return a folder that holds the mesh of a block [mm], to which a URDF is added."""
    package = tmp_path / "gripper"
    for folder in ("urdf", "meshes"):
        (package / folder).mkdir(parents=True)
    corners = np.array(SIDES) * (np.array(list(np.ndindex(2, 2, 2))) - 0.5)
    quads = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
    triangles = [corner for a, b, c, d in quads for corner in ((a, b, c), (a, c, d))]
    lines = [f"v {x} {y} {z}" for x, y, z in corners] + [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in triangles]
    (package / "meshes" / "tip.obj").write_text("\n".join(lines) + "\n")
    return package


def written(package: Path, text: str) -> Path:
    path = package / "urdf" / "gripper.urdf"
    path.write_text(text)
    return path


@pytest.mark.parametrize("mesh", [MESH, "../meshes/tip.obj", "file://"])
def test_a_mesh_becomes_a_capsule(package, mesh):
    if mesh == "file://":
        mesh += str(package / "meshes" / "tip.obj")
    hand = hand_from_urdf(written(package, GRIPPER.replace("MESH", mesh)), "palm", names={"tip": ("index", "distal")})
    assert hand.left_out == ()
    assert [link.name for link in hand.hand.links] == ["palm", "index distal"]
    # The palm's row is longer: this one is filled up with spheres of no size.
    used = np.asarray(hand.hand.skin.radii[1]) > 0
    centers, radii = np.asarray(hand.hand.skin.centers[1])[used], np.asarray(hand.hand.skin.radii[1])[used]
    assert len(radii) == 12
    np.testing.assert_allclose(radii, 0.01, rtol=1e-6)
    np.testing.assert_allclose(centers[:, :2], 0, atol=1e-9)
    # As long as the block, give or take half of what its round ends add.
    assert abs(np.ptp(centers[:, 2]) + 2 * radii[0] - 0.06) < radii[0]


def numbers(element, name: str, otherwise: str) -> np.ndarray:
    text = otherwise if element is None else element.get(name, otherwise)
    return np.array([float(word) for word in text.split()])


def turn(axis: np.ndarray, angle: float) -> np.ndarray:
    x, y, z = axis
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def frames_by_the_file(path: Path, root: str, angles: dict[str, float]) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Return the origin and rotation of every link, by the rules of URDF alone."""
    robot = ElementTree.parse(path).getroot()
    frames, waiting = {root: (np.zeros(3), np.eye(3))}, robot.findall("joint")
    while waiting:
        joint = waiting.pop(0)
        parent = joint.find("parent").get("link")
        if parent not in frames:
            waiting.append(joint)
            continue
        origin, rotation = frames[parent]
        place = joint.find("origin")
        roll, pitch, yaw = numbers(place, "rpy", "0 0 0")
        x, y, z = np.eye(3)
        fixed_turn = turn(z, yaw) @ turn(y, pitch) @ turn(x, roll)
        bent = turn(numbers(joint.find("axis"), "xyz", "1 0 0"), angles.get(joint.get("name"), 0.0))
        at = origin + rotation @ numbers(place, "xyz", "0 0 0")
        frames[joint.find("child").get("link")] = at, rotation @ fixed_turn @ bent
    return frames


def test_allegro_stands_where_its_file_puts_it():
    try:
        listed = files("example-robot-data") or []
    except PackageNotFoundError:
        pytest.skip("needs example-robot-data")
    for side in ("right", "left"):
        (path,) = [Path(file.locate()) for file in listed if file.name == f"allegro_{side}_hand.urdf"]
        hand_read = hand_from_urdf(path, "palm_link")
        hand = hand_read.hand
        assert (len(hand.joints), len(hand.links), hand_read.left_out) == (16, 21, ())
        lower, upper = np.asarray(hand.lower), np.asarray(hand.upper)
        angles = lower + np.random.default_rng(3).uniform(size=(5, 16)) * (upper - lower)
        frames = pose_hand(hand, Posture(Pose(jnp.zeros(3), jnp.eye(3)), angles))
        at = np.asarray(frames.links.origin) + np.einsum("blij,lj->bli", frames.links.rotation, hand_read.positions)
        turned = np.asarray(frames.links.rotation) @ hand_read.rotations
        for row, origins, rotations in zip(angles, at, turned, strict=True):
            expected = frames_by_the_file(path, "palm_link", dict(zip(hand.joints, row, strict=True)))
            for link, origin, rotation in zip(hand.links, origins, rotations, strict=True):
                np.testing.assert_allclose(origin, expected[link.name][0], atol=1e-9)
                np.testing.assert_allclose(rotation, expected[link.name][1], atol=1e-9)


@pytest.mark.parametrize(
    "text, message",
    [
        ("<robot", "path is '.*gripper.urdf': expected a URDF file, but it is not XML: "),
        ("<mujoco/>", "path is .* whose root is <robot>, not <mujoco>"),
        (
            GRIPPER.replace('type="revolute"', 'type="odd"'),
            "joint 'knuckle' has the type 'odd': expected one of revolute",
        ),
        (GRIPPER.replace("MESH", "a.stl"), "link 'tip' has the mesh 'a.stl': expected that file beside the URDF, but"),
        (
            GRIPPER.replace("MESH", "package://other/a.stl"),
            "link 'tip' has the mesh 'package://other/a.stl': expected that file below a folder 'other' that holds",
        ),
    ],
)
def test_files_that_cannot_be_read_are_refused(package, text, message):
    path = written(package, text.replace("MESH", MESH))
    with pytest.raises(ValueError, match=message) as caught:
        hand_from_urdf(path, "palm")
    assert "\n" not in str(caught.value)


def test_wrong_paths_and_names_are_refused(package):
    with pytest.raises(ValueError, match="path is 'none.urdf': expected a URDF file, but there is none"):
        hand_from_urdf("none.urdf", "palm")
    path = written(package, GRIPPER.replace("MESH", MESH))
    with pytest.raises(ValueError, match="wrist is 'elbow': the model has no body of that name"):
        hand_from_urdf(path, "elbow")
    (package / "meshes" / "empty.obj").write_text("nothing")
    with pytest.raises(ValueError, match="mesh '../meshes/empty.obj' of link 'tip': it holds no triangles"):
        hand_from_urdf(written(package, GRIPPER.replace("MESH", "../meshes/empty.obj")), "palm")
