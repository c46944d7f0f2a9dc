"""Objects on a rail and on a hinge: the hand balances, and moves, what the guide leaves free."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm, logm
from scipy.spatial.transform import Rotation

from jaxgrasp import Verdict
from jaxgrasp.grip import Body, Hold, Obstacle, Scene, observe, simulate
from jaxgrasp.grip.motion import Motion, guide_at, mobility, moved, spatial_inertia
from jaxgrasp.grip.simulation import integrate_free
from jaxgrasp.hand import Box, Pose, Posture, close_hand, parallel_jaw, rigid_body, sphere_tree
from tests.grip.hands import without_hand

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
    guide_there = np.asarray(guide_at(guide, origin))
    about_world = guide[:3] + np.cross(guide[3:], point, axis=0, axisb=0, axisc=0)
    about_origin = guide_there[:3] + np.cross(guide_there[3:], point - origin, axis=0, axisb=0, axisc=0)
    np.testing.assert_allclose(about_origin, about_world, atol=1e-14)


def test_an_impulse_moves_a_guided_body_along_its_guide_alone():
    """The velocity change has the least kinetic energy that does the impulse's work (Gauss)."""
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
    turned = moved(placed, motion, 0.4, HINGE)
    going = integrate_free(scene(parallel_jaw(), HINGE), 0.4, placed, motion, turned)
    turn = Rotation.from_rotvec([0.8, 0, 0]).as_matrix()
    np.testing.assert_allclose(turned.origin, turn @ placed.origin, atol=1e-14)
    np.testing.assert_allclose(turned.rotation, turn @ placed.rotation, atol=1e-14)
    np.testing.assert_allclose(going.linear, turn @ motion.linear, atol=1e-14)


@pytest.fixture(scope="module")
def held():
    """Return a jaw closed across a cube: hand, posture and the cube's pose."""
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
    fraction = np.linspace(0, 1, count)
    smooth = fraction**3 * (10 - 15 * fraction + 6 * fraction**2)
    stray = 2e-4 * np.sin(9 * fraction)
    origin = np.stack([stray, -stray, 0.04 * smooth], -1)
    turn = Rotation.from_rotvec(np.stack([0 * fraction, 0 * fraction, 0.01 * smooth], -1)).as_matrix()
    postures = Posture(Pose(origin, turn), np.broadcast_to(np.asarray(closed.angles), (count, 2)))
    record = simulate(scene(hand, RAIL), postures, placed, DT, law="optimum")
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
        record = simulate(Scene(**{**vars(scene(hand, guide)), **aside}), once, placed, DT, law="optimum")
        assert record[0].hold == expected
    assert int(record[0].tick.assessment.optimum.verdict) == Verdict.INFEASIBLE
    np.testing.assert_allclose(record[1].placed.origin - placed.origin, [0, 3.0 * DT**2, 0], atol=1e-9)


def energies(record: list, body: Body, dt: float) -> np.ndarray:
    """Sum the kinetic energy of the twist halfway between instants and the gravitational energy left after it."""
    origin = np.array([instant.placed.origin for instant in record])
    rotation = np.array([instant.placed.rotation for instant in record])
    sums = []
    for k in range(len(record) - 1):
        matrix = np.eye(4)
        matrix[:3, :3] = rotation[k + 1] @ rotation[k].T
        matrix[:3, 3] = origin[k + 1] - matrix[:3, :3] @ origin[k]
        twist = np.real(logm(matrix)) / dt
        angular = np.array([twist[2, 1], twist[0, 2], twist[1, 0]])
        half = expm(twist * dt / 2)
        centre = half[:3, :3] @ origin[k] + half[:3, 3]
        motion = np.concatenate([twist[:3, 3] + np.cross(angular, centre), angular])
        inertia = np.asarray(spatial_inertia(body, half[:3, :3] @ rotation[k]))
        sums.append(motion @ inertia @ motion / 2 - float(body.mass) * origin[k + 1] @ GRAVITY)
    return np.array(sums)


