"""Laws of the dual function: concave, below every allowed force's price, and touching it at the optimum."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxgrasp
from jaxgrasp import Grasp, dual_value, multiplier_forces
from jaxgrasp.testing import problems as P
from jaxgrasp.testing import references as R

COUNT, N = 64, 3


def grasp_of(problem: P.Problems, present: np.ndarray | None = None) -> Grasp:
    return Grasp(problem.points, problem.normals, problem.friction, problem.squeeze, present)


def resultant(points, forces):
    return np.concatenate([forces.sum(-2), np.cross(points, forces).sum(-2)], -1)


def multipliers(problem: P.Problems, seed: int, size: float = 1.0) -> np.ndarray:
    """Return random virtual twists that move the contacts by about ``size``, so that every cone case occurs."""
    rng = np.random.default_rng(seed)
    linear, angular = rng.normal(size=(2, COUNT, 3)) * size * np.array([1.0, 20.0])[:, None, None]
    return np.concatenate([linear - np.cross(angular, problem.points.mean(1)), angular], -1)


@pytest.fixture(scope="module")
def ordinary() -> P.Problems:
    return P.problems("ordinary", N, COUNT, seed=1)


@pytest.fixture(scope="module")
def solution(ordinary):
    """Return the constrained optimum with the weights of method B."""
    return jax.device_get(jaxgrasp.constrained_optimum(grasp_of(ordinary), ordinary.wrench, ordinary.squeeze))


@pytest.mark.parametrize("sharing", ["squeeze", "uniform"])
def test_agrees_with_extended_precision(ordinary, sharing):
    twist = multipliers(ordinary, 2)
    value = dual_value(grasp_of(ordinary), ordinary.wrench, twist, sharing)
    centred_problem = R.centred(ordinary, ordinary.weights(sharing))
    expected = np.asarray(R.dual_objective(centred_problem, centred_problem.scaled_twist(twist)), float)
    np.testing.assert_allclose(value, expected, rtol=1e-12, atol=1e-12 * np.abs(expected).max())


def test_touches_the_optimum(ordinary, solution):
    grasp = grasp_of(ordinary)
    value = dual_value(grasp, ordinary.wrench, solution.multiplier)
    scale = np.maximum(solution.objective, ordinary.squeeze.sum(-1) / 2)
    assert (np.abs(value - solution.objective) <= 1e-9 * scale).all()
    forces = multiplier_forces(grasp, solution.multiplier)
    np.testing.assert_allclose(forces, solution.forces, rtol=0, atol=1e-11 * np.abs(solution.forces).max())


def test_gradient_is_what_the_forces_leave_of_the_wrench(ordinary):
    grasp, twist = grasp_of(ordinary), multipliers(ordinary, 3)
    gradient = jax.grad(lambda x: dual_value(grasp, ordinary.wrench, x).sum())(twist)
    residual = ordinary.wrench - resultant(ordinary.points, np.asarray(multiplier_forces(grasp, twist)))
    np.testing.assert_allclose(gradient, residual, rtol=0, atol=1e-12 * np.abs(residual).max())


def test_forces_are_allowed_and_best(ordinary):
    """Each is in its cone, and no other allowed force costs less at this multiplier."""
    twist, rng = multipliers(ordinary, 4), np.random.default_rng(5)
    forces = np.asarray(multiplier_forces(grasp_of(ordinary), twist))
    assert R.judge(ordinary, ordinary.squeeze, forces, twist).violation.max() < 1e-13
    velocity = twist[:, None, :3] + np.cross(twist[:, None, 3:], ordinary.points)

    def cost(f):
        apart = np.sum((f - ordinary.squeeze[..., None] * ordinary.normals) ** 2, -1)
        return apart / (2 * ordinary.squeeze) - np.sum(f * velocity, -1)

    contacts = P.Contacts(*(getattr(ordinary, name) for name in P.Contacts._fields))
    for _ in range(50):
        away = np.exp(rng.normal(size=ordinary.squeeze.shape))
        other_forces = P.allowed_forces(rng, contacts, ordinary.squeeze * away)
        assert (cost(forces) <= cost(other_forces) + 1e-12 * np.abs(cost(other_forces))).all()


def test_concave(ordinary):
    grasp = grasp_of(ordinary)
    for seed in range(5):
        first_twist, second_twist = multipliers(ordinary, 10 + seed, 2.0), multipliers(ordinary, 20 + seed, 0.5)
        ends = [np.asarray(dual_value(grasp, ordinary.wrench, x)) for x in (first_twist, second_twist)]
        middle = np.asarray(dual_value(grasp, ordinary.wrench, (first_twist + second_twist) / 2))
        assert (middle >= (ends[0] + ends[1]) / 2).all()


def test_no_allowed_forces_cost_less(ordinary):
    """Weak duality, for forces and multipliers that know nothing of each other."""
    rng = np.random.default_rng(6)
    contacts = P.Contacts(*(getattr(ordinary, name) for name in P.Contacts._fields))
    for seed in range(5):
        forces = P.allowed_forces(rng, contacts, ordinary.squeeze * np.exp(rng.normal(size=(COUNT, N))))
        wrench = P.exact_wrench(ordinary.points, forces)
        apart = np.sum((forces - ordinary.squeeze[..., None] * ordinary.normals) ** 2, -1)
        for sharing in ("squeeze", "uniform"):
            price = np.sum(apart / (2 * ordinary.weights(sharing)), -1)
            value = dual_value(grasp_of(ordinary), wrench, multipliers(ordinary, 30 + seed, 0.3), sharing)
            assert (value <= price).all()


def test_the_optimum_moves_as_the_dual_does(ordinary, solution):
    """Envelope theorem: with the data, the optimum's objective moves as the dual does at its multiplier."""

    def data(points, friction, squeeze, wrench, weights):
        return Grasp(points, ordinary.normals, friction, squeeze), wrench, weights

    def bound(*arrays):
        grasp, wrench, weights = data(*arrays)
        return dual_value(grasp, wrench, solution.multiplier, weights).sum()

    def price(*arrays):
        return np.asarray(jaxgrasp.constrained_optimum(*data(*arrays)).objective)

    arrays = (ordinary.points, ordinary.friction, ordinary.squeeze, ordinary.wrench, ordinary.squeeze)
    slopes = jax.jit(jax.grad(bound, tuple(range(len(arrays)))))(*arrays)
    rng, step = np.random.default_rng(6), 1e-6
    for i, (array, slope) in enumerate(zip(arrays, slopes, strict=True)):
        direction = rng.normal(size=array.shape) * np.abs(array)
        ends = [price(*(x + h * direction if j == i else x for j, x in enumerate(arrays))) for h in (-step, step)]
        expected = np.sum((direction * np.asarray(slope)).reshape(COUNT, -1), -1)
        scale = np.maximum(solution.objective, ordinary.squeeze.sum(-1) / 2)
        np.testing.assert_allclose((ends[1] - ends[0]) / (2 * step) / scale, expected / scale, atol=1e-5, rtol=1e-5)


