"""An object that stands: hand and table together balance it, and what the hand must carry grows as it leaves."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrasp.grip import Hold, observe
from jaxgrasp.grip.simulation import advance, initial_state
from jaxgrasp.grip.table_support import FADE, support_points
from jaxgrasp.hand import Box, Cylinder, Sphere, pose_hand
from jaxgrasp.lab.grasp_and_lift import cylinder_scene
from jaxgrasp.lab.haptic_loop import pose_at
from jaxgrasp.model.hand import Pose, Posture

UP = np.array([0.0, 0.0, 1.0])


@pytest.fixture(scope="module")
def scene():
    return cylinder_scene()


def raised(scene, by: float, law: str):
    made, closed, placed = scene
    step = jnp.array([0.0, 0.0, by])
    posture = Posture(pose_at(step), closed.angles)
    return observe(made, posture, Pose(placed.origin + step, placed.rotation), law=law)


def about_origin(points, forces) -> np.ndarray:
    points, forces = np.asarray(points), np.asarray(forces)
    return np.concatenate([forces.sum(0), np.cross(points, forces).sum(0)])


def turned(seed: int) -> np.ndarray:
    rotation, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    return rotation * np.sign(np.linalg.det(rotation))


@pytest.mark.parametrize(
    ("shape", "corners"),
    [
        (Box(0.04, 0.06, 0.1), [[x, y, -0.05] for x in (-0.02, 0.02) for y in (-0.03, 0.03)]),
        (Sphere(0.03), [[0.0, 0.0, -0.03]]),
        (Cylinder(0.03, 0.1), None),
    ],
)
def test_the_table_is_met_where_the_object_is_lowest(scene, shape, corners):
    """Faces at their corners, whatever way the table stands."""
    frame = turned(3)
    table = Pose(np.array([0.3, -0.2, 0.1]), frame)
    made = eqx.tree_at(lambda s: (s.body.shape, s.table), scene[0], (shape, table))
    placed = Pose(table.origin + frame @ [0.1, 0.2, 0.05], frame)
    points, heights = jax.device_get(support_points(made, placed))
    local = points @ frame
    if corners is None:
        np.testing.assert_allclose(local[:, 2], -0.05)
        np.testing.assert_allclose(np.linalg.norm(local[:, :2], axis=1), 0.03)
        np.testing.assert_allclose(local.sum(0)[:2], 0, atol=1e-12)
    else:
        assert all(min(np.linalg.norm(local - corner, axis=1)) < 2e-4 for corner in corners)
    np.testing.assert_allclose(heights, 0.05 + local[:, 2], atol=1e-12)


@pytest.mark.parametrize("friction", [-0.1, np.nan])
def test_a_friction_that_no_table_has_is_refused(scene, friction):
    made, closed, placed = scene
    with pytest.raises(ValueError, match=f"table_friction is {friction}: expected 0 or more"):
        observe(eqx.tree_at(lambda s: s.table_friction, made, friction), closed, placed)


@pytest.mark.slow
@pytest.mark.parametrize("law", ["closed-form", "optimum"])
def test_hand_and_table_balance_what_stands(scene, law):
    tick = raised(scene, 0.0, law)
    weight = np.append(-scene[0].body.mass * np.asarray(scene[0].gravity), np.zeros(3))
    together = about_origin(tick.grasp.points, tick.exerted) + np.asarray(tick.support)
    # By the closed form each contact is cut to its friction; what that leaves is little beside the weight.
    np.testing.assert_allclose(together, weight, atol=1e-8 if law == "optimum" else 1e-2)
    support = np.asarray(tick.support)
    assert support[2] > 0 and np.linalg.norm(support[:2]) <= scene[0].table_friction * support[2] + 1e-9
    # The table takes what comes, so that the hand comes closer to squeezing as it means to.
    grasp = tick.grasp
    intended = np.asarray(grasp.squeeze * grasp.present)[:, None] * np.asarray(grasp.normals)
    apart, alone = (np.linalg.norm(np.asarray(f) - intended) for f in (tick.exerted, tick.assessment.forces))
    assert apart < 0.5 * alone


@pytest.mark.slow
def test_what_the_hand_carries_grows_as_the_object_leaves(scene):
    heights = np.linspace(0, 1.2 * FADE, 13)
    ticks = [raised(scene, height, "optimum") for height in heights]
    carried = np.array([about_origin(t.grasp.points, t.exerted)[2] for t in ticks])
    weight = scene[0].body.mass * 9.81
    assert np.all(np.diff(carried[:11]) > 0) and np.all(np.abs(carried[11:] - weight) < 1e-9)
    # Nothing jumps: equal steps of height, nearly equal steps of force, and of every torque.
    assert np.ptp(np.diff(carried[:11])) < 0.05 * np.ptp(carried)
    torques = np.array([t.torques for t in ticks])
    assert np.abs(np.diff(torques, axis=0)).max() < 0.15 * np.ptp(torques, axis=0).max()
    for tick in ticks:
        together = about_origin(tick.grasp.points, tick.exerted) + np.asarray(tick.support)
        np.testing.assert_allclose(together[:3], weight * UP, atol=1e-8)


@pytest.mark.slow
def test_what_a_hand_does_not_hold_rests_where_it_can(scene):
    """Hardly touched, a heavy object stays on its table, which carries all of it; pulled sideways, only if there is
    friction."""
    made, closed, placed = scene
    frames = pose_hand(made.hand, closed)
    sideways = jnp.asarray(made.gravity) + 4.0 * jnp.asarray(placed.rotation)[:, 2]
    for gravity, friction, rests in (
        (jnp.asarray(made.gravity), 0.5, True),
        (sideways, 0.5, True),
        (sideways, 0.0, False),
    ):
        scene_asked = eqx.tree_at(
            lambda s: (s.body.mass, s.stiffness, s.gravity, s.table_friction), made, (10.0, 40.0, gravity, friction)
        )
        instant, moved = advance(
            scene_asked, 0.01, initial_state(scene_asked, placed), closed, frames, frames, law="closed-form"
        )
        assert instant.hold == Hold.SLIPPING and bool(instant.tick.rests) == rests
        distance = np.linalg.norm(np.asarray(moved.placed.origin) - np.asarray(placed.origin))
        assert (distance == 0) == rests
        if rests:
            squeezed = about_origin(instant.tick.grasp.points, instant.exerted)[2]
            assert float(instant.tick.support[2]) == pytest.approx(98.1 - squeezed, abs=0.02)


@pytest.mark.slow
def test_the_support_has_the_derivative_of_what_is_felt(scene):
    """Forward derivative of torques by angles while the object stands, against differences."""
    made, closed, placed = scene

    def torques(angles):
        return observe(made, Posture(closed.wrist, angles), placed, law="optimum").torques

    angles = jnp.asarray(closed.angles)
    tangent = jnp.asarray(np.random.default_rng(0).normal(size=angles.shape))
    _, forward = jax.jvp(torques, (angles,), (tangent,))
    step = 1e-6
    apart = (np.asarray(torques(angles + step * tangent)) - np.asarray(torques(angles - step * tangent))) / (2 * step)
    np.testing.assert_allclose(forward, apart, rtol=2e-4, atol=1e-5 * np.abs(apart).max())


@pytest.mark.slow
def test_a_contact_pushes_back_by_its_effective_stiffness(scene):
    """The squeezing force grows by the effective stiffness for each metre that the contact presses deeper."""
    made, closed, placed = scene
    stiffer = eqx.tree_at(
        lambda s: s.contributions, made, made.contributions * jnp.linspace(0.5, 2, len(made.contributions))
    )
    first, second = (
        observe(stiffer, closed, Pose(placed.origin + step, placed.rotation), law="closed-form")
        for step in (jnp.zeros(3), jnp.array([0.0, 1e-5, -2e-5]))
    )
    is_present = np.asarray(first.contacts.present * second.contacts.present) > 0
    deeper = np.asarray(second.contacts.depths - first.contacts.depths)[is_present]
    grown = np.asarray(second.grasp.squeeze - first.grasp.squeeze)[is_present]
    np.testing.assert_allclose(np.asarray(first.stiffness)[is_present] * deeper, grown, rtol=1e-9, atol=1e-12)
    assert is_present.sum() > 5 and np.abs(deeper).max() > 5e-6
    assert not np.asarray(first.stiffness)[np.asarray(first.contacts.present) == 0].any()
