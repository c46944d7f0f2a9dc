"""An object in a glove's hand among table and boards: every tick obeys Newton's law, and springs give as they say."""

import itertools
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxgrasp.grip import Hold, simulate
from jaxgrasp.grip.motion import guide_at, height_above, spatial_inertia
from jaxgrasp.grip.scene_entries import ObjectEntry, ObstacleEntry, TableEntry
from jaxgrasp.grip.scene_file import SceneFile, gripped_scene, load_scene, ready_scenes
from jaxgrasp.hand import Box, Cylinder, Pose, Posture, Sphere
from jaxgrasp.lab.haptic_loop import Haptics, pose_at
from jaxgrasp.model.arrays import AnyArray
from tests.lab.joint_work import MODEL

pytestmark = pytest.mark.slow
DT, G = 0.01, np.array([0.0, 0.0, -9.81])


@pytest.fixture(scope="module")
def made():
    return gripped_scene(SceneFile())


def turned_about_x(degrees: float) -> np.ndarray:
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.array([[1.0, 0, 0], [0, c, -s], [0, s, c]])


@pytest.mark.parametrize(
    "shape", [Box(0.06, 0.05, 0.06), Cylinder(0.03, 0.07), Sphere(0.03)], ids=lambda s: type(s).__name__
)
def test_a_tilted_object_comes_to_rest_on_a_face_within_half_a_second(made, shape):
    """Let go on the table, at every tilt; no step gains energy, and nothing stays in the table."""
    scene = replace(made.scene, body=replace(made.scene.body, shape=shape))
    count, mass = 60, float(scene.body.mass)
    away = Pose(np.full((count, 3), 1.0), np.broadcast_to(np.eye(3), (count, 3, 3)))
    hand = Posture(away, np.broadcast_to(np.asarray(made.open), (count, len(made.open))))
    for degrees in (5, 20, 45):
        start = Pose(jnp.zeros(3), jnp.asarray(turned_about_x(degrees)))
        up = scene.table.origin[2] - height_above(Pose(jnp.zeros(3), jnp.eye(3)), shape, start)
        record = simulate(scene, hand, Pose(jnp.array([0.0, 0.0, up + 1e-4]), start.rotation), DT)
        turns = np.array([instant.placed.rotation for instant in record])
        origins = np.array([instant.placed.origin for instant in record])
        late = turns[50:]
        assert np.abs(late - late[-1]).max() < 1e-6 and np.abs(origins[50:] - origins[-1]).max() < 1e-6
        if not isinstance(shape, Sphere):
            assert np.abs(late[-1][2]).max() > np.cos(np.radians(0.1))
        assert record[-1].stands and float(height_above(scene.table, shape, record[-1].placed)) > -1e-5
        potential = -mass * origins @ G
        assert potential[-1] <= potential[0]


def played(haptics: Haptics, angles: AnyArray, wrist, count: int) -> tuple[np.ndarray, list]:
    """Tick; return the object's places, and for each the instant with the forces until the next."""
    places, instants = [], []
    for k in range(count):
        law = haptics.tick(k * DT, angles, pose_at(wrist(k * DT)))
        assert law.is_valid
        places.append(np.array(haptics.placed.origin))
        instants.append(haptics.instant)
    return np.array(places), instants[1:]


@pytest.mark.parametrize("law", ["optimum", "closed-form"])
@pytest.mark.parametrize("name", ["cylinder", "ball", "box"])
def test_every_tick_obeys_newtons_law_dragged_over_the_table_and_lifted(name, law):
    gripped = gripped_scene(load_scene(ready_scenes()[name]))
    haptics = Haptics(gripped.scene, MODEL, np.asarray(gripped.closed.angles), gripped.placed, law)
    angles = np.asarray(gripped.closed.angles)[list(MODEL.joint_indices(gripped.scene.hand.joints))] + 0.03

    def wrist(time: float) -> np.ndarray:
        return np.array([0.0, 0.05 * np.clip(time - 0.2, 0, 1), 0.05 * np.clip(time - 1.5, 0, 1)])

    places, instants = played(haptics, angles, wrist, 200)
    mass = float(gripped.scene.body.mass)
    for k in range(2, len(places) - 1):
        gained = (places[k + 1] - 2 * places[k] + places[k - 1]) / DT**2
        exerted = np.asarray(instants[k].exerted).sum(0) + np.asarray(instants[k].tick.support)[:3]
        np.testing.assert_allclose(exerted, mass * (gained - G), atol=1e-3)
    assert places[-1][2] - places[0][2] > 0.01 and places[120, 1] - places[0, 1] > 0.03


