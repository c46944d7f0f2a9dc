"""Soft fingers: moments about the normals, within an ellipse with the tangential force."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxgrasp
from jaxgrasp import Grasp, Verdict
from jaxgrasp.testing import limited_reference
from jaxgrasp.testing.limited_problems import LimitedProblems, limited_problems
from jaxgrasp.testing.problems import exact_wrench

COUNT, N = 48, 3
HARD_ONLY = (
    jaxgrasp.literature.lagrange_forces,
    jaxgrasp.pyramid_optimum,
    jaxgrasp.least_squeeze_factor,
    jaxgrasp.split_forces,
)
KINDS = ("ordinary", "near_collinear", "coincident_some", "low_friction", "some_zero_squeeze", "scales", "combined")


def soft(kind: str, seed: int = 1) -> LimitedProblems:
    return limited_problems(kind, N, COUNT, seed, soft=True)


def solve(grasp: Grasp, wrench, weights) -> jaxgrasp.Solution:
    return jax.device_get(jaxgrasp.constrained_optimum(grasp, wrench, weights))


def wrench_of(made: LimitedProblems, solution: jaxgrasp.Solution) -> np.ndarray:
    p = made.problem
    turning = (solution.moments[..., None] * p.normals).sum(-2)
    return exact_wrench(p.points, solution.forces) + np.concatenate([0 * turning, turning], -1)


def pinch(torsion: float = 0.004) -> Grasp:
    """Return two fingers on a bar of 6 cm."""
    points, normals = [[-0.03, 0, 0], [0.03, 0, 0]], [[1.0, 0, 0], [-1, 0, 0]]
    return Grasp(points, normals, [0.5, 0.5], [4.0, 4.0], torsion=[torsion, torsion])


@pytest.mark.parametrize("sharing", ["squeeze", "uniform"])
@pytest.mark.parametrize("kind", KINDS)
def test_answers_balance_within_the_cones_and_an_independent_solver_agrees(kind, sharing):
    made = soft(kind)
    p, weights = made.problem, made.problem.weights(sharing)
    solution = solve(made.grasp, p.wrench, weights)
    solved = solution.verdict <= Verdict.OPTIMAL
    assert solved.mean() > 0.95
    size = np.linalg.norm(solution.forces, axis=-1).max(-1) + 1e-300
    reach = np.linalg.norm(p.points, axis=-1).max(-1) + made.torsion.max(-1)
    residual = np.abs(p.wrench - wrench_of(made, solution)) / np.stack([size, size * reach], -1).repeat(3, -1)
    assert (residual[solved] < 1e-10).all()
    press = np.sum(solution.forces * p.normals, -1)
    lever = made.torsion / np.where(p.friction > 0, p.friction, 1)
    spin = np.where(lever > 0, solution.moments / np.where(lever > 0, lever, 1), 0)
    across = np.linalg.norm(solution.forces - press[..., None] * p.normals, axis=-1)
    assert (np.hypot(across, spin) <= p.friction * press + 1e-13 * size[:, None]).all()
    for i in np.flatnonzero(solved)[:8]:
        theirs = limited_reference.optimum(made.case(i, weights))
        if theirs.status != "Solved":
            continue
        scale = max(theirs.objective, p.squeeze[i].sum() / 2)
        assert solution.objective[i] <= theirs.objective + 1e-8 * scale
        assert theirs.objective - solution.objective[i] < 1e-5 * scale


@pytest.mark.slow
def test_no_torsion_is_a_hard_finger():
    p = soft("ordinary").problem
    hard = solve(Grasp(p.points, p.normals, p.friction, p.squeeze), p.wrench, p.squeeze)
    none = solve(
        Grasp(p.points, p.normals, p.friction, p.squeeze, torsion=np.zeros_like(p.friction)), p.wrench, p.squeeze
    )
    assert hard.moments is None and not none.moments.any()
    np.testing.assert_array_equal(none.verdict, hard.verdict)
    # Two programs round differently, so beside the largest force that a problem needs.
    size = np.abs(hard.forces).max((1, 2))
    assert (np.abs(none.forces - hard.forces).max((1, 2)) <= 1e-11 * size).all()


@pytest.mark.slow
def test_two_soft_fingers_with_known_answers():
    """They resist the torque about their line that two hard ones cannot: here each takes half of it."""
    wrench = jnp.array([0, 0, 2.0, 0.01, 0, 0])
    solution = jaxgrasp.constrained_optimum(pinch(), wrench)
    np.testing.assert_allclose(solution.moments, [0.005, -0.005], atol=1e-14)
    assert solution.verdict == Verdict.CLOSED_FORM_OPTIMAL and solution.rank == 6
    hard = jaxgrasp.constrained_optimum(
        Grasp(*(getattr(pinch(), n) for n in ("points", "normals", "friction", "squeeze"))), wrench
    )
    assert hard.verdict == Verdict.INFEASIBLE and hard.rank == 5


@pytest.mark.slow
def test_how_little_two_soft_fingers_must_press():
    wrench = jnp.array([0, 0, 2.0, 0.01, 0, 0])
    # 1 N and 5 N.mm each: 1/0.25 + 25e-6/16e-6 of the normal force squared.
    least = 2 * np.sqrt(1 / 0.25 + 25e-6 / 16e-6)
    np.testing.assert_allclose(jaxgrasp.least_squeeze(pinch(), wrench), least, rtol=1e-8)
    assert jaxgrasp.wrench_margin(pinch(), wrench, wrench) == np.inf


@pytest.mark.slow
def test_one_soft_finger_on_a_table():
    """It presses 5 N and can turn with 0.5 x 5 N x 8 mm at most, and then slide no more: the margin is that."""
    finger = Grasp([[0.0, 0, 0]], [[0, 0, -1.0]], [0.5], [5.0], torsion=[0.008])
    pressed, turned = jnp.array([0, 0, -5.0, 0, 0, 0]), jnp.array([0, 0, 0, 0, 0, 1.0])
    np.testing.assert_allclose(jaxgrasp.wrench_margin(finger, pressed, turned), 0.04, rtol=1e-8)
    slope = jax.grad(
        lambda t: jaxgrasp.wrench_margin(Grasp([[0.0, 0, 0]], [[0, 0, -1.0]], [0.5], [5.0], torsion=t), pressed, turned)
    )
    np.testing.assert_allclose(slope(jnp.array([0.008])), [5.0], rtol=1e-6)
    beyond = jaxgrasp.reachable_wrench(finger, pressed + 0.05 * turned)
    assert beyond.verdict == Verdict.INFEASIBLE and beyond.moments.shape == (1,)
    proof = jaxgrasp.verify_certificate(finger, pressed + 0.05 * turned, beyond.certificate)
    assert proof > 5.0


@pytest.mark.slow
def test_frames_units_order_and_padding_do_not_matter():
    made = soft("ordinary")
    p = made.problem
    solution = solve(made.grasp, p.wrench, p.squeeze)
    rng = np.random.default_rng(0)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    wrench = np.concatenate([p.wrench[:, :3] @ turn.T, p.wrench[:, 3:] @ turn.T], -1)
    turned = solve(
        Grasp(p.points @ turn.T, p.normals @ turn.T, p.friction, p.squeeze, torsion=made.torsion), wrench, p.squeeze
    )
    np.testing.assert_allclose(turned.forces, solution.forces @ turn.T, rtol=1e-8, atol=1e-8)
    np.testing.assert_allclose(turned.moments, solution.moments, rtol=1e-7, atol=1e-10)
    length, force = 1000.0, 1e-3
    scaled = Grasp(length * p.points, p.normals, p.friction, force * p.squeeze, torsion=length * made.torsion)
    loads = force * p.wrench * np.repeat([1, length], 3)
    other_solution = solve(scaled, loads, force * p.squeeze)
    np.testing.assert_allclose(other_solution.moments / (length * force), solution.moments, rtol=1e-7, atol=1e-10)
    order = rng.permutation(N)
    mixed = solve(jax.tree.map(lambda x: x[:, order], made.grasp), p.wrench, p.squeeze[:, order])
    np.testing.assert_allclose(mixed.moments, solution.moments[:, order], rtol=1e-7, atol=1e-10)
    wide = [
        np.concatenate([x, np.full((COUNT, 1, *x.shape[2:]), np.nan)], 1)
        for x in (p.points, p.normals, p.friction, p.squeeze)
    ]
    present = np.repeat([[1.0] * N + [0.0]], COUNT, 0)
    padded = solve(
        Grasp(*wide, present, np.concatenate([made.torsion, np.full((COUNT, 1), np.nan)], 1)), p.wrench, wide[3]
    )
    np.testing.assert_allclose(padded.moments[:, :N], solution.moments, rtol=1e-7, atol=1e-10)
    assert not padded.moments[:, N:].any()


@pytest.mark.slow
@pytest.mark.parametrize("method", [jaxgrasp.closed_form, jaxgrasp.constrained_optimum])
def test_forward_reverse_and_differences_agree(method):
    made = soft("ordinary", seed=2)
    rng = np.random.default_rng(3)
    args = jax.tree.map(jnp.asarray, (made.grasp, made.problem.wrench))

    def compute(args):
        solution = method(*args)
        return solution.forces, solution.moments, solution.objective, solution.multiplier

    grasp, wrench = args
    scales = {"points": 0.01, "normals": 0.1, "friction": 0.1, "squeeze": 0.5, "torsion": 1e-3}
    moved = {name: size * rng.normal(size=getattr(grasp, name).shape) for name, size in scales.items()}
    moved["torsion"] = moved["torsion"] * (np.asarray(grasp.torsion) > 0)
    moves = (Grasp(**moved), 0.1 * rng.normal(size=wrench.shape))
    moves = jax.tree.map(jnp.asarray, moves)
    values, forward = jax.jit(lambda a, m: jax.jvp(compute, (a,), (m,)))(args, moves)
    pull = tuple(jnp.asarray(rng.normal(size=v.shape)) for v in values)
    back = jax.jit(lambda a, p: jax.vjp(compute, a)[1](p)[0])(args, pull)
    along = sum(jnp.vdot(p, f) for p, f in zip(pull, forward))
    across = sum(jnp.vdot(b, m) for b, m in zip(jax.tree.leaves(back), jax.tree.leaves(moves)))
    np.testing.assert_allclose(along, across, rtol=1e-9)
    step = 1e-6
    ahead = compute(jax.tree.map(lambda a, m: a + step * m, args, moves))
    behind = compute(jax.tree.map(lambda a, m: a - step * m, args, moves))
    for a, b, f in zip(ahead, behind, forward):
        slope = ((a - b) / (2 * step)).reshape(COUNT, -1)
        error = np.abs(slope - f.reshape(COUNT, -1)).max(-1) / (1 + np.abs(slope).max(-1))
        # One in twenty may have a kink within the step.
        assert np.median(error) < 1e-7 and np.mean(error < 1e-5) >= 0.95


@pytest.mark.parametrize("method", HARD_ONLY)
def test_what_knows_hard_fingers_only_says_so(method):
    with pytest.raises(ValueError, match="torsion is given"):
        method(pinch(), jnp.zeros(6))


@pytest.mark.parametrize("value", [np.nan, -1.0, np.inf])
def test_torsion_that_cannot_be_used_is_a_verdict(value):
    solution = jaxgrasp.constrained_optimum(pinch(value), jnp.array([0, 0, 2.0, 0, 0, 0]))
    assert solution.verdict == Verdict.INVALID_DATA and not np.asarray(solution.forces).any()


@pytest.mark.slow
def test_moments_use_up_the_friction_margin():
    """On the ellipse the margin is zero, whatever the share of the moment in it; and monitor sees the contact slide."""
    share = np.linspace(0, 1, 9)
    points, normals = np.zeros((9, 1, 3)), np.broadcast_to([0, 0, 1.0], (9, 1, 3))
    units = np.ones((9, 1))
    grasp = Grasp(points, normals, 0.5 * units, units, torsion=0.01 * units)
    forces = np.stack([0.5 * np.sqrt(1 - share**2), 0 * share, 1 + 0 * share], -1)[:, None]
    moments = 0.01 * share[:, None]
    np.testing.assert_allclose(jaxgrasp.friction_margin(grasp, forces, moments), 0, atol=1e-15)
    assert (np.asarray(jaxgrasp.friction_margin(grasp, forces, 0.9 * moments))[1:] > 0).all()
    with pytest.raises(ValueError, match="moments is None"):
        jaxgrasp.friction_margin(grasp, forces)
    with pytest.raises(ValueError, match="moments is given"):
        jaxgrasp.friction_margin(Grasp(points, normals, 0.5 * units, units), forces, moments)
    held = jaxgrasp.grip.monitor(pinch(), jnp.array([0, 0, 0, 0.04, 0, 0]))
    assert (held.touches == jaxgrasp.grip.Touch.SLIDES).all() and held.hold == jaxgrasp.grip.Hold.SLIPPING
