"""The public answers: which force at each contact, by closed form or by constrained optimum, and the optimum's dual.

The closed form by the paper's first route: the whole Lagrange system, by Gaussian elimination.

The dual is a function of the multiplier, in plain JAX. For the cones K_i and the multiplier x, a virtual twist about
the frame's origin,

    q(x) = w.x + sum of  min over f in K_i of  |f - s_i a_i|^2 / (2 k_i) - f.(G_i^T x).

It is concave, its gradient is w - G f(x), and by weak duality no allowed forces that balance w cost less.
"""

import warnings
from dataclasses import fields, replace
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxgrasp.model.arguments import check_arguments
from jaxgrasp.model.arrays import AnyArray, Float
from jaxgrasp.model.grasp import Grasp, Limits
from jaxgrasp.model.solution import Solution, Verdict
from jaxgrasp.model.wrench import grasp_matrix
from jaxgrasp.problem import contact_vec, spatial
from jaxgrasp.problem.batch_last import ProblemBatch, to_batch_last
from jaxgrasp.problem.contact_vec import ContactVec
from jaxgrasp.problem.flatten import Sharing, flatten, named_weights, read_sharing, refuse_soft_fingers
from jaxgrasp.problem.spatial import SpatialVec
from jaxgrasp.solver import by_optimistix, dual, transforms
from jaxgrasp.solver import last_resort as extended
from jaxgrasp.solver.dispatch import dispatch, with_derivative
from jaxgrasp.validation.checked import checked


def closed_form(
    grasp: Grasp,
    wrench: Float[AnyArray, "*#batch 6"],
    sharing: Sharing = "squeeze",
    *,
    free: Float[AnyArray, "*#batch 6 k"] | None = None,
    devices: int | None = None,
) -> Solution:
    """Compute the forces closest to the squeezing forces that balance a wrench, friction not imposed.

    Minimises the sum of |f_i - s_i a_i|^2 / (2 k_i) subject to G f = w.

    Args:
        grasp: contacts ``(..., n)``; leading axes broadcast against the wrench's.
        wrench: what the contacts must exert ``(..., 6)`` [N, N.m].
        sharing: the weights k: ``"uniform"`` or ``"A"`` for 1, method A (eq. 11); ``"squeeze"`` or ``"B"`` for s,
            method B (eq. 15, Proposition 1); or an array ``(..., n)`` of weights, zero or more. A contact of
            weight zero keeps its squeezing force, or the bound next to it.
        free: twists (linear, angular) about the frame's origin along which a guide lets the object move, as the
            columns of ``(..., 6, k)``, k from 1 to 6, of any size; ``None`` for an object that no guide holds. Only
            the wrench's work along these is balanced, free^T (G f - w) = 0: the guide, without friction, carries
            the rest of w - G f. Residual, rank and certificate are then those of the free twists.
        devices: over how many of JAX's local devices to spread the batch, a part for each; ``None`` leaves it where it
            is. Not inside other programs, and not where derivatives are taken: there ``jax.shard_map`` does it.

    Returns:
        A Solution whose verdict says whether these forces lie inside the friction cones too.

    Raises:
        ValueError: for a sharing that is not one of these, shapes that do not fit, or more devices than there are.
    """
    check_arguments(grasp, {"wrench": (wrench, (6,))}, {"free": (free, ())})
    return dispatch(transforms.closed_form(free), grasp, wrench, sharing, free=free, devices=devices)