@pytest.mark.parametrize("law", ["optimum", "closed-form"])
@pytest.mark.parametrize("name", ["peg", "door_handle"])
def test_every_tick_obeys_newtons_law_in_a_hole_and_on_a_hinge(name, law):
    """M a is the wrench of all contacts and gravity; of a guide, its part along the motion that the guide allows."""
    gripped = gripped_scene(load_scene(ready_scenes()[name]))
    scene, weight = gripped.scene, float(gripped.scene.body.mass) * G
    haptics = Haptics(scene, MODEL, np.asarray(gripped.closed.angles), gripped.placed, law)
    angles = np.asarray(gripped.closed.angles)[list(MODEL.joint_indices(scene.hand.joints))] + 0.03

    def wrist(time: float) -> np.ndarray:
        return np.array([0.0, 0.05 * np.clip(time - 0.2, 0, 1), 0.05 * np.clip(time - 1.5, 0, 1)])

    _, instants = played(haptics, angles, wrist, 200)
    poses = [instant.placed for instant in instants]
    moved = np.array([np.concatenate([b.origin - a.origin, turn(a, b)]) for a, b in itertools.pairwise(poses)]) / DT
    for k in range(2, len(moved) - 1):
        instant, gained = instants[k], (moved[k] - moved[k - 1]) / DT
        tick, forces, at = instant.tick, np.asarray(instant.exerted), np.asarray(instant.tick.grasp.points)
        inertia = np.asarray(spatial_inertia(scene.body, instant.placed.rotation))
        by_hand = np.concatenate([forces.sum(0), np.cross(at, forces).sum(0)])
        if scene.guide is None:
            exerted = np.asarray(tick.inertial) + by_hand - np.asarray(tick.by_hand.wrench(tick.grasp))
            np.testing.assert_allclose(exerted[:3], (inertia @ gained)[:3], atol=1e-3)
        else:
            allowed = np.asarray(guide_at(scene.guide, instant.placed.origin))
            exerted = by_hand + np.asarray(tick.support) + np.append(weight, np.zeros(3))
            np.testing.assert_allclose(allowed.T @ exerted, allowed.T @ inertia @ gained, atol=1e-3)
    assert np.linalg.norm(poses[-1].origin - poses[0].origin) > 0.02


def turn(before: Pose, after: Pose) -> np.ndarray:
    return Rotation.from_matrix(np.asarray(after.rotation) @ np.asarray(before.rotation).T).as_rotvec()


@pytest.mark.parametrize("law", ["optimum", "closed-form"])
def test_what_squeezes_a_lying_object_is_felt(made, law):
    """The palm comes down on it: at rest the hand exerts what its springs press with, and the table bears the rest."""
    haptics = Haptics(made.scene, MODEL, np.asarray(made.closed.angles), made.placed, law)
    _, instants = played(haptics, np.zeros(14), lambda time: np.array([0, 0, -0.009 * min(time, 1.0)]), 200)
    last = instants[-1]
    grasp = last.tick.grasp
    pressed = np.asarray(grasp.squeeze * grasp.present) @ np.asarray(grasp.normals)
    exerted = np.asarray(last.exerted).sum(0)
    assert pressed[2] < -20.0 and exerted[2] == pytest.approx(pressed[2], rel=0.05)
    weight = float(made.scene.body.mass) * G
    np.testing.assert_allclose(np.asarray(last.tick.support)[:3], -exerted - weight, atol=1e-3)
    assert float(height_above(made.scene.table, made.scene.body.shape, last.placed)) > -1e-4


def test_a_board_that_rises_moves_the_object_as_the_hands_springs_say():
    """With friction enough, and a board low enough, that no contact slides: where some do, the hand is softer."""
    path = tuple((time, 0.0, 0.0, rise) for time, rise in ((0.0, 0.0), (0.2, 0.0), (0.7, 0.008), (1.5, 0.008)))
    board = ObstacleEntry(shape="box", size=(0.3, 0.3, 0.02), at=(0.0, 0.0, -0.045), path=path, touches_hand=False)
    gripped = gripped_scene(SceneFile(object=ObjectEntry(friction=5.0), table=TableEntry(below=0.5), obstacle=(board,)))
    haptics = Haptics(gripped.scene, MODEL, np.asarray(gripped.closed.angles), gripped.placed, "optimum")
    angles = np.asarray(gripped.closed.angles)[list(MODEL.joint_indices(gripped.scene.hand.joints))] + 0.06
    places, instants = played(haptics, angles, lambda time: np.zeros(3), 150)
    assert {instant.hold for instant in instants} == {Hold.STABLE}
    mass = float(gripped.scene.body.mass)
    expected, before = np.zeros(6), np.zeros(6)
    for instant in instants:
        points, stiffness = np.asarray(instant.tick.grasp.points), np.asarray(instant.tick.stiffness)
        # K = sum c K G G'
        matrices = [np.concatenate([np.eye(3), np.cross(np.eye(3), -p).T]) for p in points]
        spring = sum(k * m @ m.T for k, m in zip(stiffness, matrices, strict=True))
        load = np.append(mass * -G, np.zeros(3)) + np.asarray(instant.tick.inertial) - np.asarray(instant.tick.wrench)
        expected, before = expected + np.linalg.solve(spring, load - before), load
    assert load[2] > 8.0
    assert places[-1][2] - places[0][2] == pytest.approx(expected[2], rel=0.1)
