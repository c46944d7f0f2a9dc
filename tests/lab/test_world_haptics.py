"""A glove among several objects: what is rendered balances how each object goes, and what stands stays.

Accelerations are second differences of where the objects were; torques are the work of forces as joints turn.
"""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxgrasp.cli.main import main
from jaxgrasp.grip import Hold
from jaxgrasp.grip.scene_file import gripped_scene, load_scene, ready_scenes
from jaxgrasp.hand import Pose, Posture
from jaxgrasp.lab.grasp_and_lift import grasp_and_lift
from jaxgrasp.lab.haptic_loop import pose_at
from jaxgrasp.lab.world_haptics import WorldHaptics
from jaxgrasp.world import QuasiStaticEngine, world_of
from tests.lab.joint_work import MODEL, by_work

DT, UP, G = 0.01, 1.0, 9.81


def rise(k: int) -> float:
    """Return the height at tick ``k`` [m]: twenty ticks at rest, then constant acceleration."""
    return UP * (max(k - 20, 0) * DT) ** 2 / 2


def check_slope(haptics, slope, time, angles, wrist, stride):
    """Compare every ``stride``-th column of the slope with differences of torques at the same time."""
    for k in range(0, len(angles), stride):
        step = 1e-6 * np.eye(len(angles))[k]
        ahead, back = (haptics.tick(time, angles + by * step, wrist).torques for by in (1.0, -1.0))
        np.testing.assert_allclose(slope[:, k], (ahead - back) / 2e-6, atol=2e-5 * np.abs(slope).max())


@pytest.mark.slow
def test_a_ball_taken_off_a_stack_is_felt_with_its_weight_and_inertia():
    file = load_scene(ready_scenes()["stack"])
    made = gripped_scene(file)
    world, state = world_of(file, made)
    closed = np.asarray(made.closed.angles)
    haptics = WorldHaptics(world, MODEL, closed, state, QuasiStaticEngine(world, state), "optimum", 0.0)
    angles = closed[list(MODEL.joint_indices(made.scene.hand.joints))]
    origins, laws = [], []
    for k in range(50):
        laws.append(haptics.tick(k * DT, angles, pose_at(jnp.array([0.0, 0.0, rise(k)]))))
        origins.append(np.asarray(haptics.followed.placed.origin))
        assert laws[-1].is_valid
        if k == 10:
            early = np.asarray(haptics.share.exerted)[0], np.asarray(haptics.share.touches.contacts.points)[0]
    assert haptics.followed.time == pytest.approx(49 * DT)
    share, touches = haptics.share, haptics.share.touches
    assert share.assessment.hold.tolist() == [Hold.STABLE, Hold.LOST, Hold.LOST]
    np.testing.assert_allclose(origins[-1][1:], origins[0][1:], atol=1e-4)
    gained = (origins[-1] - 2 * origins[-2] + origins[-3])[0] / DT**2
    assert gained[2] == pytest.approx(UP, rel=1e-3)
    forces, points = np.asarray(share.exerted), np.asarray(touches.contacts.points)
    np.testing.assert_allclose(forces[0].sum(0), file.object.mass * (gained + [0, 0, G]), atol=1e-4)
    assert not forces[1:].any()
    posture = Posture(pose_at(jnp.array([0.0, 0.0, rise(49)])), closed)
    np.testing.assert_allclose(laws[-1].torques, by_work(made.scene.hand, posture, points[0], forces[0]), atol=1e-7)
    # At first the blocks bear what the squeeze, by its contributions, leaves of the weight.
    assert early[0].sum(0)[2] < file.object.mass * G - 0.01
    at_rest = Posture(pose_at(jnp.array([0.0, 0.0, rise(10)])), closed)
    np.testing.assert_allclose(laws[10].torques, by_work(made.scene.hand, at_rest, early[1], early[0]), atol=1e-7)
    check_slope(haptics, laws[-1].derivative, 49 * DT, angles, posture.wrist, stride=4)