def constrained_optimum(
    grasp: Grasp,
    wrench: Float[AnyArray, "*#batch 6"],
    sharing: Sharing = "squeeze",
    *,
    free: Float[AnyArray, "*#batch 6 k"] | None = None,
    limits: Limits | None = None,
    safety: float | AnyArray = 1.0,
    largest_force: float | AnyArray | None = None,
    start: Float[AnyArray, "*#batch 6"] | None = None,
    solver: Any = None,
    devices: int | None = None,
    last_resort: bool = False,
) -> Solution:
    """Solve the closed form's problem with Coulomb's cones imposed (eqs. 1 to 3 with eq. 5 or 13) exactly.

    Args:
        grasp: contacts ``(..., n)``; leading axes broadcast against the wrench's.
        wrench: what the contacts must exert ``(..., 6)`` [N, N.m].
        sharing: as for [`jaxgrasp.closed_form`][].
        free: of an object that a guide holds, the twists left to it, as for [`jaxgrasp.closed_form`][].
        limits: what the hand can exert: bounds of normal forces and of joint torques, ``(..., n)`` and ``(..., j)``.
            Where no torque exceeds its limit, torque limits cost one check only.
        safety: friction is divided by this, since an optimum on a cone's surface has no margin left: a number
            greater than 0, or one for each problem, an array of the leading axes.
        largest_force: what the hand could exert at most, as a sum of normal forces [N], a number or one for each
            problem. An INFEASIBLE whose certificate proves less, ``force_bound``, is no answer then and comes back as
            NOT_CONVERGED: in float32 a proof may end at 20 times the load. ``None`` takes any proof.
        start: the ``multiplier`` of a problem close by, such as the instant before in a loop that solves one after
            the other: where cones are active, fewer steps lead from there. The answer does not depend on it. A
            batch of instants is faster still, and needs none.
        solver: ``None`` for this package's own Newton method; or an optimistix root finder, least-squares
            solver or minimiser, which then climbs the dual in at most 256 steps, such as
            ``optimistix.Newton(rtol=1e-8, atol=1e-8)``. What it finds is OPTIMAL only where it stands our
            own tests of residual, duality gap and balance, at the larger of its rtol and atol; else
            NOT_CONVERGED. Derivatives are the same.
        devices: over how many of JAX's local devices to spread the batch, as for [`jaxgrasp.closed_form`][].
        last_resort: solve problems that stay NOT_CONVERGED or FEASIBLE once more in extended precision, by NumPy on the
            host, and take the answers that stand a test there. Costs a few tenths of a second for each call that has
            such problems, and nothing else but the wait for the answers. Not inside other programs, nor where
            derivatives are taken, and not with free, limits or solver. A warning where long double is no wider than
            float64, as on ARM processors of Apple and on Windows: there nothing is solved again.

    Returns:
        A Solution. Where the closed form lies inside all cones it is the answer, at the cost of the closed form; where
        no forces exist the verdict is INFEASIBLE and the certificate proves it.

    Example:
        Two fingers lift 2 N between them; one newton goes to each:

        >>> import numpy as np
        >>> from jaxgrasp import Grasp, Verdict, constrained_optimum
        >>> points, normals = np.array([[1.0, 0, 0], [-1.0, 0, 0]]), np.array([[-1.0, 0, 0], [1.0, 0, 0]])
        >>> grasp = Grasp(points, normals, friction=[0.5, 0.5], squeeze=[4.0, 4.0])
        >>> best = constrained_optimum(grasp, np.array([0.0, 0, 2, 0, 0, 0]))
        >>> Verdict(int(best.verdict)).name, best.forces.round(6).tolist()
        ('CLOSED_FORM_OPTIMAL', [[-4.0, 0.0, 1.0], [4.0, 0.0, 1.0]])

    Raises:
        ValueError: for a sharing, a safety or a largest_force that cannot be used, shapes that do not fit, a start
            beside free or solver, or a last_resort where it cannot be.
        TypeError: for a solver that is none of these, or whose settings are arrays.
    """
    check_arguments(grasp, {"wrench": (wrench, (6,))}, {"free": (free, ()), "start": (start, (6,))})
    if solver is not None:
        by_optimistix.check_solver(solver)
    if start is not None and not (free is None and solver is None):
        raise ValueError(
            f"start and {'free' if solver is None else 'solver'} are both given: expected only one of them"
        )
    divisor = _read_safety(grasp, safety)
    largest_force = _read_largest_force(largest_force)
    if solver is not None and limits is not None:
        raise ValueError("limits and solver are both given: expected only one, since solvers do not support limits")
    if last_resort:
        _check_last_resort((grasp, wrench, sharing, divisor), {"free": free, "limits": limits, "solver": solver})
    torque_max = None if limits is None else limits.torque_max
    solve = transforms.optimum(free, torque_max) if solver is None else transforms.optimum_by(solver)
    solution = dispatch(
        solve, grasp, wrench, sharing, free=free, start=start, limits=limits, safety=divisor, devices=devices
    )
    if last_resort:
        solution = _with_last_resort(solution, grasp, wrench, sharing, divisor)
    if largest_force is None:
        return solution
    short = (solution.verdict == Verdict.INFEASIBLE) & (solution.force_bound < largest_force)
    return replace(solution, verdict=jnp.where(short, Verdict.NOT_CONVERGED, solution.verdict))


