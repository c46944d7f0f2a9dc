"""Margins of hands with limits along a direction: Clarabel's cone program, known hands, laws, derivatives."""

from functools import cache

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxgrasp
from jaxgrasp import Grasp, Limits, Verdict
from jaxgrasp.quality import largest_wrench
from jaxgrasp.testing import limited_reference
from jaxgrasp.testing.limited_problems import LimitedProblems, limited_problems

COUNT, N, JOINTS = 24, 4, 5


@cache
def made_of(kind: str, seed: int = 2) -> LimitedProblems:
    """Return soft fingers with bounds of normal forces and torques, and a wrench that allowed forces exert."""
    return limited_problems(kind, N, COUNT, seed, soft=True, bounded=True, joints=JOINTS)


def aside(made: LimitedProblems, seed: int = 5) -> np.ndarray:
    """Return random directions of the load's size, about the middle of the contacts."""
    points, size = made.problem.points, made.problem.squeeze.sum(-1)[:, None]
    middle = points.mean(1)
    radius = np.linalg.norm(points - middle[:, None], axis=-1).mean(-1)[:, None]
    force, torque = np.random.default_rng(seed).normal(size=(2, COUNT, 3)) * size / 3
    return np.concatenate([force, radius * torque + np.cross(middle, force)], -1)


def margin(made: LimitedProblems, direction, wrench=None, limits=None, grasp=None, progress=None) -> np.ndarray:
    wrench = made.problem.wrench if wrench is None else wrench
    return np.asarray(
        jaxgrasp.wrench_margin(
            made.grasp if grasp is None else grasp,
            wrench,
            direction,
            "uniform",
            limits=made.limits if limits is None else limits,
            progress=progress,
        )
    )


def by_clarabel(made: LimitedProblems, direction: np.ndarray) -> np.ndarray:
    """Return Clarabel's margins, NaN where it finds none."""
    pytest.importorskip("clarabel")
    margins = []
    for index in range(COUNT):
        case = made.case(index, np.ones((COUNT, N)))
        size = np.linalg.norm(direction[index, :3])
        status, theta = limited_reference.wrench_margin(case, direction[index] / size)
        margins.append(theta / size if status == "Solved" else np.nan)
    return np.array(margins)


@pytest.mark.parametrize(
    "kind",
    [
        "ordinary",
        "combined",
        *(pytest.param(kind, marks=pytest.mark.slow) for kind in ("low_friction", "coincident_some", "far_frame")),
    ],
)
def test_it_is_what_another_solver_finds(kind):
    made, progress = made_of(kind), []
    direction = aside(made)
    theta, expected = margin(made, direction, progress=progress.append), by_clarabel(made, direction)
    assert progress == [COUNT]
    is_finite = np.isfinite(expected) & np.isfinite(theta)
    assert is_finite.mean() > 0.6
    np.testing.assert_allclose(theta[is_finite], expected[is_finite], rtol=1e-6, atol=1e-7)
    assert np.isfinite(theta[np.isfinite(expected)]).all()
    assert (theta[is_finite] >= -1e-6).all(), "the wrench is in reach itself"


@pytest.mark.slow
def test_the_optimum_knows_the_same_limit():
    made = made_of("ordinary")
    direction = aside(made)
    theta = margin(made, direction)
    finite = np.isfinite(theta) & (theta > 1e-3)
    assert finite.mean() > 0.6
    for share, held in ((0.999, True), (1.001, False)):
        wrench = made.problem.wrench + share * np.where(finite, theta, 0)[:, None] * direction
        solution = jaxgrasp.constrained_optimum(made.grasp, wrench, "uniform", limits=made.limits)
        verdicts = np.asarray(solution.verdict)[finite]
        assert ((verdicts <= Verdict.OPTIMAL) == held).all()


