"""Objects on a rail and on a hinge: the hand balances, and moves, what the guide leaves free."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxgrasp import Body, Box, Hold, Pose, Posture, Scene, Verdict, carry, close_hand, parallel_jaw
from jaxgrasp.prehension.motion import Motion, guide_at, mobility, moved, spatial_inertia

CUBE, MASS, DT = Box(0.07, 0.07, 0.07), 0.3, 0.01
GRAVITY = np.array([0.0, 0.0, -9.81])
RAIL = np.eye(6)[:, 2:3]
HINGE = np.eye(6)[:, 3:4]
RNG = np.random.default_rng(3)
BODY = Body(CUBE, MASS)


def anywhere() -> Pose:
    return Pose(jnp.asarray(RNG.normal(size=3)), jnp.asarray(Rotation.random(rng=RNG).as_matrix()))


def test_a_guide_is_the_same_about_any_point():
    """A point of the body moves with one velocity, wherever the twist is written."""
    guide, origin, point = RNG.normal(size=(6, 3)), RNG.normal(size=3), RNG.normal(size=3)
    there = np.asarray(guide_at(guide, origin))
    about_world = guide[:3] + np.cross(guide[3:], point, axis=0, axisb=0, axisc=0)
    about_origin = there[:3] + np.cross(there[3:], point - origin, axis=0, axisb=0, axisc=0)
    np.testing.assert_allclose(about_origin, about_world, atol=1e-14)


def test_an_impulse_moves_a_guided_body_along_its_guide_alone():
    """By the least kinetic energy that does the impulse's work (Gauss)."""
    placed, guide = anywhere(), RNG.normal(size=(6, 2))
    impulse = RNG.normal(size=6)
    free, inertia = np.asarray(guide_at(guide, placed.origin)), np.asarray(spatial_inertia(BODY, placed.rotation))
    motion = np.asarray(mobility(BODY, placed, guide)) @ impulse
    np.testing.assert_allclose(np.linalg.lstsq(free, motion, rcond=None)[1], 0, atol=1e-20)
    np.testing.assert_allclose(free.T @ (inertia @ motion - impulse), 0, atol=1e-12)
    doubled = np.concatenate([guide, guide @ [[1.0], [2.0]]], 1)
    np.testing.assert_allclose(mobility(BODY, placed, doubled) @ impulse, motion, rtol=1e-9)
    np.testing.assert_allclose(mobility(BODY, placed, None) @ impulse, np.linalg.solve(inertia, impulse), rtol=1e-10)


def test_a_body_never_leaves_its_hinge():
    placed = anywhere()
    free = np.asarray(guide_at(HINGE, placed.origin))[:, 0]
    motion = Motion(jnp.asarray(2.0 * free[:3]), jnp.asarray(2.0 * free[3:]))
    turned, going = moved(placed, motion, 0.4, HINGE)
    turn = Rotation.from_rotvec([0.8, 0, 0]).as_matrix()
    np.testing.assert_allclose(turned.origin, turn @ placed.origin, atol=1e-14)
    np.testing.assert_allclose(turned.rotation, turn @ placed.rotation, atol=1e-14)
    np.testing.assert_allclose(going.linear, turn @ motion.linear, atol=1e-14)


@pytest.fixture(scope="module")
def held():
    """A jaw closed across a cube, and where both are."""
    hand = parallel_jaw()
    opened = Posture(Pose(jnp.zeros(3), jnp.eye(3)), jnp.asarray(hand.lower))
    placed = Pose(jnp.array([0.0, 0.0, 0.11]), jnp.eye(3))
    closed, contacts = close_hand(hand, opened, CUBE, placed, 1e-3)
    assert contacts.present.sum() >= 4
    return hand, closed, placed


def scene(hand, guide, **changes) -> Scene:
    table = Pose(jnp.array([0.0, 0.0, -5.0]), jnp.eye(3))
    links = jnp.ones(len(hand.links))
    return Scene(hand, BODY, table, 0.5, 4000.0, links, jnp.asarray(GRAVITY), guide=guide, **changes)


