"""Limits of normal forces and joint torques: KKT conditions, an independent oracle, certificates, derivatives."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxgrasp
from jaxgrasp import Grasp, Limits, Route, Verdict
from jaxgrasp.testing import limited_reference
from jaxgrasp.testing.limited_problems import LimitedProblems, limited_problems

COUNT, N, JOINTS = 48, 4, 5
KINDS = (
    "ordinary",
    "near_collinear",
    "low_friction",
    "some_zero_squeeze",
    "wide_squeeze",
    "infeasible",
    "scales",
    "far_frame",
    "combined",
)


def solve(made: LimitedProblems, sharing: str = "squeeze") -> jaxgrasp.Solution:
    # Weights as an array, so that both sharings are one piece of compiled code.
    return jax.device_get(_solve(made.grasp, made.problem.wrench, made.problem.weights(sharing), made.limits))


def _solve(grasp, wrench, sharing, limits):
    return jaxgrasp.constrained_optimum(grasp, wrench, sharing, limits=limits)


def everything(kind: str, seed: int = 1) -> LimitedProblems:
    return limited_problems(kind, N, COUNT, seed, soft=True, bounded=True, joints=JOINTS)


def torques(made: LimitedProblems, solution: jaxgrasp.Solution) -> np.ndarray:
    pushes = np.concatenate([solution.forces, solution.moments[..., None]], -1)
    return np.einsum("bnc,bncj->bj", pushes, made.torque_map)


def relative_size(made: LimitedProblems, solution: jaxgrasp.Solution) -> np.ndarray:
    """Return the largest error of each torque that the rounding of the forces can cause."""
    largest = np.abs(np.concatenate([solution.forces, solution.moments[..., None]], -1)).max((1, 2))
    return np.abs(made.torque_map).sum((1, 2)) * largest[:, None]


@pytest.mark.parametrize("sharing", ["squeeze", "uniform"])
@pytest.mark.parametrize("kind", KINDS)
def test_answers_obey_every_law_of_an_optimum(kind, sharing):
    """Balance, cones, bounds, and a multiplier for each limit that holds, of the right sign: stationary for each."""
    made = everything(kind)
    p, solution = made.problem, solve(made, sharing)
    solved = solution.verdict <= Verdict.OPTIMAL
    assert solved.mean() > 0.95 if p.witness is not None else not solved.any()
    if not solved.any():
        return
    p, made, solution = (
        jax.tree.map(lambda x: x[solved] if isinstance(x, np.ndarray) else x, t) for t in (p, made, solution)
    )
    press = np.sum(solution.forces * p.normals, -1)
    size = np.linalg.norm(solution.forces, axis=-1).max(-1, keepdims=True)
    lever = made.torsion / np.where(p.friction > 0, p.friction, 1)
    spin = np.where(lever > 0, solution.moments / np.where(lever > 0, lever, 1), 0)
    across = np.linalg.norm(solution.forces - press[..., None] * p.normals, axis=-1)
    assert (np.hypot(across, spin) <= p.friction * press + 1e-13 * size).all()
    moves = (p.squeeze > 0) | (sharing == "uniform")
    assert (press >= made.normal_min * moves - 1e-13 * size).all()
    assert (press <= made.normal_max + 1e-13 * size).all()
    torque, rounding = torques(made, solution), 1e-10 * relative_size(made, solution)
    assert (np.abs(torque) <= made.torque_max + rounding).all()
    binds = solution.torque_multiplier != 0
    assert (np.abs(torque - np.sign(solution.torque_multiplier) * made.torque_max) <= rounding)[binds].all()
    at_bound = np.where(solution.normal_multiplier > 0, made.normal_max, made.normal_min)
    assert (np.abs(press - at_bound) <= 1e-13 * size)[solution.normal_multiplier != 0].all()
    assert (solution.residual < 1e-10).all()


@pytest.mark.parametrize("sharing", ["squeeze", "uniform"])
@pytest.mark.parametrize("kind", KINDS[:6])
def test_an_independent_solver_agrees(kind, sharing):
    made = everything(kind)
    weights = made.problem.weights(sharing)
    solution = solve(made, sharing)
    for i in range(16):
        theirs = limited_reference.optimum(made.case(i, weights))
        solved = solution.verdict[i] <= Verdict.OPTIMAL
        assert solved == (theirs.status in ("Solved", "AlmostSolved")), (i, theirs.status, solution.verdict[i])
        if not solved:
            assert solution.verdict[i] == Verdict.INFEASIBLE
            continue
        scale = made.problem.squeeze[i].sum()
        assert abs(theirs.objective - solution.objective[i]) < 1e-8 * scale
        largest = np.abs(theirs.forces).max()
        assert np.abs(theirs.forces - solution.forces[i]).max() < 1e-5 * largest
        assert np.abs(theirs.moments - solution.moments[i]).max() < 1e-5 * largest * 0.02


@pytest.mark.slow
def test_limits_that_do_not_bind_change_nothing():
    made = everything("ordinary")
    free = jax.device_get(jaxgrasp.constrained_optimum(made.grasp, made.problem.wrench))
    weights = made.problem.squeeze
    loose = Limits(
        normal_min=0 * made.normal_min,
        normal_max=np.full_like(made.normal_max, np.inf),
        torque_map=made.torque_map,
        torque_max=np.full_like(made.torque_max, np.inf),
    )
    solution = jax.device_get(_solve(made.grasp, made.problem.wrench, weights, loose))
    for name in ("forces", "moments", "objective", "multiplier"):
        np.testing.assert_allclose(getattr(solution, name), getattr(free, name), rtol=1e-12, atol=1e-12)
    for name in ("verdict", "route", "steps"):
        np.testing.assert_array_equal(getattr(solution, name), getattr(free, name))
    assert not solution.normal_multiplier.any() and not solution.torque_multiplier.any()


@pytest.mark.slow
def test_multipliers_are_what_a_limit_costs():
    """The objective's derivative by a bound is its multiplier: the envelope theorem, by JAX's own derivative."""
    made = everything("ordinary")
    solution = solve(made)

    def total(limits):
        return jnp.sum(_solve(made.grasp, made.problem.wrench, "squeeze", limits).objective)

    slopes = jax.device_get(jax.jit(jax.grad(total))(made.limits))
    np.testing.assert_allclose(slopes.torque_max, -np.abs(solution.torque_multiplier), rtol=1e-7, atol=1e-9)
    np.testing.assert_allclose(slopes.normal_max, -np.maximum(solution.normal_multiplier, 0), rtol=1e-7, atol=1e-9)
    np.testing.assert_allclose(slopes.normal_min, np.maximum(-solution.normal_multiplier, 0), rtol=1e-7, atol=1e-9)


LIMIT_SIZES = {"normal_min": 0.1, "normal_max": 0.1, "torque_map": 0.01, "torque_max": 0.01}


def differentiable(solution):
    names = ("forces", "moments", "objective", "multiplier", "normal_multiplier", "torque_multiplier")
    return tuple(getattr(solution, name) for name in names)


@pytest.mark.slow
def test_forward_reverse_and_differences_agree():
    made = everything("ordinary", seed=2)
    rng = np.random.default_rng(3)
    args = jax.tree.map(jnp.asarray, (made.grasp, made.problem.wrench, made.limits))
    compute = jax.jit(lambda args: differentiable(_solve(args[0], args[1], "squeeze", args[2])))

    def random(x, size):
        return jnp.where(jnp.isfinite(x) & (x != 0), size, 0) * rng.normal(size=x.shape)

    grasp, wrench, limits = args
    moves = (
        Grasp(
            random(grasp.points, 0.01),
            random(grasp.normals, 0.1),
            random(grasp.friction, 0.1),
            random(grasp.squeeze, 0.5),
            torsion=random(grasp.torsion, 1e-3),
        ),
        random(wrench, 0.1),
        Limits(**{name: random(getattr(limits, name), size) for name, size in LIMIT_SIZES.items()}),
    )
    values, forward = jax.jit(lambda a, m: jax.jvp(compute, (a,), (m,)))(args, moves)
    pull = tuple(jnp.asarray(rng.normal(size=v.shape)) for v in values)
    back = jax.jit(lambda a, p: jax.vjp(compute, a)[1](p)[0])(args, pull)
    assert all(np.isfinite(x).all() for x in jax.tree.leaves(back))
    along = sum(jnp.vdot(p, f) for p, f in zip(pull, forward))
    across = sum(jnp.vdot(b, m) for b, m in zip(jax.tree.leaves(back), jax.tree.leaves(moves)))
    np.testing.assert_allclose(along, across, rtol=1e-9)
    step = 1e-6
    ahead = compute(jax.tree.map(lambda a, m: a + step * m, args, moves))
    behind = compute(jax.tree.map(lambda a, m: a - step * m, args, moves))
    smooth = np.ones(COUNT, bool)
    # A limit that begins or ceases to bind within the step is a kink: there no difference is the derivative.
    for a, b in zip(ahead[4:], behind[4:]):
        smooth &= ((np.asarray(a) != 0) == (np.asarray(b) != 0)).all(-1)
    assert smooth.mean() > 0.9
    for name, a, b, f in zip("fmolnt", ahead, behind, forward):
        slope = ((a - b) / (2 * step)).reshape(COUNT, -1)
        error = np.abs(slope - f.reshape(COUNT, -1)).max(-1) / (1 + np.abs(slope).max(-1))
        assert np.median(error) < 1e-8 and np.mean(error[smooth] < 1e-5) > 0.95, (name, error)


@pytest.mark.slow
def test_one_problem_a_batch_and_a_mapped_call_agree():
    made = everything("ordinary")
    expected = solve(made)
    mapped = jax.device_get(
        jax.vmap(lambda g, w, limits: _solve(g, w, "squeeze", limits))(made.grasp, made.problem.wrench, made.limits)
    )
    for name in ("forces", "moments", "torque_multiplier", "normal_multiplier", "verdict", "certificate_rates"):
        np.testing.assert_allclose(getattr(expected, name), getattr(mapped, name), rtol=1e-9, atol=1e-11)
    shared = jax.tree.map(lambda x: x[:1], (made.grasp, made.limits))
    wrenches = made.problem.witness[0].sum(0)
    loads = np.concatenate([np.tile(wrenches, (8, 1)), np.tile(made.problem.wrench[0, 3:], (8, 1))], -1)
    loads *= np.linspace(0.5, 1.2, 8)[:, None]
    together = jax.device_get(_solve(shared[0], loads, "squeeze", shared[1]))
    copies = jax.tree.map(lambda x: np.repeat(np.asarray(x), 8, 0), shared)
    apart = jax.device_get(_solve(copies[0], loads, "squeeze", copies[1]))
    np.testing.assert_array_equal(together.verdict, apart.verdict)
    np.testing.assert_allclose(together.forces, apart.forces, rtol=1e-9, atol=1e-10)


@pytest.mark.slow
def test_the_order_of_joints_and_absent_contacts_do_not_matter():
    made = everything("low_friction")
    solution = solve(made)
    order = np.random.default_rng(0).permutation(JOINTS)
    turned = solve(made._replace(torque_map=made.torque_map[..., order], torque_max=made.torque_max[:, order]))
    np.testing.assert_allclose(turned.forces, solution.forces, rtol=1e-8, atol=1e-9)
    np.testing.assert_allclose(turned.torque_multiplier, solution.torque_multiplier[:, order], rtol=1e-7, atol=1e-9)

    def padded(x, fill):
        return np.concatenate([x, np.full((COUNT, 1, *x.shape[2:]), fill)], 1)

    p = made.problem
    fields = [padded(x, np.nan) for x in (p.points, p.normals, p.friction, p.squeeze)]
    grasp = Grasp(*fields, padded(np.ones_like(p.friction), 0.0), padded(made.torsion, np.nan))
    limits = Limits(
        normal_min=padded(made.normal_min, np.nan),
        normal_max=padded(made.normal_max, np.nan),
        torque_map=padded(made.torque_map, np.nan),
        torque_max=made.torque_max,
    )
    wider = jax.device_get(_solve(grasp, p.wrench, "squeeze", limits))
    np.testing.assert_array_equal(wider.verdict, solution.verdict)
    np.testing.assert_allclose(wider.forces[:, :N], solution.forces, rtol=1e-8, atol=1e-9)
    assert not wider.forces[:, N:].any() and not wider.normal_multiplier[:, N:].any()


def test_what_is_out_of_reach_is_proven():
    """A quarter of the torque that the witness needs: what then is infeasible is so by arithmetic alone."""
    made = everything("ordinary")
    tight = made._replace(torque_max=0.25 * made.torque_max)
    solution = solve(tight)
    hopeless = solution.verdict == Verdict.INFEASIBLE
    # About one in a hundred of such tight ones stays undecided; none is called solved that is not.
    assert hopeless.sum() > 5 and (solution.verdict == Verdict.NOT_CONVERGED).sum() <= 1
    proof = (tight.grasp, tight.problem.wrench, solution.certificate)
    load = np.linalg.norm(tight.problem.wrench[:, :3], axis=-1) + tight.problem.squeeze.sum(-1)
    need = np.asarray(jaxgrasp.verify_certificate(*proof, limits=tight.limits, rates=solution.certificate_rates))
    assert (need[hopeless] > 1e5 * load[hopeless]).all()
    # Without what the joints do the twist proves nothing: these wrenches are in the contacts' reach.
    free = np.asarray(jaxgrasp.verify_certificate(*proof))
    assert (free[hopeless] < 1e5 * load[hopeless]).any()
    for i in np.flatnonzero(hopeless)[:6]:
        theirs = limited_reference.optimum(tight.case(i, tight.problem.squeeze))
        assert theirs.status in ("PrimalInfeasible", "AlmostPrimalInfeasible")


@pytest.mark.slow
def test_a_pinch_with_known_answers():
    """Two fingers press 4 N each and share a load of 2 N across; joints that feel the pressing allow 3 N."""
    grasp = Grasp([[-0.03, 0, 0], [0.03, 0, 0]], [[1.0, 0, 0], [-1, 0, 0]], [0.5, 0.5], [4.0, 4.0])
    wrench = jnp.array([0, 0, 2.0, 0, 0, 0])
    pressing = jnp.zeros((2, 3, 1)).at[0, 0, 0].set(0.05)

    def hold(torque_max=(1.0,), normal_min=(0.0, 0.0), normal_max=(np.inf, np.inf)):
        bounds = Limits(
            normal_min=list(normal_min), normal_max=list(normal_max), torque_map=pressing, torque_max=list(torque_max)
        )
        return jaxgrasp.constrained_optimum(grasp, wrench, "uniform", limits=bounds)

    solution = hold([0.15])
    np.testing.assert_allclose(solution.forces, [[3, 0, 1], [-3, 0, 1]], atol=1e-12)
    # d objective / d torque: both fingers give way by 20 N/(N.m), each 1 N from where it wants to be.
    np.testing.assert_allclose(solution.torque_multiplier, [2 * 1 / 0.05], rtol=1e-10)
    np.testing.assert_allclose(hold(normal_max=[3.5, 9.0]).forces, [[3.5, 0, 1], [-3.5, 0, 1]], atol=1e-12)
    np.testing.assert_allclose(hold(normal_min=[0.0, 6.0]).forces, [[6, 0, 1], [-6, 0, 1]], atol=1e-12)
    assert hold(normal_max=[1.9, 9.0]).verdict == Verdict.INFEASIBLE
    assert hold([0.09]).verdict == Verdict.INFEASIBLE
    assert hold(normal_min=[3.0, 0.0], normal_max=[9.0, 2.0]).verdict == Verdict.INFEASIBLE


@pytest.mark.slow
def test_contacts_that_cannot_move_are_asked_of_the_joints_too():
    """Method B with a finger of no squeeze: the joint behind the other, which must push, is all that counts."""
    points, normals = [[0, 0, -0.02], [0, 0, 0.02]], [[0, 0, 1.0], [0, 0, -1.0]]
    jacobian = jnp.zeros((2, 3, 1)).at[0, 2, 0].set(0.1).at[1, 2, 0].set(-0.1)
    held = jnp.array([0.0, 1.0])

    def verdict(limit: float) -> int:
        limits = Limits(torque_map=jacobian, torque_max=[limit])
        solution = jaxgrasp.constrained_optimum(
            Grasp(points, normals, [0.5, 0.5], [3.0, 2.0]), jnp.array([0, 0, 1.0, 0, 0, 0]), held, limits=limits
        )
        return int(solution.verdict)

    # The first finger holds 3 N, the second then presses with 2 N: together 0.5 N.m.
    assert verdict(0.5001) <= Verdict.OPTIMAL
    assert verdict(0.4999) == Verdict.INFEASIBLE


@pytest.mark.slow
def test_many_limits_at_once_and_single_precision():
    made = limited_problems("ordinary", 3, 24, 5, bounded=True, joints=20)
    solution = solve(made)
    assert (solution.verdict <= Verdict.OPTIMAL).all()
    assert ((solution.torque_multiplier != 0).sum(-1) >= 1).any()
    single = jax.tree.map(lambda x: x.astype(np.float32), (made.grasp, made.problem.wrench, made.limits))
    rough = jax.device_get(_solve(single[0], single[1], "squeeze", single[2]))
    assert rough.forces.dtype == np.float32 and (rough.verdict <= Verdict.OPTIMAL).mean() > 0.9
    good = rough.verdict <= Verdict.OPTIMAL
    error = np.abs(rough.forces - solution.forces).max((1, 2)) / np.abs(solution.forces).max((1, 2))
    assert np.median(error[good]) < 1e-4


@pytest.mark.slow
def test_a_guided_object_within_limits():
    """On a rail only the push along it is asked for: a joint that allows less than that makes it infeasible."""
    grasp = Grasp([[-0.03, 0, 0], [0.03, 0, 0]], [[1.0, 0, 0], [-1, 0, 0]], [0.5, 0.5], [4.0, 4.0])
    rail = jnp.eye(6)[:, 2:3]
    lifting = jnp.zeros((2, 3, 1)).at[0, 2, 0].set(0.1)

    def push(limit):
        limits = Limits(torque_map=lifting, torque_max=jnp.array([limit]))
        return jaxgrasp.constrained_optimum(grasp, jnp.array([0, 0, 2.0, 0, 0, 0]), limits=limits, free=rail)

    np.testing.assert_allclose(push(0.05).forces[:, 2], [0.5, 1.5], atol=1e-10)
    assert push(1.0).route == Route.ROBUST and not push(1.0).torque_multiplier.any()


@pytest.mark.parametrize(
    ("limits", "message"),
    [
        ({"torque_map": np.ones((N, 3, 2))}, "torque_max is None"),
        ({"torque_max": np.ones(2)}, "torque_map is None"),
        ({"torque_map": np.ones((N + 1, 3, 2)), "torque_max": np.ones(2)}, "torque_map has shape"),
        ({"torque_map": np.ones((N, 2, 2)), "torque_max": np.ones(2)}, "torque_map has shape"),
        ({"torque_map": np.ones((N, 3, 2)), "torque_max": np.ones(3)}, "torque_max has shape"),
        ({"normal_max": np.ones(N + 1)}, "normal_max has shape"),
    ],
)
def test_shapes_that_do_not_fit_are_named(limits, message, unchecked):
    grasp = everything("ordinary").grasp
    single_grasp = jax.tree.map(lambda x: x[0], grasp)
    with pytest.raises(ValueError, match=message):
        jaxgrasp.constrained_optimum(single_grasp, jnp.zeros(6), limits=Limits(**limits))


@pytest.mark.parametrize("field", ["normal_min", "normal_max", "torque_map", "torque_max"])
def test_numbers_that_cannot_be_used_are_a_verdict(field):
    made = everything("ordinary")
    spoilt = getattr(made, field).copy()
    spoilt[3, ..., 0] = np.nan
    spoilt[5, ..., 0] = -1.0
    solution = solve(made._replace(**{field: spoilt}))
    assert solution.verdict[3] == Verdict.INVALID_DATA
    assert (solution.verdict[5] == Verdict.INVALID_DATA) == (field != "torque_map")
    assert all(np.isfinite(x).all() for x in jax.tree.leaves(solution))
    others = np.delete(np.arange(COUNT), [3, 5])
    np.testing.assert_allclose(solution.forces[others], solve(made).forces[others], rtol=1e-9, atol=1e-10)


def test_a_solver_from_outside_takes_no_limits():
    import optimistix as optx

    made = everything("ordinary")
    with pytest.raises(ValueError, match="limits and solver are both given"):
        jaxgrasp.constrained_optimum(
            made.grasp, made.problem.wrench, limits=made.limits, solver=optx.Newton(rtol=1e-8, atol=1e-8)
        )


@pytest.mark.slow
def test_padding_leaves_no_trace_in_derivatives():
    """NaN behind an absent contact must not reach a gradient."""
    grasp = Grasp(
        [[-0.03, 0, 0], [0.03, 0, 0], [np.nan] * 3],
        [[1.0, 0, 0], [-1, 0, 0], [np.nan] * 3],
        [0.5, 0.5, np.nan],
        [4.0, 4.0, np.nan],
        [1.0, 1.0, 0.0],
        [0.004, 0.0, np.nan],
    )
    limits = Limits(
        normal_max=[3.5, np.inf, np.nan],
        torque_map=jnp.full((3, 4, 1), 0.01).at[2].set(jnp.nan),
        torque_max=[0.05],
    )

    def loss(arguments):
        grasp, limits = arguments
        return jnp.sum(_solve(grasp, jnp.array([0, 0, 2.0, 0.01, 0, 0]), "squeeze", limits).forces ** 2)

    value, slopes = jax.value_and_grad(loss)((grasp, limits))
    assert np.isfinite(value) and all(np.isfinite(x).all() for x in jax.tree.leaves(slopes))
    assert not np.asarray(eqx.filter(slopes[1], eqx.is_array).torque_map)[2].any()
