"""Force closure: known grasps, and both proofs checked by arithmetic of their own."""

import numpy as np
import pytest

import jaxgrasp
from jaxgrasp import Grasp, GraspError
from jaxgrasp.quality import ferrari_canny, force_closure, min_weight
from jaxgrasp.testing import problems as P
from tests.quality import known

ROUNDING = 1e-12


def proven(grasp: Grasp) -> jaxgrasp.quality.ForceClosure:
    """Return the force closure after checking its proofs against velocities and forces alone."""
    closure = force_closure(grasp)
    points, normals, friction = (np.asarray(a) for a in (grasp.points, grasp.normals, grasp.friction))
    linear, angular = closure.twist[..., None, :3], closure.twist[..., None, 3:]
    velocity = linear + np.cross(angular, points)
    along = np.sum(velocity * normals, -1)
    slide = friction * np.linalg.norm(velocity - along[..., None] * normals, axis=-1)
    gamma = 0 if grasp.torsion is None else np.where(friction > 0, np.asarray(grasp.torsion), 0)
    power = along + np.hypot(slide, gamma * np.sum(angular * normals, -1))
    is_open = ~closure.closed & closure.decided
    size = np.linalg.norm(linear, axis=-1) + np.linalg.norm(angular, axis=-1) * np.linalg.norm(points, axis=-1)
    assert (np.any(closure.twist != 0, -1) == is_open).all()
    assert (power <= ROUNDING * size)[is_open].all()
    press = np.sum(closure.forces * normals, -1)
    across = np.linalg.norm(closure.forces - press[..., None] * normals, axis=-1)
    with np.errstate(divide="ignore", invalid="ignore"):
        used = np.where(across > ROUNDING, across / friction, 0) ** 2
        used += np.where(gamma > 0, closure.moments / gamma, 0) ** 2
    torque = np.cross(points, closure.forces).sum(-2) + (closure.moments[..., None] * normals).sum(-2)
    reach = np.abs(points).max((-1, -2))
    assert (press > 0)[closure.closed].all() and (np.sqrt(used) < press)[closure.closed].all()
    assert (np.abs(closure.forces.sum(-2)).max(-1) < ROUNDING)[closure.closed].all()
    assert (np.abs(torque).max(-1) < ROUNDING * np.maximum(reach, 1e-3))[closure.closed].all()
    np.testing.assert_allclose(press.sum(-1)[closure.closed], 1, rtol=1e-12)
    assert ((closure.margin > 0) == closure.closed).all()
    return closure


CLOSED = {
    "three fingers": known.triangle(),
    "two soft fingers": known.two_fingers(0.01),
    "six with friction": known.on_axes(0.2),
    "four around": known.grasp_of(
        [[1, 0, 0], [-1, 0, 0], [0, -1, 0], [0, 1, 0]], [[-1, 0, 0], [1, 0, 0], [0, 1, 0], [0, -1, 0]], 0.3
    ),
}
OPEN = {
    "one": known.star([0], 0.5),
    "one soft finger": known.star([0], 0.5, torsion=0.01),
    "two hard fingers": known.two_fingers(None),
    "two far away": known.changed(known.two_fingers(None), points=known.two_fingers(None).points + [3.0, 2.0, 1.0]),
    "two soft fingers on one side": known.star([0, 60], 0.5, torsion=0.01),
    "three without friction": known.triangle(0.0),
    "six without friction": known.on_axes(0.0),
    "a ball without friction": known.star(np.arange(0, 360, 30), 0.0),
    "three on one side": known.star([0, 50, 100], 0.3),
    "three on a line": known.grasp_of(
        np.outer([-1, 0.3, 1], [0.02, 0.03, 0.06]), [[1, 0, 0], [-1, 0, 0], [0.6, 0.8, 0]], 0.8
    ),
    "in one place": known.grasp_of(np.full((4, 3), 0.3), [[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]], 0.9),
}


@pytest.mark.parametrize("name", CLOSED)
def test_closed_grasps(name):
    proof = proven(CLOSED[name])
    assert proof.closed and proof.decided


@pytest.mark.parametrize("name", OPEN)
def test_open_grasps(name):
    proof = proven(OPEN[name])
    assert not proof.closed and proof.decided


def seven() -> Grasp:
    """Return seven frictionless contacts, six of them independent, whose only balance has seven positive weights."""
    grasp = known.ordinary(7, 4000)
    grasp = known.changed(grasp, friction=np.zeros((4000, 7)))
    wrenches = np.concatenate([grasp.normals, np.cross(grasp.points, grasp.normals)], -1)
    balance = np.linalg.svd(np.swapaxes(wrenches, -1, -2))[2][:, -1]
    good = np.flatnonzero((np.abs(np.sign(balance).sum(-1)) == 7) & (np.abs(balance).min(-1) > 0.02))
    return known.single(grasp, int(good[0]))


def test_seven_frictionless_contacts_can_close_and_no_six_of_them_do():
    seven_contacts = seven()
    assert proven(seven_contacts).closed
    for left_out in range(7):
        is_kept = np.arange(7) != left_out
        fields = {name: getattr(seven_contacts, name)[is_kept] for name in ("points", "normals", "friction", "squeeze")}
        assert not proven(known.changed(seven_contacts, **fields)).closed


@pytest.mark.parametrize("n", [2, 3, 5, 8])
@pytest.mark.parametrize("torsion", [False, True])
def test_random_grasps_are_decided_and_proven(n, torsion):
    proof = proven(known.ordinary(n, 60, torsion=torsion))
    assert proof.decided.all()


