"""Derivatives of values that do not exist: NaN for what depends on the value, zero for what does not."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxgrasp
from jaxgrasp import Grasp, Limits, Verdict
from jaxgrasp.quality import ferrari_canny, ferrari_canny_at, min_weight, min_weight_at
from jaxgrasp.sensitivity import friction_reserve
from tests.turns import in_turns

PINCH = Grasp(
    points=jnp.array([[1.0, 0, 0], [-1, 0, 0]]),
    normals=jnp.array([[-1.0, 0, 0], [1, 0, 0]]),
    friction=jnp.array([0.5, 0.4]),
    squeeze=jnp.array([4.0, 5.0]),
)
WRENCHES = jnp.array([[0.2, 0.3, 2, 0, 0.1, 0], [0.2, 0.3, 2, 1, 0, 0.0]])
"""Held, and a torque about the line through both contacts, which they do not reach."""
TRIPOD = Grasp(
    points=jnp.array([[1.0, 0, 0], [-0.6, 0.8, 0], [-0.6, -0.8, 0]]),
    normals=jnp.array([[-1.0, 0, 0], [0.6, -0.8, 0], [0.6, 0.8, 0]]),
    friction=jnp.array([0.5, 0.4, 0.6]),
    squeeze=jnp.array([4.0, 5.0, 3.0]),
)
LIMITS = Limits(
    normal_max=jnp.full(2, 20.0),
    torque_map=jnp.linspace(0.1, 1, 12).reshape(2, 3, 2),
    torque_max=jnp.full(2, 90.0),
)
SIDE = jnp.array([0.0, 0, 1, 0, 0, 0])


def of_solution(*names: str):
    def numbers(grasp, wrench):
        solution = jaxgrasp.constrained_optimum(grasp, wrench)
        return [getattr(solution, name).reshape(2, -1)[:, -1] for name in names]

    return numbers


def of_best_forces(objective: str, *names: str):
    def numbers(grasp, wrench):
        solution = jaxgrasp.best_forces(grasp, wrench, objective, limits=LIMITS)
        return [getattr(solution, name).reshape(2, -1)[:, -1] for name in names]

    return numbers


VALUES = {
    "optimum": of_solution("forces", "multiplier", "objective", "residual", "force_bound"),
    "objective": of_solution("objective"),
    "least_squeeze": lambda grasp, wrench: [jaxgrasp.least_squeeze(grasp, wrench)],
    "least_squeeze_factor": lambda grasp, wrench: [jaxgrasp.least_squeeze_factor(grasp, wrench)],
    "least_friction": lambda grasp, wrench: [jaxgrasp.least_friction(grasp, wrench)],
    "friction_reserve": lambda grasp, wrench: [friction_reserve(grasp, wrench).reserve],
    "wrench_margin": lambda grasp, wrench: [jaxgrasp.wrench_margin(grasp, wrench, SIDE)],
    **{objective: of_best_forces(objective, "value") for objective in jaxgrasp.OBJECTIVES},
}
"""(grasp, wrenches) -> numbers, each ``(2,)``, of both problems."""


def derivatives(values):
    """Differentiate K numbers: tangents ``(K, 2)`` along a move of both wrenches, and gradients ``(K, 2, 6)`` of
    the sum of both problems' numbers and of the first one's alone."""

    @jax.jit
    def taken(wrenches, moved):
        numbers, tangents = jax.linearize(lambda wrenches: jnp.stack(values(PINCH, wrenches)), wrenches)
        transposed = jax.linear_transpose(tangents, wrenches)
        unit = jnp.eye(len(numbers))[:, :, None]
        pulls = jnp.concatenate([unit * mask for mask in (jnp.array([1.0, 1.0]), jnp.array([1.0, 0.0]))])
        return tangents(moved), *jnp.split(jax.vmap(transposed)(pulls)[0], 2)

    return taken(WRENCHES, jnp.array([[0.1, 0.2, -0.3, 0, 0.1, 0.1]] * 2))


@pytest.mark.repeats
@pytest.mark.parametrize(
    "name",
    [
        pytest.param("optimum", marks=pytest.mark.slow),
        *in_turns([name for name in VALUES if name not in ("optimum", "objective")], ()),
    ],
)
def test_what_does_not_exist_has_no_derivative(name):
    assert jaxgrasp.constrained_optimum(PINCH, WRENCHES).verdict[1] == Verdict.INFEASIBLE
    for tangent, pulled, alone in zip(*derivatives(VALUES[name]), strict=True):
        assert np.isfinite(tangent[0]) and np.isfinite(pulled[0]).all()
        assert np.isnan(tangent[1]) and np.isnan(pulled[1]).all()
        # What pulls at the first alone, as a loss that leaves the second out, gets no NaN of the second.
        np.testing.assert_array_equal(alone[0], pulled[0])
        assert (np.asarray(alone[1]) == 0).all()


@pytest.mark.slow
@pytest.mark.repeats
@pytest.mark.parametrize("name", ["objective", "least_norm", "least_squeeze_factor"])
def test_nor_a_second_derivative(name):
    """Second derivatives of both problems and of the first alone, along one move, in both orders of differentiation."""

    def twice(wrenches, moved, mask):
        def total(wrenches):
            return jnp.sum(jnp.where(mask, VALUES[name](PINCH, wrenches)[0], 0))

        reverse = jax.jvp(jax.grad(total), (wrenches,), (moved,))[1]
        forward = jax.jvp(lambda w: jax.jvp(total, (w,), (moved,))[1], (wrenches,), (moved,))[1]
        return reverse, forward

    twice = jax.jit(twice)
    moved = jnp.array([[0.1, 0.2, -0.3, 0, 0.1, 0.1]] * 2)
    of_both, total = twice(WRENCHES, moved, jnp.array([True, True]))
    assert np.isfinite(of_both[0]).all() and np.isnan(of_both[1]).all() and np.isnan(total)
    first, total = twice(WRENCHES, moved, jnp.array([True, False]))
    np.testing.assert_array_equal(first[0], of_both[0])
    assert (np.asarray(first[1]) == 0).all() and np.isfinite(total)
    still = twice(WRENCHES, moved.at[1].set(0), jnp.array([True, True]))[0]
    assert (np.asarray(still[1]) == 0).all()


@pytest.mark.slow
def test_a_factor_moves_with_what_is_nothing_here():
    """Points in one plane: forces have no part across it, but get one as points and normals tilt."""
    rng = np.random.default_rng(3)
    wrench = jnp.array([0.3, -0.5, 1.5, 0.002, -0.003, 0.01])

    def factor(points, normals):
        return jaxgrasp.least_squeeze_factor(Grasp(points, normals, TRIPOD.friction, TRIPOD.squeeze), wrench)

    at = TRIPOD.points, TRIPOD.normals
    moved = tuple(jnp.asarray(0.02 * rng.normal(size=(3, 3))) for _ in at)
    value, slope = jax.jvp(factor, at, moved)
    ends = [factor(*(x + sign * 1e-5 * d for x, d in zip(at, moved, strict=True))) for sign in (-1, 1)]
    assert np.isfinite(value) and abs(slope) > 1e-4
    np.testing.assert_allclose(slope, (ends[1] - ends[0]) / 2e-5, rtol=1e-5)


@pytest.mark.slow
@pytest.mark.repeats
@pytest.mark.parametrize("count", [0, 1, 2, 5])
def test_one_grasp_serves_many_wrenches(count):
    wrenches = jnp.tile(jnp.array([0.3, -0.5, 1.5, 0.02, -0.03, 0.1]), (count, 1))
    gradient = jax.grad(lambda w: jnp.sum(jaxgrasp.least_squeeze_factor(TRIPOD, w)))(wrenches)
    assert gradient.shape == (count, 6) and np.isfinite(gradient).all()


@pytest.mark.slow
def test_a_tray_pulled_down_has_no_factor_and_no_derivative():
    tray = Grasp(TRIPOD.points, jnp.tile(jnp.array([0.0, 0, 1]), (3, 1)), TRIPOD.friction, TRIPOD.squeeze)
    pull = jnp.array([0.0, 0, -3, 0, 0, 0])
    value, gradient = jax.value_and_grad(lambda w: jaxgrasp.least_squeeze_factor(tray, w))(pull)
    assert value == np.inf and np.isnan(gradient).all()


@pytest.mark.slow
def test_shared_parameters_keep_the_derivative_of_what_is_held():
    """The same squeeze serves both wrenches: a masked loss moves as though the held one stood alone."""

    def loss(squeeze, wrenches, mask):
        grasp = Grasp(PINCH.points, PINCH.normals, PINCH.friction, squeeze)
        solution = jaxgrasp.constrained_optimum(grasp, wrenches)
        return jnp.sum(jnp.where(mask[:, None, None], solution.forces**2, 0))

    gradient_of_both = jax.grad(loss)(PINCH.squeeze, WRENCHES, jnp.array([True, False]))
    alone = jax.grad(loss)(PINCH.squeeze, WRENCHES[jnp.array([0, 0])], jnp.array([True, False]))
    np.testing.assert_allclose(gradient_of_both, alone, rtol=1e-12)
    assert np.any(gradient_of_both != 0)
    assert np.isnan(jax.grad(loss)(PINCH.squeeze, WRENCHES, jnp.array([True, True]))).all()


@pytest.mark.slow
@pytest.mark.repeats
@pytest.mark.parametrize("objective", ["least_maximal_force", "least_torque", "largest_margin"])
def test_the_forces_of_a_search_have_no_derivative(objective):
    for derivative in derivatives(of_best_forces(objective, "forces", "bound"))[:2]:
        assert np.isnan(derivative).all()


@pytest.mark.slow
def test_a_margin_has_no_derivative_by_a_friction_of_zero():
    """A contact has a margin to lose as soon as it has friction; by the friction of the others there is one."""
    grasp = Grasp(TRIPOD.points, TRIPOD.normals, jnp.array([0.5, 0.5, 0.0]), TRIPOD.squeeze)
    wrench = jnp.array([1.0, 0.2, 0, 0, 0, 0])

    def margin(friction):
        changed_grasp = Grasp(grasp.points, grasp.normals, friction, grasp.squeeze)
        return jaxgrasp.best_forces(
            changed_grasp, wrench, "largest_margin", limits=Limits(normal_max=jnp.full(3, 9.0))
        ).value

    gradient = np.asarray(jax.grad(margin)(grasp.friction))
    assert np.isfinite(gradient[:2]).all() and np.isnan(gradient[2])


def test_quality_that_was_not_found_has_no_derivative():
    """No edges balance on a pinch without friction, and a ball that was not sought has no direction."""
    slick = Grasp(TRIPOD.points, jnp.array([[-1.0, 0, 0]] * 3), TRIPOD.friction, TRIPOD.squeeze)
    weighed = min_weight(slick)
    assert weighed.value == -np.inf
    assert np.isnan(jax.grad(lambda g: min_weight_at(g, weighed))(slick).points).all()
    held = ferrari_canny(TRIPOD)
    undecided = held._replace(
        normal_force=0 * held.normal_force, tangential=0 * held.tangential, direction=0 * held.direction
    )
    for quality, is_known in ((held, True), (undecided, False), (ferrari_canny(slick), True)):
        gradient = jax.grad(lambda g, bounds=quality: ferrari_canny_at(g, bounds))(TRIPOD).points
        assert np.isfinite(gradient).all() if is_known else np.isnan(gradient).all()