def closed_form_and_optimum(
    grasp: Grasp,
    wrench: Float[AnyArray, "*#batch 6"],
    sharing: Sharing = "squeeze",
    *,
    free: Float[AnyArray, "*#batch 6 k"] | None = None,
    devices: int | None = None,
) -> tuple[Solution, Solution]:
    """Compute both solutions at the cost of the optimum, which begins with the closed form.

    Args and errors are those of [`jaxgrasp.closed_form`][].
    """
    check_arguments(grasp, {"wrench": (wrench, (6,))}, {"free": (free, ())})
    return dispatch(transforms.closed_form_and_optimum(free), grasp, wrench, sharing, free=free, devices=devices)


def known_closed_form_and_optimum(
    grasp: Grasp,
    wrench: Float[AnyArray, "*#batch 6"],
    sharing: Sharing,
    known: tuple[Solution, Solution],
    *,
    free: Float[AnyArray, "*#batch 6 k"] | None = None,
) -> tuple[Solution, Solution]:
    """Return both solutions, which ``closed_form_and_optimum`` gave for these arguments, with their derivatives."""
    return with_derivative(transforms.closed_form_and_optimum(free), grasp, wrench, sharing, known, free=free)


def _check_last_resort(arguments: tuple, others: dict[str, Any]) -> None:
    """Raise ValueError where the last resort cannot be had, and warn where long double has no digits to spare."""
    for name, value in others.items():
        if value is not None:
            raise ValueError(f"{name} and last_resort are both given: expected only one of them")
    if any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(arguments)):
        raise ValueError("last_resort is given inside jit, vmap or grad: leave last_resort out")
    if not extended.is_available():
        warnings.warn("last_resort has no effect: long double is no wider than float64 on this machine", stacklevel=3)


def _with_last_resort(
    solution: Solution, grasp: Grasp, wrench: AnyArray, sharing: Sharing, safety: float | AnyArray | None
) -> Solution:
    """Return the solution with those answers that extended precision finds to its undecided problems."""
    verdict = np.asarray(solution.verdict)
    lanes = np.flatnonzero((verdict == Verdict.NOT_CONVERGED) | (verdict == Verdict.FEASIBLE))
    if not len(lanes) or not extended.is_available():
        return solution
    name, weights = read_sharing(sharing)
    grasp, wrench, weights = jax.tree.map(np.asarray, (grasp, wrench, weights))
    flat = flatten(grasp, wrench, weights, name, safety=safety, numpy=np)
    n_axes, size = verdict.ndim, verdict.size
    arrays = {field.name: getattr(solution, field.name) for field in fields(solution)}
    rows = {
        field: np.asarray(array).reshape(size, *array.shape[n_axes:])
        for field, array in arrays.items()
        if array is not None
    }
    patched = extended.patched(rows, lanes, extended.decide(flat.problem, lanes))
    return replace(solution, **{field: jnp.asarray(patched[field].reshape(arrays[field].shape)) for field in rows})