def pinch(most: float = 5.0, least: float = 0.0, gamma: float = 0.0, arm: float = 0.0, torque: float = np.inf):
    """Return two fingers on the x axis among absent ones, of the shape that the other tests compile, and limits.

    A newton of normal force of the first finger asks ``arm`` [m] of the first joint.
    """
    points = np.array([[-0.03, 0, 0], [0.03, 0, 0], [0, 0.01, 0], [0, 0, 0]])
    normals = np.array([[1.0, 0, 0], [-1, 0, 0], [0, 1, 0], [0, 1, 0]])

    def repeat(x) -> np.ndarray:
        return np.broadcast_to(np.asarray(x, float), (COUNT, *np.shape(x))).copy()

    present, units = repeat([1.0, 1, 0, 0]), repeat([1.0] * 4)
    grasp = Grasp(repeat(points), repeat(normals), 0.5 * units, units, present, torsion=gamma * units)
    arms = np.zeros((COUNT, N, 4, JOINTS))
    arms[:, 0, :3, 0] = arm * normals[0]
    return grasp, Limits(
        normal_min=least * units, normal_max=most * units, torque_map=arms, torque_max=repeat([torque] * JOINTS)
    )


def along(grasp: Grasp, limits: Limits, direction, wrench=(0.0,) * 6) -> float:
    directions = np.broadcast_to(np.asarray(direction, float), (COUNT, 6))
    margin_of_load = jaxgrasp.wrench_margin(
        grasp, np.broadcast_to(wrench, (COUNT, 6)), directions, "uniform", limits=limits
    )
    np.testing.assert_allclose(margin_of_load, margin_of_load[0], rtol=1e-9, atol=1e-9)
    return float(margin_of_load[0])


LIFT, TURN, PUSH = np.eye(6)[2], np.eye(6)[3], np.eye(6)[0]


@pytest.mark.slow
def test_known_hands():
    """A pinch of at most 5 N lifts 2 mu 5 N, less what it holds already; soft fingers turn 2 gamma 5 N."""
    assert along(*pinch(), LIFT) == pytest.approx(5, rel=1e-8)
    assert along(*pinch(), 2 * LIFT) == pytest.approx(2.5, rel=1e-8)
    assert along(*pinch(), LIFT, 3 * LIFT) == pytest.approx(2, rel=1e-8)
    assert along(*pinch(), -LIFT, 3 * LIFT) == pytest.approx(8, rel=1e-8)
    assert along(*pinch(gamma=0.01), TURN) == pytest.approx(0.1, rel=1e-7)
    # 0.02 m of arm and 0.06 N.m of torque are 3 N of normal force.
    assert along(*pinch(arm=0.02, torque=0.06), LIFT) == pytest.approx(3, rel=1e-8)
    # One finger pushes with 5 N, the other at least with 1 N against it.
    assert along(*pinch(), PUSH) == pytest.approx(5, rel=1e-8)
    assert along(*pinch(least=1.0), PUSH) == pytest.approx(4, rel=1e-8)
    # Out of reach, but led back: 7 N lie 2 N beyond.
    assert along(*pinch(), LIFT, 7 * LIFT) == pytest.approx(-2, rel=1e-8)


def test_what_has_no_limit_is_endless_and_what_nothing_exerts_has_none():
    assert along(*pinch(most=np.inf), LIFT) == np.inf
    assert along(*pinch(), np.zeros(6), LIFT) == np.inf
    assert along(*pinch(), np.zeros(6), 7 * LIFT) == -np.inf
    assert along(*pinch(), LIFT, TURN) == -np.inf
    assert along(*pinch(), TURN) == pytest.approx(0, abs=1e-7)
    grasp, limits = pinch()
    bad = eqx.tree_at(lambda g: g.friction, grasp, np.full((COUNT, N), np.nan))
    assert along(bad, limits, LIFT) == -np.inf


@pytest.mark.slow
def test_limits_that_do_not_bind_change_nothing():
    made = made_of("ordinary")
    direction, wide = aside(made), np.full((COUNT, N), 1e4)
    plain = np.asarray(jaxgrasp.wrench_margin(made.grasp, made.problem.wrench, direction, "uniform"))
    none = eqx.tree_at(
        lambda x: (x.normal_min, x.normal_max, x.torque_max),
        made.limits,
        (0 * wide, wide, np.full((COUNT, JOINTS), np.inf)),
    )
    limited = margin(made, direction, limits=none)
    small = plain < 100
    assert small.sum() >= 5
    np.testing.assert_allclose(limited[small], plain[small], rtol=1e-6)
    assert (limited[np.isposinf(plain)] > 100).all()


