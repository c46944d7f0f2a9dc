"""The iterative Kuhn-Tucker approach that the paper dismisses as too slow: an active-set method on F_2 or F_3.

The paper (section II-E) poses least |f - f_s|^2 under friction and names this approach without its variant. Choices
made here: friction as pyramids, which make the program quadratic; the closed form first, which is the solution where it
violates no constraint; else a vertex of a linear program to start from, and the primal active-set method of R.
Fletcher, "A general quadratic programming algorithm", J. Inst. Mathematics and its Applications 7, 1971: minimise on
the faces of a working set, take up the face that blocks the step, give up the face with a negative multiplier.

Failures: steps multiply with contacts and with sides, and a batch gains nothing. Where many faces meet, as in the
apex of an unloaded contact, steps have length zero; after as many of these as there are faces the first candidate is
taken instead of the best, which terminates.
"""

from typing import NamedTuple

import numpy as np

from jaxgrasp.literature.linear import LinearProgram, Pyramid, check_pyramid, facet_rows, normal_rows, solve_plain
from jaxgrasp.literature.method_input import MethodAnswer, MethodStatus, read_input
from jaxgrasp.literature.scaled_problems import HostProblem, HostResult, balanced, solve_each
from jaxgrasp.model.arrays import AnyArray, Float
from jaxgrasp.model.grasp import Grasp
from jaxgrasp.problem.flatten import read_sharing_name
from jaxgrasp.validation.checked import checked

ROUNDING = 1e-11
"""Slacks, steps and multipliers below this, relative to the size of the vectors, count as zero."""
PARALLEL = 1e-9
"""Sine of the angle between a step and a face below which the face does not block it: the span of the working set."""
VIOLATED = 1e-7
"""Violation above which the polyhedron counts as empty: the tolerance of HiGHS."""


class Shortest(NamedTuple):
    """Program min |z|^2 / 2 subject to rows z <= bounds, rows of unit length."""

    rows: np.ndarray
    bounds: np.ndarray


class Vertex(NamedTuple):
    """Optimum, with the number of changes of the working set."""

    z: np.ndarray
    changes: int


def first_point(problem: Shortest) -> tuple[np.ndarray | None, int]:
    """Find a start: zero if it is feasible, else the point farthest inside, up to a distance of one; and count the
    pivots."""
    rows, bounds = problem
    unknowns = rows.shape[1]
    if np.all(bounds >= 0):
        return np.zeros(unknowns), 0
    distance = np.append(np.zeros(unknowns), 1.0)
    program = LinearProgram(
        cost=-distance,
        equal=np.zeros((0, unknowns + 1)),
        right=np.zeros(0),
        rows=np.vstack([np.column_stack([rows, np.ones(len(rows))]), distance]),
        bounds=np.append(bounds, 1.0),
    )
    result = solve_plain(program)
    if result.x is None or result.x[-1] < -VIOLATED:
        return None, result.pivots
    return result.x[:-1], result.pivots


def shortest(problem: Shortest, start: np.ndarray, max_steps: int) -> Vertex | None:
    """Find the shortest vector in a polyhedron by a primal active-set method, from a feasible start; None where the
    steps run out."""
    rows, z = problem.rows, start
    # A start on a face may lie beyond it by rounding.
    bounds = np.maximum(problem.bounds, rows @ z)
    working: list[int] = []
    zero_steps = 0
    for changes in range(max_steps):
        target, multipliers = _on_faces(rows[working], bounds[working])
        step = target - z
        size = max(float(np.linalg.norm(z)), float(np.linalg.norm(target)))
        is_cycling = zero_steps > len(rows)
        # With as many faces as unknowns only rounding is left of a step.
        if np.linalg.norm(step) <= ROUNDING * size or len(working) == len(z):
            leaving = _leaving(working, multipliers, ROUNDING * size, is_cycling)
            if leaving is None:
                return Vertex(z, changes)
            working.remove(leaving)
            continue
        share, blocking = _blocking(rows, bounds, z, step, working)
        zero_steps = 0 if share * np.linalg.norm(step) > ROUNDING * size else zero_steps + 1
        z = z + share * step
        if blocking is None:
            continue
        working.append(blocking)
    return None