@pytest.mark.parametrize("kind", ["near_collinear", "coincident_some", "low_friction", "zero_friction", "far_frame"])
def test_nasty_grasps_are_decided_and_proven(kind):
    problem = P.problems(kind, 5, 60, 1)
    proof = proven(Grasp(problem.points, problem.normals, problem.friction, problem.squeeze))
    assert proof.decided.all()


def test_fingers_at_one_point_may_have_it_anywhere():
    directions = np.array([[1, 0, 0], [-0.5, 0.8, 0.3], [-0.5, -0.8, 0.3]])
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    points = np.random.default_rng(0).normal(size=(20, 3))
    points[0] = 0
    units = np.ones((20, 3))
    # Soft ones close the grasp even so; the mean of three equal numbers is not always that number.
    normals = units[..., None] * directions
    grasp = Grasp(np.repeat(points[:, None], 3, 1), normals, 0.8 * units, units, torsion=0.3 * units)
    proof = proven(grasp)
    assert proof.closed.all()
    ball = ferrari_canny(grasp)
    assert (proof.margin <= ball.lower).all() and (ball.lower > 0.05).all()
    assert np.allclose(ball.upper, ball.upper[0], rtol=1e-3)
    assert np.allclose(min_weight(grasp, sides=8).value, 0.746, atol=1e-3)


@pytest.mark.slow
def test_a_closed_grasp_exerts_any_wrench():
    problem = P.problems("ordinary", 5, 60, 1)
    grasp = Grasp(problem.points, problem.normals, problem.friction, problem.squeeze)
    closure = force_closure(grasp)
    exists = np.isfinite(np.asarray(jaxgrasp.least_squeeze(grasp, -problem.wrench)))
    assert exists[closure.closed].all()


def test_friction_at_the_very_limit_is_undecided_or_open_and_beside_it_decided():
    tilt = np.radians(20)
    normals = np.array([[-np.cos(tilt), np.sin(tilt), 0], [np.cos(tilt), np.sin(tilt), 0]])
    points = np.array([[0.05, 0, 0], [-0.05, 0, 0]])
    limit = np.tan(tilt)
    for share, closed in ((1 - 1e-6, False), (1 + 1e-6, True)):
        proof = proven(known.grasp_of(points, normals, share * limit, 0.01))
        assert proof.decided and proof.closed == closed
    assert not proven(known.grasp_of(points, normals, limit, 0.01)).closed


def test_neither_frame_nor_order_nor_padding_nor_unit_matters():
    grasp = known.ordinary(4, 40)
    closed = proven(grasp).closed
    others = [
        known.turned(grasp)[0],
        known.changed(grasp, points=grasp.points + [5.0, -3.0, 2.0]),
        known.changed(grasp, points=1000 * grasp.points),
        known.changed(grasp, **{f: getattr(grasp, f)[:, ::-1] for f in ("points", "normals", "friction", "squeeze")}),
        known.padded(grasp),
    ]
    for other_grasp in others:
        np.testing.assert_array_equal(force_closure(other_grasp).closed, closed)
    margins = [force_closure(grasp, length=length).margin for length in (0.02, 0.2)]
    assert (margins[0] > 0).tolist() == (margins[1] > 0).tolist()


def test_a_single_grasp_an_empty_one_and_leading_axes():
    grasp = known.ordinary(4, 6)
    flat = force_closure(grasp)
    names = ("points", "normals", "friction", "squeeze")
    fields = (getattr(grasp, name) for name in names)
    folded = force_closure(Grasp(*(array.reshape(2, 3, *array.shape[1:]) for array in fields)))
    np.testing.assert_array_equal(folded.margin.reshape(6), flat.margin)
    assert folded.forces.shape == (2, 3, 4, 3)
    nobody = force_closure(known.changed(known.triangle(), present=np.zeros(3)))
    assert not nobody.closed and nobody.decided and nobody.margin == 0


def test_single_precision_counts_its_own_rounding():
    grasp = known.ordinary(5, 20)
    names = ("points", "normals", "friction", "squeeze")
    rounded = Grasp(*(np.asarray(getattr(grasp, f), np.float32) for f in names))
    fine, coarse = force_closure(grasp), force_closure(rounded)
    np.testing.assert_array_equal(fine.closed[coarse.decided], coarse.closed[coarse.decided])
    assert coarse.margin.dtype == np.float64


@pytest.mark.usefixtures("unchecked")
def test_bad_input_is_named():
    grasp = known.triangle()
    with pytest.raises(GraspError, match=r"torsion\[1\] is -1.0: expected a finite length"):
        force_closure(known.changed(grasp, torsion=np.array([0.0, -1.0, 0.0])))
    with pytest.raises(GraspError, match=r"torsion is an array of shape \(2,\)"):
        force_closure(known.changed(grasp, torsion=np.zeros(2)))
    with pytest.raises(GraspError, match="length is 0.0: expected a finite length above zero"):
        force_closure(grasp, length=0.0)
    with pytest.raises(ValueError, match=r"about has shape \(2,\): expected \(..., 3\)"):
        force_closure(grasp, about=np.zeros(2))
    with pytest.raises(GraspError, match=r"about\[1\] is nan"):
        force_closure(grasp, about=np.array([0, np.nan, 0]))
    with pytest.raises(GraspError, match=r"friction\[2\] is -0.5"):
        force_closure(known.changed(grasp, friction=np.array([0.5, 0.5, -0.5])))