@pytest.mark.slow
def test_second_and_third_derivatives(ordinary):
    """The Hessian is symmetric, nowhere positive, and the gradient's slope; the third derivative is the Hessian's."""
    grasp, wrench, twist = grasp_of(ordinary), ordinary.wrench, multipliers(ordinary, 7)
    gradient = jax.jit(jax.grad(lambda x: dual_value(grasp, wrench, x).sum()))
    rng = np.random.default_rng(8)
    along, across = (multipliers(ordinary, seed) for seed in rng.integers(100, 200, 2))
    turn = jax.jit(lambda x, v: jax.jvp(gradient, (x,), (v,))[1])
    bend = jax.jit(lambda x, u, v: jax.jvp(lambda y: turn(y, u), (x,), (v,))[1])
    second = np.asarray(turn(twist, along))
    assert (np.sum(along * second, -1) <= 1e-12 * np.abs(second).max()).all()
    np.testing.assert_allclose(np.sum(across * second, -1), np.sum(along * turn(twist, across), -1), rtol=1e-9)
    size = np.abs(second).max(-1)
    for step, derivative, lower in ((1e-6, second, gradient), (1e-6, bend(twist, along, across), None)):
        direction = along if lower is not None else across
        at = lower if lower is not None else lambda x: turn(x, along)
        slope = (np.asarray(at(twist + step * direction)) - np.asarray(at(twist - step * direction))) / (2 * step)
        apart = np.abs(slope - derivative).max(-1)
        # A kink within the difference's reach is rare: most problems have none.
        assert (apart <= 1e-6 * np.maximum(size, np.abs(slope).max(-1))).mean() > 0.95


def test_derivative_where_a_weight_is_zero(ordinary):
    """A contact held fixed: the one-sided derivative by its weight, which the spread over 2k would miss."""
    grasp, twist = grasp_of(ordinary), multipliers(ordinary, 9)
    weights = ordinary.squeeze.copy()
    weights[:, 0] = 0

    def value(x):
        return np.asarray(dual_value(grasp, ordinary.wrench, twist, x))

    slope = jax.grad(lambda x: dual_value(grasp, ordinary.wrench, twist, x).sum())(weights)[:, 0]
    near, step = weights.copy(), 1e-6
    near[:, 0] = step
    np.testing.assert_allclose((value(near) - value(weights)) / step, slope, rtol=1e-4)
    held = ordinary.squeeze[:, :1, None] * ordinary.normals[:, :1]
    np.testing.assert_allclose(multiplier_forces(grasp, twist, weights)[:, :1], held, rtol=1e-14)


