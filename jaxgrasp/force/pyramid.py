"""The optimum over friction pyramids, by a quadratic-program solver from outside: what linearising friction costs.

A pyramid whose m edges lie on the cone lies inside it. With y_i = (f_i - s_i a_i) / sqrt(k_i) in principal
axes and whitened coordinates, the problem is the shortest y with A y = b, where A A^T = I, and one row of
C y <= d for each facet: as well conditioned as it can be for an operator-splitting method.
"""

import math
import warnings
from collections.abc import Callable
from functools import cache, partial
from types import ModuleType
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from jaxgrasp.model.arguments import check_arguments
from jaxgrasp.model.arrays import AnyArray, Float
from jaxgrasp.model.grasp import Grasp
from jaxgrasp.model.solution import Route, Solution
from jaxgrasp.numerics import vec3
from jaxgrasp.numerics.geometry import tangents
from jaxgrasp.numerics.no_derivative import refusing
from jaxgrasp.numerics.tiling import over_tiles
from jaxgrasp.numerics.vec3 import Vec3
from jaxgrasp.problem import contact_vec, friction_cone
from jaxgrasp.problem.batch_last import ContactData, ProblemBatch, squeezing_forces, to_batch_last
from jaxgrasp.problem.contact_vec import ContactVec
from jaxgrasp.problem.coordinates import ScaledAxes
from jaxgrasp.problem.flatten import Sharing, refuse_soft_fingers
from jaxgrasp.problem.scaled_problem import ScaledProblem, in_principal_axes
from jaxgrasp.solver import dual
from jaxgrasp.solver.dispatch import dispatch
from jaxgrasp.solver.result import Findings, PhaseResult, ScaledSolution, no_certificate, to_result
from jaxgrasp.solver.transforms import as_solution
from jaxgrasp.validation.checked import checked

TILE = 128
"""Problems that run together: each waits for the slowest of its tile."""
ROUNDING = 2.0
"""Residuals computed a second time may exceed the tolerance that the solver met by this factor."""
BALANCE = 10.0
"""Backward error of an answer, in tolerances: a length of six residuals, and forces put back on their cones."""
GAP = 100.0
"""Relative duality gap of an answer, in tolerances: residuals count by the multipliers, which can be large."""


class PyramidSettings(NamedTuple):
    """Settings of the pyramids and of their solver."""

    sides: int
    solver: str
    tol: float
    max_steps: int


class PyramidProgram(NamedTuple):
    """Minimise |y|^2 / 2 subject to A y = b and C y <= d."""

    a: Array
    b: Array
    c: Array
    d: Array


class PyramidResult(NamedTuple):
    """Candidate solution of one program, as the solver returns it."""

    y: Array
    equality: Array
    """Multipliers of A y = b."""
    facets: Array
    """Multipliers of C y <= d."""
    claimed: Array
    steps: Array


@checked
def pyramid_optimum(
    grasp: Grasp,
    wrench: Float[AnyArray, "*#batch 6"],
    sharing: Sharing = "squeeze",
    *,
    sides: int = 8,
    solver: Literal["osqp", "box_osqp"] = "osqp",
    tol: float = 1e-6,
    max_steps: int = 4000,
) -> Solution:
    """Solve the constrained optimum with each friction cone replaced by an inscribed pyramid, by jaxopt's OSQP.

    An inner approximation: the pyramid's edges lie on the cone, so its forces are ones that friction allows,
    at a price no lower than [`jaxgrasp.constrained_optimum`][]'s, which falls as ``sides`` are doubled. It
    serves to measure that price; the constrained optimum itself is faster and exact. The first edge leans from
    the normal a towards a x e, with e the coordinate axis farthest from a, the first of equals: where the
    edges point depends on the frame, and jumps as a normal turns.

    Args:
        grasp: contacts ``(..., n)``; leading axes broadcast against the wrench's.
        wrench: what the contacts must exert ``(..., 6)`` [N, N.m].
        sharing: as for [`jaxgrasp.closed_form`][].
        sides: edges of each pyramid, 3 or more.
        solver: ``"osqp"`` for ``jaxopt.OSQP``, ``"box_osqp"`` for ``jaxopt.BoxOSQP``.
        tol: largest residual allowed, in coordinates where the load is 1. Where JAX's 64-bit mode is off
            1e-4 is within reach, and the default hardly ever.
        max_steps: iterations of the operator splitting.

    Returns:
        A Solution of the pyramids' problem: ``objective`` is theirs, and ``multiplier`` that of G f = w there,
        about the frame's origin. OPTIMAL where primal and dual residuals are within ``tol``, the residual of
        the Solution within 10 and the duality gap within 100 times that, relative to the larger of the
        objective and that of no force. NOT_CONVERGED otherwise, no proof being tried: pyramids may be unable to
        give a wrench that the cones can. ``steps`` counts the solver's iterations.

    Raises:
        ValueError: for an argument that cannot be used, or shapes that do not fit.
        NotImplementedError: when it is differentiated.
    """
    check_arguments(grasp, {"wrench": (wrench, (6,))}, {})
    refuse_soft_fingers(grasp)
    settings = PyramidSettings(sides, solver, tol, max_steps)
    _check(settings)
    return dispatch(_solver(settings), grasp, wrench, sharing)