def _read_largest_force(largest_force: float | AnyArray | None) -> float | AnyArray | None:
    if largest_force is not None and not isinstance(largest_force, jax.core.Tracer):
        values = np.asarray(largest_force)
        if values.dtype.kind not in "fiu" or not np.all(values >= 0):
            raise ValueError(f"largest_force is {largest_force!r}: expected a number, 0 or more, or an array of them")
    return largest_force


def _read_safety(grasp: Grasp, safety: float | AnyArray) -> float | AnyArray | None:
    """Check the safety to divide friction by; return None where it is 1, so that no division is needed."""
    if isinstance(safety, (int, float)) and safety == 1:
        return None
    if not isinstance(safety, jax.core.Tracer):
        values = np.asarray(safety)
        if values.dtype.kind not in "fiu" or not np.all(values > 0):
            raise ValueError(f"safety is {safety!r}: expected a number greater than 0, or an array of them")
    shape, leading = np.shape(safety), np.shape(grasp.friction)[:-1]
    try:
        np.broadcast_shapes(shape, leading)
    except ValueError:
        raise ValueError(
            f"safety has shape {shape}: expected a number, or one that fits friction's {leading}"
        ) from None
    return safety


class ForceSplit(NamedTuple):
    """The two terms of eq. 16; their sum is the closed form."""

    external: Array
    """Manipulation forces ``(..., n, 3)`` [N]: they balance the wrench."""
    internal: Array
    """Squeezing forces less their own resultant ``(..., n, 3)`` [N]: they balance to zero."""


def split_forces(grasp: Grasp, wrench: Float[AnyArray, "*#batch 6"], sharing: Sharing = "squeeze") -> ForceSplit:
    """Split the closed form into external (manipulation) and internal (grasping) forces, eq. 16; hard fingers only.

    Raises:
        ValueError: for soft fingers, a sharing that cannot be used, or shapes that do not fit.
    """
    check_arguments(grasp, {"wrench": (wrench, (6,))}, {})
    refuse_soft_fingers(grasp)
    squeeze = jnp.asarray(grasp.squeeze)
    name, weights = read_sharing(sharing)
    if weights is None:
        weights = named_weights(grasp, name, jnp)
    relaxed = eqx.tree_at(lambda g: g.squeeze, grasp, jnp.zeros_like(squeeze))
    wrench = jnp.asarray(wrench)
    return ForceSplit(
        external=dispatch(transforms.closed_form(), relaxed, wrench, weights).forces,
        internal=dispatch(transforms.closed_form(), grasp, jnp.zeros_like(wrench), weights).forces,
    )


@checked
def lagrange_forces(
    grasp: Grasp, wrench: Float[AnyArray, "*batch 6"], weights: Float[AnyArray, "*batch n"] | None = None
) -> tuple[Float[Array, "*batch n 3"], Float[Array, "*batch 6"]]:
    """Solve eqs. 7 to 9 for forces and multiplier as one system of 3n + 6 unknowns.

    It shares nothing with [`jaxgrasp.closed_form`][] but the problem, costs O(n^3), and needs a grasp
    matrix of rank 6: on a singular grasp the numbers mean nothing. Absent contacts are not supported.

    Args:
        grasp: contacts ``(..., n)``.
        wrench: what the contacts must exert ``(..., 6)``.
        weights: sharing weights ``(..., n)``; all one (method A) where not given.
    """
    refuse_soft_fingers(grasp)
    points, normals = jnp.asarray(grasp.points), jnp.asarray(grasp.normals)
    squeeze, wrench = jnp.asarray(grasp.squeeze), jnp.asarray(wrench)
    *batch, n, _ = points.shape
    weight = jnp.ones_like(squeeze) if weights is None else jnp.asarray(weights)
    matrix = grasp_matrix(points)
    weighted_rows = jnp.repeat(weight, 3, -1)[..., None] * jnp.swapaxes(matrix, -1, -2)
    identity = jnp.broadcast_to(jnp.eye(3 * n, dtype=points.dtype), (*batch, 3 * n, 3 * n))
    corner = jnp.zeros((*batch, 6, 6), points.dtype)
    system = jnp.block([[identity, -weighted_rows], [matrix, corner]])
    squeezing = (squeeze[..., None] * normals).reshape(*batch, 3 * n)
    right = jnp.concatenate([squeezing, jnp.broadcast_to(wrench, (*batch, 6))], -1)
    coordinates = jnp.linalg.solve(system, right[..., None])[..., 0]
    return coordinates[..., : 3 * n].reshape(*batch, n, 3), coordinates[..., 3 * n :]