@pytest.mark.slow
def test_soft_fingers_that_turn_a_ball_off_a_stack_feel_their_moments_too():
    """Lifted, then turned ever faster about the thumb's normal: Euler's law with couples, and the joints' work."""
    rate, torsion = 30.0, 0.01
    file = load_scene(ready_scenes()["stack"])
    made = gripped_scene(replace(file, object=replace(file.object, torsion=torsion)))
    world, state = world_of(file, made)
    closed = np.asarray(made.closed.angles)
    haptics = WorldHaptics(world, MODEL, closed, state, QuasiStaticEngine(world, state), "optimum", 0.0)
    angles = closed[list(MODEL.joint_indices(made.scene.hand.joints))]
    is_present = np.asarray(made.contacts.present) > 0
    thumbs = [link.finger == "thumb" for link in made.scene.hand.links]
    (thumb,) = np.flatnonzero(is_present & thumbs)
    axis, centre = np.asarray(made.contacts.normals)[thumb], np.asarray(made.placed.origin)

    def wrist(k: int) -> Pose:
        turn = Rotation.from_rotvec(axis * rate * (max(k - 40, 0) * DT) ** 2 / 2).as_matrix()
        start, up = made.closed.wrist, np.array([0.0, 0.0, 0.05 * min(k / 30, 1.0)])
        origin = centre + up + turn @ (np.asarray(start.origin) - centre)
        return Pose(jnp.asarray(origin), jnp.asarray(turn @ np.asarray(start.rotation)))

    is_present, turns, laws = [], [], []
    for k in range(56):
        laws.append(haptics.tick(k * DT, angles, wrist(k)))
        placed = haptics.followed.placed
        is_present.append(np.array(placed.origin[0]))
        turns.append(np.array(placed.rotation[0]))
    share, touches = haptics.share, haptics.share.touches
    assert share.assessment.hold[0] == Hold.STABLE and laws[-1].is_valid
    gained = (is_present[-1] - 2 * is_present[-2] + is_present[-3]) / DT**2
    spins = [Rotation.from_matrix(b @ a.T).as_rotvec() / DT for a, b in zip(turns[-3:], turns[-2:], strict=False)]
    inertia = 0.4 * file.object.mass * file.object.radius**2
    needed = np.append(file.object.mass * (gained + [0, 0, G]), inertia * (spins[1] - spins[0]) / DT)
    points, normals, forces, moments = (
        np.asarray(part)[0] for part in (touches.grasp.points, touches.grasp.normals, share.exerted, share.moments)
    )

    def exerted(moments: np.ndarray) -> np.ndarray:
        return np.append(forces.sum(0), np.cross(points, forces).sum(0) + moments @ normals)

    np.testing.assert_allclose(exerted(moments), needed, atol=1e-5)
    # The couples are no trifle: without them a balance of torques fails by far more than its rounding.
    assert np.abs(exerted(0 * moments) - needed).max() > 1e-4
    along = np.sum(normals * forces, -1)
    across = np.linalg.norm(forces - along[:, None] * normals, axis=-1)
    used = (across / file.object.friction) ** 2 + (moments / torsion) ** 2
    assert along.min() >= -1e-9 and np.max(used - along**2) < 1e-9
    posture, where = Posture(wrist(55), closed), np.asarray(touches.contacts.points)[0]
    couples = moments[:, None] * normals
    expected = by_work(made.scene.hand, posture, where, forces, couples)
    np.testing.assert_allclose(laws[-1].torques, expected, atol=1e-7)
    assert np.abs(by_work(made.scene.hand, posture, where, forces, 0 * couples) - expected).max() > 1e-5
    check_slope(haptics, laws[-1].derivative, 55 * DT, angles, posture.wrist, stride=5)


@pytest.mark.slow
def test_the_ready_stack_is_a_story_in_which_the_ball_is_lifted_and_stays(monkeypatch):
    """Closed, lifted, its cable cut and armed again: the ball goes with the wrist, its weight on the fingers."""
    file = load_scene(ready_scenes()["stack"])
    made = gripped_scene(file)
    world, state = world_of(file, made)
    closed = np.asarray(made.closed.angles)
    haptics = WorldHaptics(world, MODEL, closed, state, QuasiStaticEngine(world, state), made.law)
    forces, plain = [], haptics.tick

    def tick(*arguments):
        law = plain(*arguments)
        forces.append(np.asarray(haptics.share.exerted)[0].sum(0))
        return law

    monkeypatch.setattr(haptics, "tick", tick)
    story = grasp_and_lift(MODEL, scene=made, haptics=haptics)
    held = (story.ticks > 3.6) & (story.ticks < 4.0) | (story.ticks > 6.5)
    assert story.heights[held].min() > 0.09
    np.testing.assert_allclose(np.mean(np.array(forces)[held], 0), [0, 0, file.object.mass * G], atol=0.02)
    np.testing.assert_allclose(haptics.followed.placed.origin[1:], state.placed.origin[1:], atol=3e-3)


def test_a_grip_is_not_followed_among_several_objects(capsys):
    assert main(["glove", "run", "stack", "--follow-grip"]) == 1
    assert "follow-grip was given, and the scene has 2 tables [[other]]" in capsys.readouterr().err