@pytest.mark.slow
def test_let_go_it_falls_along_its_rail():
    rail = np.concatenate([np.array([[0.6], [0], [0.8]]), np.zeros((3, 1))])
    start = np.array([1.0, 0, 0])
    for columns in (rail, np.concatenate([rail, 0 * rail], 1), 1e-9 * rail):
        fall = simulate(scene(parallel_jaw(), columns), without_hand(20), Pose(jnp.asarray(start), jnp.eye(3)), DT)
        went = np.array([instant.placed.origin for instant in fall]) - start
        steps = np.arange(20)
        expected = -9.81 * 0.8 * DT**2 * (steps * (steps + 1) / 2)[:, None] * rail[:3, 0]
        np.testing.assert_allclose(went, expected, atol=1e-12)
        assert {instant.hold for instant in fall} == {Hold.LOST}


@pytest.mark.slow
def test_a_pendulum_swings_in_its_time_and_never_higher():
    arm, swing, count = 0.3, 0.1, 160
    start = Pose(arm * jnp.array([0.0, np.sin(swing), -np.cos(swing)]), jnp.eye(3))
    record = simulate(scene(parallel_jaw(), HINGE), without_hand(count), start, DT)
    places = np.array([instant.placed.origin for instant in record])
    np.testing.assert_allclose(np.linalg.norm(places, axis=1), arm, rtol=1e-12)
    about_hinge = float(spatial_inertia(BODY, np.eye(3))[3, 3]) + MASS * arm**2
    period = 2 * np.pi * np.sqrt(about_hinge / (MASS * 9.81 * arm)) * (1 + swing**2 / 16)
    crossings = np.flatnonzero(np.diff(np.sign(places[:, 1]))) * DT
    assert crossings[1] - crossings[0] == pytest.approx(period / 2, abs=1.5 * DT)
    energy = energies(record, BODY, DT)
    assert np.diff(energy).max() < 1e-12 * MASS * 9.81 * arm


@pytest.mark.slow
def test_a_guide_that_leaves_everything_free_is_none():
    """Spin and way do not mix: with all twists, or those of a plane in which everything happens, it flies as freely."""
    body, floor = Box(0.05, 0.04, 0.06), Pose(jnp.array([0.0, 0.0, -9.0]), jnp.eye(3))
    hand = parallel_jaw()
    post = Obstacle(Box(0.05, 0.5, 0.05), Pose(jnp.array([0.045, 0, -0.1]), jnp.eye(3)), 2e3)
    outline = rigid_body(sphere_tree(body, 3))
    ends = []
    for guide in (None, np.eye(6), np.eye(6)[:, [0, 2, 4]]):
        world = Scene(
            hand, Body(body, 0.5), floor, 0.5, 2e3, jnp.ones(8), jnp.asarray(GRAVITY), guide, (post,), outline
        )
        record = simulate(world, without_hand(60), Pose(jnp.zeros(3), jnp.eye(3)), 5e-3)
        assert np.diff(energies(record, Body(body, 0.5), 5e-3) if guide is not None else [0, 0]).max() < 1e-12
        places = np.array([instant.placed.origin for instant in record])
        late = np.diff(places[-20:], axis=0) / 5e-3
        # It tumbles fast: along a guide a step in time holds the momentum to some thousandths.
        np.testing.assert_allclose(late[:, 0], late[0, 0], rtol=1e-9 if guide is None else 0.04)
        assert abs(late[0, 0]) > 0.05
        ends.append(places[-1])
    np.testing.assert_allclose(ends[1], ends[0], atol=0.01)
    np.testing.assert_allclose(ends[2], ends[0], atol=0.01)