@pytest.mark.slow
def test_it_is_the_largest_wrench_where_each_presses_with_one_newton_at_most():
    made = made_of("ordinary")
    units = np.ones((COUNT, N))
    unit = eqx.tree_at(
        lambda x: (x.normal_min, x.normal_max, x.torque_max),
        made.limits,
        (0 * units, units, np.full((COUNT, JOINTS), np.inf)),
    )
    task = aside(made)
    theta = margin(made, task, wrench=np.zeros((COUNT, 6)), limits=unit)
    expected = largest_wrench(made.grasp, task)
    assert (theta >= expected.lower * (1 - 1e-6) - 1e-9).all() and (theta <= expected.upper * (1 + 1e-6) + 1e-9).all()


@pytest.mark.slow
def test_laws():
    """Scale, rotation, shift, order; and more limits never resist more."""
    made = made_of("ordinary")
    direction, wrench, limits = aside(made), made.problem.wrench, made.limits
    theta = margin(made, direction)
    finite = np.isfinite(theta)
    assert finite.mean() > 0.8

    def check_scaled(margins, factor=1.0):
        np.testing.assert_allclose(margins[finite], factor * theta[finite], rtol=1e-6, atol=1e-7)

    stronger = eqx.tree_at(
        lambda x: (x.normal_min, x.normal_max, x.torque_max),
        limits,
        tuple(3 * x for x in (limits.normal_min, limits.normal_max, limits.torque_max)),
    )
    check_scaled(margin(made, direction, wrench=3 * wrench, limits=stronger), 3)
    check_scaled(margin(made, 3 * direction), 1 / 3)
    grasp = made.grasp
    turn = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    turned = eqx.tree_at(lambda g: (g.points, g.normals), grasp, (grasp.points @ turn.T, grasp.normals @ turn.T))
    arms = limits.torque_map.copy()
    arms[:, :, :3] = np.einsum("ij,bnjk->bnik", turn, arms[:, :, :3])
    moved_wrenches = [np.concatenate([w[:, :3] @ turn.T, w[:, 3:] @ turn.T], 1) for w in (direction, wrench)]
    check_scaled(
        margin(made, moved_wrenches[0], moved_wrenches[1], eqx.tree_at(lambda x: x.torque_map, limits, arms), turned)
    )
    shift = np.array([0.3, -0.2, 0.5])
    moved = eqx.tree_at(lambda g: g.points, grasp, grasp.points + shift)
    moved_wrenches = [np.concatenate([w[:, :3], w[:, 3:] + np.cross(shift, w[:, :3])], 1) for w in (direction, wrench)]
    check_scaled(margin(made, moved_wrenches[0], moved_wrenches[1], grasp=moved))
    order = np.random.default_rng(0).permutation(N)
    mixed = jax.tree.map(lambda x: x[:, order], grasp)
    bounds = Limits(
        normal_min=limits.normal_min[:, order],
        normal_max=limits.normal_max[:, order],
        torque_map=limits.torque_map[:, order],
        torque_max=limits.torque_max,
    )
    check_scaled(margin(made, direction, limits=bounds, grasp=mixed))
    weaker = eqx.tree_at(lambda x: x.torque_max, limits, 0.9 * limits.torque_max)
    assert (margin(made, direction, limits=weaker)[finite] <= theta[finite] + 1e-7).all()
    tighter = eqx.tree_at(lambda x: x.normal_max, limits, np.minimum(limits.normal_max, 1.05 * limits.normal_min))
    assert (margin(made, direction, limits=tighter)[finite] <= theta[finite] + 1e-7).all()