def test_nothing_breaks_at_kinks():
    """Apex, surface and axis of the cone, frictionless and unsqueezed contacts: all derivatives finite."""
    points = np.zeros((6, 1, 3))
    normals = np.tile([0.0, 0.0, 1.0], (6, 1, 1))
    friction = np.array([[0.5], [0.5], [0.5], [0.0], [0.0], [0.5]])
    squeeze = np.array([[0.0], [1.0], [1.0], [1.0], [1.0], [0.0]])
    linear = np.array([[0, 0, 0], [0.5, 0, 0], [0, 0, -1], [0, 0, 0], [1, 0, 0], [1, 0, 1]], float)
    twist = np.concatenate([linear, np.zeros((6, 3))], -1)

    def value(squeeze, friction, points, x):
        return dual_value(Grasp(points, normals, friction, squeeze), np.ones((6, 6)), x).sum()

    arrays = (squeeze, friction, points, twist)
    direction = tuple(np.random.default_rng(16).normal(size=x.shape) for x in arrays)
    slopes = jax.value_and_grad(value, (0, 1, 2, 3))
    # Along a random direction an entry that is not finite shows, whichever it is.
    everything = jax.jit(lambda *at: jax.jvp(slopes, at, direction))(*arrays)
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(everything))


def test_leading_axes_broadcast(ordinary):
    few = Grasp(*(x[:4, None] for x in (ordinary.points, ordinary.normals, ordinary.friction, ordinary.squeeze)))
    wrench, twist = ordinary.wrench[:5], multipliers(ordinary, 11)[:10].reshape(2, 1, 5, 6)
    value, forces = dual_value(few, wrench, twist), multiplier_forces(few, twist)
    assert value.shape == (2, 4, 5) and forces.shape == (2, 4, 5, N, 3)
    single_grasp = jax.tree.map(lambda x: x[3, 0], few)
    np.testing.assert_allclose(value[1, 3, 2], dual_value(single_grasp, wrench[2], twist[1, 0, 2]), rtol=1e-13)
    np.testing.assert_allclose(forces[1, 3, 2], multiplier_forces(single_grasp, twist[1, 0, 2]), rtol=1e-13)
    mapped = jax.vmap(lambda w, x: dual_value(single_grasp, w, x))(wrench, twist[1, 0])
    np.testing.assert_allclose(value[1, 3], mapped, rtol=1e-13)


def test_absent_contacts_change_nothing(ordinary):
    twist = multipliers(ordinary, 12)
    wide = {}
    for name in P.Contacts._fields:
        array = getattr(ordinary, name)
        wide[name] = np.concatenate([array, np.full_like(array[:, :1], np.nan)], 1)
    present = np.repeat([[1.0, 1.0, 1.0, 0.0]], COUNT, 0)
    padded = grasp_of(ordinary._replace(**wide), present)
    value, slopes = jax.value_and_grad(lambda g: dual_value(g, ordinary.wrench, twist).sum())(padded)
    np.testing.assert_allclose(value, dual_value(grasp_of(ordinary), ordinary.wrench, twist).sum(), rtol=1e-13)
    assert all((leaf[:, 3] == 0).all() for leaf in (slopes.points, slopes.normals, slopes.friction, slopes.squeeze))
    assert (np.asarray(multiplier_forces(padded, twist))[:, 3] == 0).all()


def test_bad_data_are_not_a_number(ordinary):
    points, twist = ordinary.points.copy(), multipliers(ordinary, 13)
    points[7, 1, 0] = np.nan
    broken = grasp_of(ordinary._replace(points=points))
    bad = np.arange(COUNT) == 7
    np.testing.assert_array_equal(np.isnan(dual_value(broken, ordinary.wrench, twist)), bad)
    np.testing.assert_array_equal(np.isnan(multiplier_forces(broken, twist)).all((1, 2)), bad)


def test_precision_follows_the_data(ordinary):
    single = ordinary.cast(np.float32)
    twist = multipliers(ordinary, 14)
    value = dual_value(grasp_of(single), single.wrench, twist.astype(np.float32))
    assert value.dtype == jnp.float32 and multiplier_forces(grasp_of(single), single.wrench).dtype == jnp.float32
    expected = np.asarray(dual_value(grasp_of(ordinary), ordinary.wrench, twist))
    np.testing.assert_allclose(value, expected, rtol=1e-4, atol=1e-4 * np.abs(expected).max())


def test_bad_arguments_raise(ordinary, unchecked):
    grasp, twist = grasp_of(ordinary), multipliers(ordinary, 15)
    with pytest.raises(ValueError, match="sharing is 'equal'"):
        dual_value(grasp, ordinary.wrench, twist, "equal")
    with pytest.raises(ValueError, match=r"wrench has shape \(64, 5\): expected \(..., 6\)"):
        dual_value(grasp, ordinary.wrench[:, :5], twist)
    with pytest.raises(ValueError, match=r"multiplier has shape \(64, 5\): expected \(..., 6\)"):
        multiplier_forces(grasp, twist[:, :5])
