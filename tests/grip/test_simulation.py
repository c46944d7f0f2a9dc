"""A hand takes an object up, holds it, and lets it go."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrasp.grip import CYLINDRICAL_POWER_GRIP, Body, Hold, Scene, simulate
from jaxgrasp.hand import Cylinder, Pose, Posture, close_hand, human_hand, link_contributions

pytestmark = pytest.mark.slow
HAND = human_hand()
SHAPE, MASS, DT = Cylinder(0.03, 0.12), 0.4, 0.01
ACROSS = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
"""Turns the cylinder's axis across the palm."""
GRAVITY = np.array([0.0, 0.0, -9.81])
START = Pose(jnp.array([0.085, 0.0, -0.0408]), jnp.asarray(ACROSS))
OPEN = np.array([0.6] + 18 * [0.0])


@pytest.fixture(scope="module")
def closed() -> Posture:
    posture, contacts = close_hand(HAND, Posture(Pose(np.zeros(3), np.eye(3)), OPEN), SHAPE, START, 1e-3)
    assert contacts.present.sum() >= 10
    return posture


def scene(friction: float = 0.6, table: float = -0.3) -> Scene:
    return Scene(
        HAND,
        Body(SHAPE, MASS),
        Pose(jnp.array([0.0, 0.0, table]), jnp.eye(3)),
        friction,
        1000.0,
        link_contributions(HAND, CYLINDRICAL_POWER_GRIP),
        jnp.asarray(GRAVITY),
    )


def about_x(angles: np.ndarray) -> np.ndarray:
    zero, unit = 0 * angles, 0 * angles + 1
    cosine, sine = np.cos(angles), np.sin(angles)
    rows = [[unit, zero, zero], [zero, cosine, -sine], [zero, sine, cosine]]
    return np.stack([np.stack(row, -1) for row in rows], -2)


def test_a_firm_grip_lifts_and_turns_the_object_with_the_hand(closed):
    count = 60
    fraction = np.linspace(0, 1, count)
    smooth = 3 * fraction**2 - 2 * fraction**3
    turn = about_x(0.5 * smooth)
    origin = np.stack([0 * smooth, 0 * smooth, 0.1 * smooth], -1)
    postures = Posture(Pose(origin, turn), np.broadcast_to(np.asarray(closed.angles), (count, 19)))
    record = simulate(scene(), postures, START, DT, law="optimum")
    assert {instant.hold for instant in record} == {Hold.STABLE}
    for instant, wrist, axes in zip(record, origin, turn, strict=True):
        np.testing.assert_allclose(instant.placed.origin, axes @ START.origin + wrist, atol=1e-9)
        np.testing.assert_allclose(instant.placed.rotation, axes @ START.rotation, atol=1e-9)
    # Balance: the optimum's forces hold the weight and accelerate the mass, the last time at rest.
    height = np.array([float(instant.placed.origin[2]) for instant in record])
    for k in range(1, count - 1):
        force = np.asarray(record[k].tick.assessment.forces).sum(0)[2]
        acceleration = (height[k + 1] - 2 * height[k] + height[k - 1]) / DT**2
        assert force == pytest.approx(MASS * (9.81 + acceleration), rel=1e-6)


def energy(record: list, k: int) -> float:
    """Compute the kinetic energy of translation between instants k and k + 1, and the gravitational energy left."""
    step = np.asarray(record[k + 1].placed.origin - record[k].placed.origin) / DT
    return MASS * step @ step / 2 - MASS * GRAVITY @ np.asarray(record[k + 1].placed.origin)


def test_after_release_energy_never_grows_and_the_table_stops_it(closed):
    count, release = 100, 20
    opening = np.clip((np.arange(count) - 10) / 10, 0, 1)[:, None]
    angles = np.asarray(closed.angles) * (1 - opening) + OPEN * opening
    # The hand goes up and lets go on the way.
    origin = np.zeros((count, 3))
    origin[:, 2] = 0.3 * DT * np.arange(count)
    postures = Posture(Pose(origin, np.broadcast_to(np.eye(3), (count, 3, 3))), angles)
    record = simulate(scene(), postures, START, DT, law="optimum")
    holds = [instant.hold for instant in record]
    assert holds[0] == Hold.STABLE and holds[-1] == Hold.LOST and record[-1].stands
    free = [k for k in range(release, count - 1) if holds[k] == Hold.LOST and not record[k + 1].stands]
    assert len(free) > 10
    energies = np.array([energy(record, k) for k in free])
    assert (np.diff(energies) <= 1e-12).all()
    assert float(record[-1].placed.origin[2]) == pytest.approx(-0.3 + 0.03, abs=5e-3)
    assert np.abs(record[-1].tick.torques).max() == 0


def test_without_friction_nothing_holds_it_along_its_axis(closed):
    """An upright cylinder falls through a hand that is closed around it, as if there were none."""
    count = 12
    upright = about_x(np.array(np.pi / 2))
    angles = np.broadcast_to(np.asarray(closed.angles), (count, 19))
    postures = Posture(Pose(np.zeros((count, 3)), np.broadcast_to(upright, (count, 3, 3))), angles)
    placed = Pose(upright @ START.origin, upright @ START.rotation)
    record = simulate(scene(friction=0.0, table=-10.0), postures, placed, DT, law="optimum")
    assert {instant.hold for instant in record} == {Hold.SLIPPING}
    drop = float(placed.origin[2]) - np.array([float(instant.placed.origin[2]) for instant in record])
    steps = np.arange(count)
    np.testing.assert_allclose(drop, 9.81 * DT**2 * steps * (steps + 1) / 2, atol=1e-6)


def test_time_must_go_forward(closed):
    posture = Posture(Pose(np.zeros((1, 3)), np.eye(3)[None]), np.asarray(closed.angles)[None])
    with pytest.raises(ValueError, match="dt is 0.0: expected a positive time"):
        simulate(scene(), posture, START, 0.0)


def test_postures_go_over_time(closed, unchecked):
    with pytest.raises(ValueError, match=r"postures.angles has shape \(19,\): expected \(T, J\), T instants"):
        simulate(scene(), closed, START, DT)


@pytest.mark.parametrize("law", ["optimum", "closed-form"])
def test_contacts_without_any_contribution_exert_nothing_and_the_object_falls(closed, law):
    without = dataclasses.replace(scene(), contributions=np.zeros(len(HAND.links)))
    count = 6
    postures = jax.tree.map(lambda leaf: np.broadcast_to(leaf, (count, *np.shape(leaf))), closed)
    record = simulate(without, postures, START, DT, law=law)
    assert all(np.isfinite(leaf).all() for instant in record for leaf in jax.tree.leaves(instant.placed))
    assert all(not np.any(instant.exerted) for instant in record)
    assert float(np.asarray(record[0].tick.contacts.present).sum()) >= 10
    # v_k = k g dt, and z_k is their sum
    steps = np.arange(count)
    heights = [float(instant.placed.origin[2]) for instant in record]
    np.testing.assert_allclose(heights, START.origin[2] + GRAVITY[2] * DT**2 * steps * (steps + 1) / 2, atol=1e-12)