@pytest.mark.slow
def test_derivatives_are_those_of_the_value():
    """Forward and reverse, against differences of the value, by everything that it depends on."""
    made = made_of("ordinary")
    direction, limits = aside(made), made.limits
    names = ("points", "friction", "torsion", "wrench", "direction", "normal_min", "normal_max", "torque_max")
    grasp = made.grasp
    arrays = (
        *(getattr(grasp, name) for name in names[:3]),
        made.problem.wrench,
        direction,
        *(getattr(limits, name) for name in names[5:]),
    )
    rng = np.random.default_rng(1)
    tangent = tuple(
        np.where(np.isfinite(x), (0.02 if name == "points" else 0.3 * np.abs(x)) * rng.normal(size=x.shape), 0)
        for name, x in zip(names, arrays)
    )

    @jax.jit
    def value(points, friction, torsion, wrench, direction, least, most, torque):
        changed_grasp = eqx.tree_at(lambda g: (g.points, g.friction, g.torsion), grasp, (points, friction, torsion))
        bounds = Limits(normal_min=least, normal_max=most, torque_map=limits.torque_map, torque_max=torque)
        return jaxgrasp.wrench_margin(changed_grasp, wrench, direction, "uniform", limits=bounds)

    arrays = tuple(map(jnp.asarray, arrays))
    theta, forward = jax.jvp(value, arrays, tuple(map(jnp.asarray, tangent)))
    finite = np.isfinite(theta)
    np.testing.assert_allclose(theta[finite], margin(made, direction)[finite], rtol=1e-8)
    reverse = jax.grad(lambda *a: jnp.sum(jnp.where(finite, value(*a), 0)), argnums=tuple(range(8)))(*arrays)
    product = sum(np.sum(np.asarray(a) * b, tuple(range(1, b.ndim))) for a, b in zip(reverse, tangent))
    np.testing.assert_allclose(product[finite], np.asarray(forward)[finite], rtol=1e-9, atol=1e-12)
    step = 1e-5
    ends = [np.asarray(value(*(a + sign * b for a, b in zip(arrays, tangent)))) for sign in (step, -step)]
    numeric = (ends[0] - ends[1]) / (2 * step)
    smooth = np.abs(ends[0] + ends[1] - 2 * np.asarray(theta)) < 1e-7 * (1 + np.abs(theta))
    assert (finite & smooth).sum() >= 15
    np.testing.assert_allclose(np.asarray(forward)[finite & smooth], numeric[finite & smooth], rtol=2e-4, atol=2e-4)


@pytest.mark.slow
def test_it_is_mapped_and_shared():
    """Many directions share one grasp, inside ``vmap`` or by leading axes."""
    made = made_of("ordinary")
    direction = aside(made)
    grasp, limits = jax.tree.map(lambda x: x[0], (made.grasp, made.limits))
    wrench = made.problem.wrench[0]
    broad = jaxgrasp.wrench_margin(grasp, wrench, direction, "uniform", limits=limits)
    mapped = jax.vmap(lambda d: jaxgrasp.wrench_margin(grasp, wrench, d, "uniform", limits=limits))(direction)
    np.testing.assert_allclose(mapped, broad, rtol=1e-8)
    alone = [float(jaxgrasp.wrench_margin(grasp, wrench, d, "uniform", limits=limits)) for d in direction[:2]]
    np.testing.assert_allclose(alone, broad[:2], rtol=1e-8)


@pytest.mark.slow
def test_bad_arguments_are_named():
    grasp, limits = pinch()
    load = np.zeros((COUNT, 6))
    with pytest.raises(ValueError, match="sharing is an array: expected 'squeeze' or 'uniform' with limits"):
        jaxgrasp.wrench_margin(grasp, load, load, np.ones((COUNT, N)), limits=limits)
    with pytest.raises(ValueError, match="torque_max is None: expected torque_map and torque_max, or neither"):
        jaxgrasp.wrench_margin(grasp, load, load, limits=Limits(torque_map=limits.torque_map))
    with pytest.raises(NotImplementedError, match="wrench_margin has first derivatives only"):
        jax.hessian(lambda w: jnp.sum(jaxgrasp.wrench_margin(grasp, w, load + LIFT, "uniform", limits=limits)))(load)