def _on_faces(rows: np.ndarray, bounds: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Compute the shortest vector with rows z = bounds, and its multipliers."""
    if not len(rows):
        return np.zeros(rows.shape[1]), np.zeros(0)
    orthogonal, upper = np.linalg.qr(rows.T)
    across = np.linalg.solve(upper.T, bounds)
    return orthogonal @ across, -np.linalg.solve(upper, across)


def _leaving(working: list[int], multipliers: np.ndarray, rounding: float, is_cycling: bool) -> int | None:
    """Select the face with the most negative multiplier; or the first such face, so that no sequence repeats."""
    negative = [face for face, multiplier in zip(working, multipliers, strict=True) if multiplier < -rounding]
    if not negative:
        return None
    return min(negative) if is_cycling else working[int(np.argmin(multipliers))]


def _blocking(rows, bounds, z, step, working: list[int]) -> tuple[float, int | None]:
    """Compute the feasible share of a step, and the face that blocks it; the first of equals."""
    speed = rows @ step
    speed[working] = 0
    against = np.flatnonzero(speed > PARALLEL * np.linalg.norm(step))
    if not len(against):
        return 1.0, None
    shares = np.maximum(bounds[against] - rows[against] @ z, 0) / speed[against]
    nearest = int(np.argmin(shares))
    if shares[nearest] >= 1:
        return 1.0, None
    return float(shares[nearest]), int(against[nearest])


HOLDS = 1e-9
"""Largest violation of a face that does not depend on the unknowns, in units of the load."""


@checked
def kuhn_tucker(
    grasp: Grasp,
    wrench: Float[AnyArray, "*#batch 6"],
    *,
    sharing: str = "squeeze",
    sides: int = 8,
    pyramid: Pyramid = "inscribed",
    max_steps: int = 1000,
    throw: bool = True,
) -> MethodAnswer:
    """Solve the paper's constrained problem over friction pyramids, by an active-set method.

    Args:
        grasp: contacts ``(..., n)``, concrete; leading axes broadcast against the wrench's.
        wrench: wrench required of the contacts ``(..., 6)`` [N, N.m].
        sharing: the weights k: ``"uniform"`` or ``"A"`` for 1, F_2 (eq. 5), or ``"squeeze"`` or ``"B"`` for s, F_3
            (eq. 13); a contact of weight zero keeps its squeezing force.
        sides: facets of each pyramid, 3 or more.
        pyramid: ``"inscribed"``, edges on the cone: all forces are allowed by friction; or ``"circumscribed"``,
            facets on the cone: forces may slip, by up to mu (1 / cos(pi / sides) - 1).
        max_steps: changes of the working set allowed.
        throw: whether invalid values raise; if not, their problem's status is INVALID_DATA.

    Returns:
        A MethodAnswer whose objective is F_2 [N^2] or F_3 [N], and whose iterations are changes of the working set
        and the pivots that led to the first vertex; none where the closed form is the answer.

    Raises:
        ValueError: for an invalid argument.
        GraspError: for invalid data, by name of the entry.
    """
    check_pyramid(sides, pyramid)
    weights_name = read_sharing_name(sharing)
    if max_steps < 1:
        raise ValueError(f"max_steps is {max_steps}: expected 1 or more")
    problems = read_input(grasp, wrench, throw=throw)
    return solve_each(problems, lambda problem: _solve(problem, weights_name, sides, pyramid, max_steps))


def _solve(problem: HostProblem, sharing: str, sides: int, pyramid: Pyramid, max_steps: int) -> HostResult:
    """Solve in y = (f - s a) / sqrt(k) = particular + basis z, whose length is that of z but for a constant."""
    weights = problem.squeeze if sharing == "squeeze" else np.ones_like(problem.squeeze)
    roots = np.repeat(np.sqrt(weights), 3)
    squeezing = (problem.squeeze[:, None] * problem.normals).ravel()
    remaining = problem.wrench - problem.balance @ squeezing
    balance = balanced(problem._replace(balance=problem.balance * roots, wrench=remaining))
    faces = _faces(problem, sides, pyramid, squeezing, roots)
    size = np.linalg.norm(faces.rows @ balance.basis, axis=-1)
    bounds = faces.bounds - faces.rows @ balance.particular
    is_variable = size > HOLDS * np.sqrt(weights.max())
    if not balance.reached or np.any(bounds[~is_variable] < -HOLDS):
        return HostResult(MethodStatus.INFEASIBLE)
    reduced = Shortest(
        faces.rows[is_variable] @ balance.basis / size[is_variable, None], bounds[is_variable] / size[is_variable]
    )
    start, pivots = first_point(reduced)
    if start is None:
        return HostResult(MethodStatus.INFEASIBLE, iterations=pivots)
    vertex = shortest(reduced, start, max_steps)
    if vertex is None:
        return HostResult(MethodStatus.NOT_CONVERGED, iterations=pivots + max_steps)
    y = balance.particular + balance.basis @ vertex.z
    unit = problem.load if sharing == "squeeze" else problem.load**2
    return HostResult(MethodStatus.SOLVED, squeezing + roots * y, unit * float(y @ y) / 2, pivots + vertex.changes)


def _faces(problem: HostProblem, sides: int, pyramid: Pyramid, squeezing: np.ndarray, roots: np.ndarray) -> Shortest:
    """Build the facets and the condition of no pulling, in y."""
    parts = (facet_rows(problem, sides, pyramid), normal_rows(problem))
    rows, bounds = (np.concatenate(part) for part in zip(*parts, strict=True))
    return Shortest(rows * roots, bounds - rows @ squeezing)