@pytest.mark.slow
def test_on_a_ball_joint_it_turns_as_euler_says():
    """Against an integration of Euler's equations about the pivot; the error falls with the step."""
    brick, mass = Box(0.02, 0.10, 0.06), 0.5
    body, spread = Body(brick, mass), np.array([float(m) for m in brick._moments()])
    turn, origin = Rotation.from_euler("xyz", [20, 10, 30], degrees=True), np.array([0.08, 0.02, 0.01])
    arm = turn.inv().apply(origin)
    inertia = mass * (np.diag(spread) + arm @ arm * np.eye(3) - np.outer(arm, arm))

    def slope(_, state):
        rotation, spin = Rotation.from_quat(state[:4]), state[4:]
        torque = np.cross(arm, mass * rotation.inv().apply(GRAVITY))
        w = np.concatenate([spin, [0]])
        turning = 0.5 * (Rotation.from_quat(state[:4]) * Rotation.from_quat(w)).as_quat() * np.linalg.norm(w)
        if np.linalg.norm(spin) == 0:
            turning = np.zeros(4)
        return np.concatenate([turning, np.linalg.solve(inertia, torque - np.cross(spin, inertia @ spin))])

    duration = 0.4
    exact = solve_ivp(
        slope, (0, duration), np.concatenate([turn.as_quat(canonical=False), 1e-12 * np.ones(3)]), rtol=1e-9
    )
    expected = Rotation.from_quat(exact.y[:4, -1]).apply(arm)
    errors = []
    for dt in (4e-3, 2e-3):
        world = Scene(
            parallel_jaw(),
            body,
            Pose(jnp.array([0.0, 0.0, -9.0]), jnp.eye(3)),
            0.5,
            2e3,
            jnp.ones(8),
            jnp.asarray(GRAVITY),
            np.eye(6)[:, 3:],
        )
        count = round(duration / dt) + 1
        record = simulate(world, without_hand(count), Pose(jnp.asarray(origin), jnp.asarray(turn.as_matrix())), dt)
        errors.append(np.linalg.norm(record[-1].placed.origin - expected))
        assert np.diff(energies(record, body, dt)).max() < 1e-12
    assert errors[0] < 8e-3 and errors[1] < 0.65 * errors[0]


@pytest.mark.slow
def test_a_hand_lifts_it_out_of_a_table_that_it_begins_in(held):
    hand, closed, placed = held
    count = 40
    rise = np.linspace(0, 0.01, count)
    origin = np.stack([0 * rise, 0 * rise, rise], -1)
    rotation = np.broadcast_to(np.eye(3), (count, 3, 3))
    postures = Posture(Pose(origin, rotation), np.broadcast_to(np.asarray(closed.angles), (count, 2)))
    inside = {"table": Pose(jnp.array([0.0, 0.0, 0.11 - 0.035 + 1e-3]), jnp.eye(3))}
    record = simulate(Scene(**{**vars(scene(hand, RAIL)), **inside}), postures, placed, DT, law="optimum")
    went = np.array([instant.placed.origin[2] for instant in record]) - 0.11
    np.testing.assert_allclose(went, rise, atol=1e-9)


@pytest.mark.parametrize(
    "guide, message",
    [
        (np.zeros(6), r"guide has shape \(6,\): expected \(6, k\), a column for each of 1 to 6 twists"),
        (np.zeros((3, 6)), r"guide has shape \(3, 6\)"),
        (np.zeros((6, 2)), "guide is all zeros: expected a nonzero twist in at least one column"),
        (np.full((6, 1), np.nan), r"guide\[0, 0\] is nan: expected a finite number"),
    ],
)
def test_bad_guides_are_named(guide, message, unchecked):
    still = Posture(Pose(np.zeros((1, 3)), np.eye(3)[None]), np.zeros((1, 2)))
    for function in (lambda s: simulate(s, still, anywhere(), DT), lambda s: observe(s, still, anywhere())):
        with pytest.raises(ValueError, match=message):
            function(scene(parallel_jaw(), guide))