@pytest.mark.slow
def test_on_a_rail_the_hand_lifts_and_the_rail_carries_the_rest(held):
    """Fig. 8: the wrist rises and strays; the cube rises."""
    hand, closed, placed = held
    count = 30
    way = np.linspace(0, 1, count)
    smooth = way**3 * (10 - 15 * way + 6 * way**2)
    stray = 2e-4 * np.sin(9 * way)
    origin = np.stack([stray, -stray, 0.04 * smooth], -1)
    turn = Rotation.from_rotvec(np.stack([0 * way, 0 * way, 0.01 * smooth], -1)).as_matrix()
    postures = Posture(Pose(origin, turn), np.broadcast_to(np.asarray(closed.angles), (count, 2)))
    record = carry(scene(hand, RAIL), postures, placed, DT, law="optimum")
    assert {instant.hold for instant in record} == {Hold.STABLE}
    heights = np.array([instant.placed.origin[2] for instant in record])
    np.testing.assert_array_equal([instant.placed.origin[:2] for instant in record], 0)
    np.testing.assert_allclose(
        [instant.placed.rotation for instant in record], np.broadcast_to(np.eye(3), (count, 3, 3))
    )
    np.testing.assert_allclose(heights - 0.11, 0.04 * smooth, atol=1e-12)
    for k in range(1, count - 1):
        lifted = np.asarray(record[k].tick.assessment.forces).sum(0)[2]
        acceleration = (heights[k + 1] - 2 * heights[k] + heights[k - 1]) / DT**2
        assert lifted == pytest.approx(MASS * (9.81 + acceleration), rel=1e-6)
    assert (record[5].tick.assessment.optimum.rank == 1).all()


@pytest.mark.slow
def test_off_its_rail_the_same_grip_would_not_hold(held):
    """Between jaws without friction a push aside is the rail's to take; without a rail the cube slips away."""
    hand, closed, placed = held
    once = Posture(Pose(np.zeros((2, 3)), np.broadcast_to(np.eye(3), (2, 3, 3))), np.stack([closed.angles] * 2))
    aside = {"friction": 0.0, "gravity": jnp.array([0.0, 3.0, 0.0])}
    for guide, expected in ((RAIL, Hold.STABLE), (None, Hold.SLIPPING)):
        record = carry(Scene(**{**vars(scene(hand, guide)), **aside}), once, placed, DT, law="optimum")
        assert record[0].hold == expected
    assert int(record[0].tick.assessment.optimum.verdict) == Verdict.INFEASIBLE
    np.testing.assert_allclose(record[1].placed.origin - placed.origin, [0, 3.0 * DT**2, 0], atol=1e-9)


@pytest.mark.slow
def test_let_go_it_falls_along_its_guide():
    """On a rail as in the air; on a hinge as a pendulum, whose period is known."""
    hand = parallel_jaw()
    count = 160
    away = Posture(Pose(np.full((count, 3), 9.0), np.broadcast_to(np.eye(3), (count, 3, 3))), np.zeros((count, 2)))
    tilted = np.array([1.0, 0, 0.0])
    rail = np.concatenate([np.array([[0.6], [0], [0.8]]), np.zeros((3, 1))])
    placed = Pose(jnp.asarray(tilted), jnp.eye(3))
    fall = carry(scene(hand, rail), Posture(*_first(away, 20)), placed, DT)
    went = np.array([instant.placed.origin for instant in fall]) - tilted
    steps = np.arange(20)
    np.testing.assert_allclose(went, -9.81 * 0.8 * DT**2 * (steps * (steps + 1) / 2)[:, None] * rail[:3, 0], atol=1e-12)
    assert {instant.hold for instant in fall} == {Hold.LOST}

    arm, swing = 0.3, 0.1
    start = Pose(arm * jnp.array([0.0, np.sin(swing), -np.cos(swing)]), jnp.eye(3))
    record = carry(scene(hand, HINGE), away, start, DT)
    places = np.array([instant.placed.origin for instant in record])
    np.testing.assert_allclose(np.linalg.norm(places, axis=1), arm, rtol=1e-12)
    about_hinge = float(spatial_inertia(BODY, np.eye(3))[3, 3]) + MASS * arm**2
    period = 2 * np.pi * np.sqrt(about_hinge / (MASS * 9.81 * arm)) * (1 + swing**2 / 16)
    crossings = np.flatnonzero(np.diff(np.sign(places[:, 1]))) * DT
    assert crossings[1] - crossings[0] == pytest.approx(period / 2, abs=1.5 * DT)
    assert np.abs(np.arctan2(places[:, 1], -places[:, 2])).max() < 1.02 * swing


def _first(postures: Posture, count: int) -> tuple:
    return Pose(postures.wrist.origin[:count], postures.wrist.rotation[:count]), postures.angles[:count]