def _check(settings: PyramidSettings) -> None:
    if settings.sides < 3:
        raise ValueError(f"sides is {settings.sides}: expected 3 or more")
    if settings.solver not in ("osqp", "box_osqp"):
        raise ValueError(f"solver is {settings.solver!r}: expected 'osqp' or 'box_osqp'")
    if not settings.tol > 0:
        raise ValueError(f"tol is {settings.tol}: expected a number greater than 0")
    if settings.max_steps < 1:
        raise ValueError(f"max_steps is {settings.max_steps}: expected 1 or more")


@cache
def _solver(settings: PyramidSettings) -> Callable[[ProblemBatch], Solution]:
    def solve(problem: ProblemBatch) -> Solution:
        return as_solution(_answers(problem, settings))

    return solve


@partial(jax.custom_jvp, nondiff_argnums=(1,))
def _answers(problem: ProblemBatch, settings: PyramidSettings) -> PhaseResult:
    return over_tiles(partial(_tile, settings=settings), problem, problem.size, TILE, problem.count)


# Derivatives by jaxopt were off by up to a hundredth for the objective, and by anything for the forces.
_answers.defjvp(refusing("pyramid_optimum has no derivatives: differentiate constrained_optimum instead"))


def _tile(batch: ProblemBatch, settings: PyramidSettings) -> PhaseResult:
    problem = in_principal_axes(batch)
    data, axes, size = problem.data, problem.scaling.axes, problem.size
    assert axes is not None
    # Facets belong to the user's axes, so that turning a problem by its own axes turns no pyramid.
    normals = jnp.stack(to_batch_last(batch)[0].normals, -1)
    first, second = (vec3.rotate(axes, vec3.from_axis(tangent, -1)) for tangent in tangents(normals))
    program = _program(problem, _facets(data, (first, second), settings.sides))
    # The loops of jaxopt carry numbers of JAX's default precision and refuse any other.
    program = jax.tree.map(lambda x: x.astype(jnp.result_type(float)), program)
    results = jax.vmap(partial(_splitting, settings=settings))(program)
    no_force_objective = jnp.broadcast_to(dual.objective_of_no_force(data)[0], size)
    solved = jax.vmap(partial(_is_optimum, tol=settings.tol))(program, results, no_force_objective)
    y, twist = (_finite(x, data.squeeze.dtype) for x in (results.y, -results.equality))
    moved = vec3.scale(jnp.sqrt(data.weights), Vec3(*y.reshape(size, -1, 3).transpose(2, 1, 0)))
    forces = contact_vec.add(squeezing_forces(data), ContactVec(moved))
    # The solver leaves forces beyond a facet by its tolerance: put those beyond the cone back on it.
    sides = friction_cone.decompose(forces, data.cone)
    result = ScaledSolution(
        forces=friction_cone.project(forces, data.cone, sides),
        multiplier=twist.T,
        findings=Findings(infeasible=jnp.zeros((1, size), bool), optimal=solved[None], closed_form=False),
        steps=results.steps[None],
        certificate=no_certificate(jnp.zeros((6, size), data.squeeze.dtype)),
        undecided=jnp.zeros((1, size), bool),
    )
    return to_result(problem, result, Route.GIVEN, balance=BALANCE * settings.tol)


def _finite(array: Array, dtype: jnp.dtype) -> Array:
    return jnp.where(jnp.isfinite(array), array, 0).astype(dtype)


def _program(problem: ScaledProblem, facets: tuple[Array, Array]) -> PyramidProgram:
    """Build the quadratic programs of all problems, batch-first."""
    rows, bounds = facets
    contacts, facets_per_contact = rows.shape[1:3]
    # Facets of a contact see its own force alone.
    blocks = jnp.eye(contacts, dtype=rows.dtype)[:, None, :, None] * rows[:, :, :, None, :]
    program = PyramidProgram(
        a=_balance(problem),
        b=dual.residual(problem, squeezing_forces(problem.data)).T,
        c=blocks.reshape(-1, contacts * facets_per_contact, 3 * contacts),
        d=bounds.reshape(-1, contacts * facets_per_contact),
    )
    return jax.tree.map(lambda x: jnp.broadcast_to(x, (problem.size, *x.shape[1:])), program)


