"""The contact engine: sliding by Coulomb's law, rest, energy, and springs, against balances of their own."""

import jax
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxgrasp.grip.contact_step import RIGID, ContactRows, solve_contacts

DT, MASS, G = 5e-3, 0.5, 9.81
HALVES = np.array([0.03, 0.04, 0.025])
CORNERS = HALVES * (2.0 * np.array(list(np.ndindex(2, 2, 2))) - 1)
INERTIA = MASS / 3 * np.diag(HALVES @ HALVES - HALVES**2)
UP = np.array([0.0, 0.0, 1.0])


@jax.jit
def step(inertia, free, rows: ContactRows, guess):
    return solve_contacts(inertia, free, rows, DT, guess)


def rows_on_ground(points, heights, friction: float) -> ContactRows:
    """Return the contacts of points with rigid ground, which they reach within the step at most."""
    zero, rigid = np.zeros(len(points)), np.full(len(points), RIGID * MASS / DT)
    coming = -np.maximum(heights, 0)[:, None] / DT * UP
    normals = np.tile(UP, (len(points), 1))
    return ContactRows(points, normals, zero + friction, zero, coming, zero, zero, 0 * points, zero, zero, rigid, rigid)


def slid(friction: float, slope: float, turn: np.ndarray, height: float, speed: float, count: int):
    """Let a box go on ground that is as steep as ``slope``; return its poses, energies, and the work of friction."""
    gravity = G * np.array([np.sin(slope), 0, -np.cos(slope)])
    origin, twist = height * UP, speed * np.eye(6)[0]
    origins, energies, work = [origin], [], 0.0
    for _ in range(count):
        inertia = np.zeros((6, 6))
        inertia[:3, :3], inertia[3:, 3:] = MASS * np.eye(3), turn @ INERTIA @ turn.T
        free = twist.copy()
        free[:3] += DT * gravity
        points = CORNERS @ turn.T
        result = step(inertia, free, rows_on_ground(points, points[:, 2] + origin[2], friction), twist)
        # What moves it are the forces that are returned.
        forces = np.asarray(result.forces)
        exerted = np.append(forces.sum(0), np.cross(points, forces).sum(0))
        twist = np.array(result.twist)
        np.testing.assert_allclose(inertia @ (twist - free) / DT, exerted, atol=1e-6)
        pressed = forces @ UP
        assert pressed.min() >= -1e-12
        assert np.all(np.linalg.norm(forces - pressed[:, None] * UP, axis=1) <= friction * pressed + 1e-9)
        origin = origin + DT * twist[:3]
        turn = Rotation.from_rotvec(DT * twist[3:]).as_matrix() @ turn
        work -= DT * float(forces[:, 0].sum() * twist[0])
        origins.append(origin)
        energies.append(twist @ inertia @ twist / 2 - MASS * gravity @ origin)
    return np.array(origins), turn, twist, np.array(energies), work


def test_a_box_that_slides_stops_where_friction_has_taken_its_energy():
    origins, _, twist, energies, work = slid(0.5, 0.0, np.eye(3), HALVES[2], 1.0, 60)
    distance = origins[-1, 0]
    assert work == pytest.approx(0.5 * MASS * G * distance, rel=1e-4)
    # A step in time takes a last half step of friction too early.
    assert distance == pytest.approx(1.0 / (2 * 0.5 * G), rel=0.03)
    assert np.abs(twist).max() < 1e-5 and np.diff(energies).max() <= 0
    assert abs(origins[-1, 2] - HALVES[2]) < 1e-6


@pytest.mark.parametrize(
    "slope, friction, slides", [(25, 0.5, False), (30, 0.5, True), (60, 0.5, True), (60, 0.0, True)]
)
def test_down_a_ramp_it_slides_by_its_friction_and_gains_no_energy(slope, friction, slides):
    angle = np.radians(slope)
    origins, _, twist, energies, _ = slid(friction, angle, np.eye(3), HALVES[2], 0.0, 40)
    expected = max(G * (np.sin(angle) - friction * np.cos(angle)), 0) * DT * 40
    assert twist[0] == pytest.approx(expected, rel=1e-4, abs=1e-4) and (expected > 0) == slides
    assert np.diff(energies).max() <= 1e-12 and np.abs(origins[:, 2] - HALVES[2]).max() < 1e-5


def test_a_tilted_box_falls_flat_and_gains_no_energy():
    turn = Rotation.from_euler("xyz", [20, 10, 5], degrees=True).as_matrix()
    _, turn, twist, energies, _ = slid(0.5, 0.0, turn, 0.06, 0.0, 100)
    assert np.abs(turn[2]).max() > 1 - 1e-4 and np.abs(twist).max() < 1e-3
    assert np.diff(energies).max() <= 1e-9


def test_springs_give_by_the_load_that_comes():
    """Two springs at rest under a force of theirs; a second force moves the object by the sum of their stiffness."""
    stiffness, load = np.array([300.0, 500.0]), 2.0
    points, normals = np.array([[0.0, 0, 0], [0.0, 0, 0]]), np.array([[0.0, 0, 1], [0.0, 0, -1]])
    zero, spring = np.zeros(2), stiffness * DT
    pressed = np.array([8.0, 8.0])
    rows = ContactRows(
        points, normals, zero + 0.5, zero, 0 * points, zero, pressed, 0 * points, zero, zero, spring, spring
    )
    inertia = np.diag([MASS, MASS, MASS, 1e-3, 1e-3, 1e-3])
    result = step(inertia, DT * load / MASS * np.eye(6)[2], rows, np.zeros(6))
    # (M / dt + K dt) v = F
    assert float(result.twist[2]) == pytest.approx(load / (MASS / DT + stiffness.sum() * DT), rel=1e-9)
    along = np.sum(np.asarray(result.forces) * normals, 1)
    np.testing.assert_allclose(along, pressed + [-1, 1] * spring * float(result.twist[2]), rtol=1e-9)
