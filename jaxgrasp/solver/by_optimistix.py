"""The constrained optimum by a solver from outside, on the same dual, judged by this package's own tests.

The solver sees six unknowns in the principal axes and whitened coordinates of the careful pass, one
problem at a time under ``vmap``. It only proposes a multiplier: what that is worth is measured here.
"""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

from jaxgrasp.model.solution import Route, Verdict
from jaxgrasp.numerics.tiling import over_tiles
from jaxgrasp.problem import contact_vec, friction_cone
from jaxgrasp.problem.batch_last import Lanes, Problem, read
from jaxgrasp.problem.contact_vec import Four
from jaxgrasp.problem.scaling import Frame, principal
from jaxgrasp.problem.spatial import Six
from jaxgrasp.solver import dual, pseudo_inverse
from jaxgrasp.solver.coordinates import Unknowns
from jaxgrasp.solver.guided_motion import whitened
from jaxgrasp.solver.infeasibility import out_of_range, proof
from jaxgrasp.solver.newton import has_converged, is_within
from jaxgrasp.solver.pseudo_inverse import Metric, whitened_square
from jaxgrasp.solver.result import Answer, Outcome, write

MAX_STEPS = 256
TILE = 128
"""Problems that run together: each waits for the slowest of its tile."""


def check_solver(solver: Any) -> None:
    """Raise TypeError unless ``solver`` is one that ``solve_optimum`` can use."""
    import optimistix as optx

    kinds = (optx.AbstractRootFinder, optx.AbstractLeastSquaresSolver, optx.AbstractMinimiser)
    if not isinstance(solver, kinds):
        raise TypeError(
            f"solver is {solver!r}: expected None, or an optimistix root finder, least-squares solver or minimiser, "
            "such as optimistix.Newton(rtol=1e-8, atol=1e-8)"
        )
    try:
        hash(solver)
    except TypeError:
        raise TypeError(f"solver {type(solver).__name__} holds arrays: expected settings in Python numbers") from None


def solve_optimum(solver: Any, problem: Problem) -> Answer:
    """The constrained optimum of a flat batch by an optimistix solver."""
    return over_tiles(partial(_tile, solver), problem, problem.size, TILE, problem.count)


def write_to_tolerance(
    lanes: Lanes, frame: Frame, unknowns: Unknowns, valid: Array, size: int, outcome: Outcome, tolerance: float
) -> Answer:
    """``answer.write``, but an optimum has to balance to ``tolerance`` only: its solver was not asked for more."""
    answer = write(lanes, frame, unknowns, valid, size, outcome, Route.GIVEN)
    disowned = (outcome.verdict[0] == Verdict.OPTIMAL) & (answer.verdict == Verdict.NOT_CONVERGED)
    verdict = jnp.where(disowned & (answer.residual <= tolerance), Verdict.OPTIMAL, answer.verdict)
    return answer._replace(verdict=verdict.astype(jnp.int32))


def _tile(solver: Any, problem: Problem) -> Answer:
    lanes, valid = read(problem)
    lanes, frame = principal(lanes)
    metric, unknowns = whitened(problem, lanes, frame)
    start = pseudo_inverse.closed_multiplier(lanes, unknowns, metric)
    free = pseudo_inverse.free_forces(lanes, start, unknowns)
    inside = jnp.all(friction_cone.contains(free, lanes.cone), 0, keepdims=True)
    missed, beyond = out_of_range(lanes, frame, unknowns)
    point, steps = _search(solver, lanes, unknowns, start)
    tolerance = float(max(solver.rtol, solver.atol))
    forces, optimal = _judge(lanes, unknowns, metric, point, tolerance)
    proven, direction = _proof(lanes, frame, unknowns, start, point)
    verdict = jnp.where(optimal, Verdict.OPTIMAL, jnp.where(proven, Verdict.INFEASIBLE, Verdict.NOT_CONVERGED))
    verdict = jnp.where(inside, Verdict.CLOSED_FORM_OPTIMAL, verdict)
    outcome = Outcome(
        forces=contact_vec.where(inside, free, forces),
        multiplier=jnp.where(inside, start, point),
        verdict=jnp.where(missed, Verdict.INFEASIBLE, verdict),
        steps=jnp.where(inside, 0, steps),
        certificate=jnp.where(missed, beyond, direction),
        undecided=jnp.zeros_like(missed),
    )
    return write_to_tolerance(lanes, frame, unknowns, valid, problem.size, outcome, tolerance)


def _search(solver: Any, lanes: Lanes, unknowns: Unknowns, start: Six) -> tuple[Six, Array]:
    """Where the solver ends in each lane, and after how many steps; the start where it runs off to infinity."""
    import optimistix as optx

    def one(lane: tuple[Lanes, Unknowns], start: Six) -> tuple[Six, Array]:
        found: optx.Solution
        if isinstance(solver, optx.AbstractMinimiser):
            found = optx.minimise(_descent, solver, start, lane, max_steps=MAX_STEPS, throw=False)
        else:
            found = optx.root_find(_rest, solver, start, lane, max_steps=MAX_STEPS, throw=False)
        return found.value, found.stats["num_steps"][None]

    size = start.shape[-1]
    lane = jax.tree.map(lambda x: jnp.broadcast_to(x, (x.shape[0], size)), (lanes, unknowns))
    point, steps = jax.vmap(one, in_axes=-1, out_axes=-1)(lane, start)
    finite = jnp.all(jnp.isfinite(point), 0, keepdims=True)
    return jnp.where(finite, point, start), steps


def _rest(point: Six, lane: tuple[Lanes, Unknowns]) -> Six:
    """The dual's gradient; directions that no contact reaches pull the multiplier to zero instead of nowhere."""
    lanes, unknowns = lane
    rest = dual.residual(lanes, dual.best_forces(lanes, point, unknowns).forces, unknowns)
    return rest - unknowns.idle() * point


def _descent(point: Six, lane: tuple[Lanes, Unknowns]) -> Array:
    """Minus the dual, whose gradient is minus ``_rest``."""
    lanes, unknowns = lane
    value = dual.dual_value(lanes, dual.best_forces(lanes, point, unknowns), point, unknowns)
    return jnp.sum(unknowns.idle() * point**2) / 2 - value[0]


def _judge(lanes: Lanes, unknowns: Unknowns, metric: Metric, point: Six, tolerance: float) -> tuple[Four, Array]:
    """The forces of a multiplier, and whether residual and duality gap are within ``tolerance``, or rounding."""
    best = dual.best_forces(lanes, point, unknowns)
    rest = dual.residual(lanes, best.forces, unknowns)
    value, push = dual.dual_value(lanes, best, point, unknowns), dual.total_push(lanes, best.forces)
    found = (lanes, point, rest, whitened_square(metric, rest), value, push)
    return best.forces, is_within(*found, tolerance, tolerance) | has_converged(*found)


def _proof(lanes: Lanes, frame: Frame, unknowns: Unknowns, start: Six, point: Six) -> tuple[Array, Six]:
    """Whether what is left of the wrench, or the way the multiplier ran, proves that there is no solution."""
    rest = dual.residual(lanes, dual.best_forces(lanes, point, unknowns).forces, unknowns)
    return proof(lanes, frame, unknowns, rest, point - start)