def _balance(problem: ScaledProblem) -> Array:
    """Compute the balance's matrix A = G W^(1/2), ``(B, 6, 3n)``."""
    data, coordinates = problem.data, problem.coordinates
    assert isinstance(coordinates, ScaledAxes)
    root, zero = jnp.sqrt(data.weights), jnp.zeros_like(data.weights)
    columns = []
    for axis in range(3):
        unit = Vec3(*(root if i == axis else zero for i in range(3)))
        torque = vec3.times(coordinates.scales, vec3.cross(data.points, unit))
        columns.append(jnp.stack(jnp.broadcast_arrays(*unit, *torque)))
    matrix = jnp.stack(columns, 2)  # (6, n, 3, B)
    return matrix.transpose(3, 0, 1, 2).reshape(matrix.shape[-1], 6, -1)


def _facets(data: ContactData, tangents: tuple[Vec3, Vec3], sides: int) -> tuple[Array, Array]:
    """Compute rows g and bounds d with g.y <= d for each facet, ``(B, n, sides + 1, 3)`` and ``(B, n, sides + 1)``.

    Between two edges a + mu t on the cone the facet's distance from the axis is mu cos(pi / m) per unit of
    height. A last row keeps contacts from pulling, which without friction no facet does.
    """
    angles = jnp.asarray([(2 * j + 1) * math.pi / sides for j in range(sides)], data.friction.dtype)[:, None, None]
    outward = vec3.add(vec3.scale(jnp.cos(angles), tangents[0]), vec3.scale(jnp.sin(angles), tangents[1]))
    slope = data.friction * math.cos(math.pi / sides)
    size = jnp.sqrt(1 + slope**2)
    row = vec3.scale(1 / size, vec3.sub(outward, vec3.scale(slope, data.normals)))
    rows = jnp.concatenate([jnp.stack(row, 1), -jnp.stack(data.normals)[None]])
    offset = vec3.safe_divide(data.squeeze, jnp.sqrt(data.weights))
    bounds = jnp.concatenate([jnp.broadcast_to(slope * offset / size, (sides, *offset.shape)), offset[None]])
    return rows.transpose(3, 2, 0, 1), bounds.transpose(2, 1, 0)


def _splitting(program: PyramidProgram, settings: PyramidSettings) -> PyramidResult:
    """Solve one program by jaxopt, started from the closed form; ``vmap`` solves all."""
    jaxopt = _jaxopt()
    a, b, c, d = program
    kind = jaxopt.OSQP if settings.solver == "osqp" else jaxopt.BoxOSQP
    solver = kind(tol=settings.tol, maxiter=settings.max_steps)
    objective = (jnp.eye(a.shape[1], dtype=a.dtype), jnp.zeros_like(a[0]))
    # Since A A^T = I. A start at zero would make the step size, which jaxopt divides by A y, infinite.
    closed = b @ a
    if settings.solver == "osqp":
        start = solver.init_params(closed, objective, (a, b), (c, d))._replace(dual_eq=-b)
        solution, state = solver.run(start, objective, (a, b), (c, d))
        y, equality, facets = solution.primal, solution.dual_eq, solution.dual_ineq
    else:
        matrix = jnp.concatenate([a, c])
        lower, upper = jnp.concatenate([b, jnp.full_like(d, -jnp.inf)]), jnp.concatenate([b, d])
        start = solver.init_params(closed, objective, matrix, (lower, upper))
        start = start._replace(dual_eq=jnp.concatenate([-b, jnp.zeros_like(d)]))
        solution, state = solver.run(start, objective, matrix, (lower, upper))
        y, equality, facets = solution.primal[0], solution.dual_eq[:6], solution.dual_eq[6:]
    return PyramidResult(y, equality, facets, state.status == jaxopt.BoxOSQP.SOLVED, state.iter_num)


def _is_optimum(program: PyramidProgram, result: PyramidResult, no_force_objective: Array, tol: float) -> Array:
    """Check the Karush-Kuhn-Tucker conditions and that the gap is small relative to an objective."""
    a, b, c, d = program
    slack = d - c @ result.y
    pull = result.equality @ a + result.facets @ c
    # The least of two numbers is zero exactly where both are nonnegative and one of them vanishes.
    violations = (a @ result.y - b, result.y + pull, jnp.minimum(slack, result.facets))
    error = jnp.max(jnp.stack([jnp.max(jnp.abs(violation)) for violation in violations]))
    primal = result.y @ result.y / 2
    bound = -(pull @ pull) / 2 - b @ result.equality - d @ result.facets
    close = jnp.abs(primal - bound) <= GAP * tol * jnp.maximum(primal, no_force_objective)
    return result.claimed & (error <= ROUNDING * tol) & close


def _jaxopt() -> ModuleType:
    """Import jaxopt on demand, without its warning at every import that it is no longer maintained."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "JAXopt is no longer maintained", DeprecationWarning)
        import jaxopt
    return jaxopt