def dual_value(
    grasp: Grasp,
    wrench: Float[AnyArray, "*#batch 6"],
    multiplier: Float[AnyArray, "*#batch 6"],
    sharing: Sharing = "squeeze",
) -> Float[Array, "..."]:
    """Compute the dual value of any multiplier, a lower bound of the constrained optimum's objective.

    At the optimum's own multiplier it equals ``Solution.objective``. Differentiable any number of times, by
    every argument; where a contact's force meets its cone's surface or apex, second derivatives are those of
    one side.

    Args:
        grasp: contacts ``(..., n)``; all leading axes broadcast.
        wrench: what the contacts must exert ``(..., 6)`` [N, N.m].
        multiplier: linear over angular ``(..., 6)``, about the frame's origin, as in a Solution.
        sharing: as for [`jaxgrasp.closed_form`][].

    Returns:
        ``(...)`` in the objective's units [N^2 over those of the weights]; NaN where the data are not usable.

    Raises:
        ValueError: for a sharing that cannot be used, or shapes that do not fit.
    """
    check_arguments(grasp, {"wrench": (wrench, (6,)), "multiplier": (multiplier, (6,))}, {})
    return dispatch(_evaluate, grasp, wrench, sharing, multiplier=multiplier)[0]


def multiplier_forces(
    grasp: Grasp, multiplier: Float[AnyArray, "*#batch 6"], sharing: Sharing = "squeeze"
) -> Float[Array, "... n 3"]:
    """Compute the forces that minimise the Lagrangian at a multiplier, each contact's inside its cone.

    f_i is the projection of s_i a_i + k_i G_i^T multiplier on cone i: a force that friction allows, whether or
    not it balances anything. At the optimum's own multiplier these are its forces.

    Args:
        grasp: contacts ``(..., n)``; leading axes broadcast against the multiplier's.
        multiplier: linear over angular ``(..., 6)``, about the frame's origin, as in a Solution.
        sharing: as for [`jaxgrasp.closed_form`][].

    Returns:
        ``(..., n, 3)`` [N]; zero for absent contacts, NaN where the data are not usable.

    Raises:
        ValueError: for a sharing that cannot be used, or shapes that do not fit.
    """
    check_arguments(grasp, {"multiplier": (multiplier, (6,))}, {})
    return dispatch(_evaluate, grasp, jnp.zeros(6, int), sharing, multiplier=multiplier)[1]


def _evaluate(problem: ProblemBatch, multiplier: Array) -> tuple[Array, Array]:
    """Compute dual value and forces in the user's own coordinates: the multiplier has no more digits in any others."""
    data, valid = to_batch_last(problem)
    value, best = _value_and_forces(dual.plain_problem(data), multiplier.T)
    forces = jnp.stack([jnp.where(valid, c, jnp.nan) for c in best.linear]).transpose(2, 1, 0)
    return jnp.where(valid, value, jnp.nan)[0], forces


def _value_and_forces(problem: dual.PlainProblem, multiplier: SpatialVec) -> tuple[Array, ContactVec]:
    data = problem.data
    best = dual.candidate_forces(problem, multiplier)
    work = spatial.inner(dual.required_wrench(problem), multiplier)
    deviation = dual.weighted_deviation(data, best, jnp.ones_like(data.force.x))
    lagrangian_terms = dual.deviation_cost_by(data, best.forces, deviation) - contact_vec.dot(
        best.velocity, best.forces
    )
    return work + jnp.sum(lagrangian_terms, 0, keepdims=True), best.forces
