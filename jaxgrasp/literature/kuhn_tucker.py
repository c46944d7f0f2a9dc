"""The iterative Kuhn-Tucker route that the paper passes over as too slow: an active-set method on F_2 or F_3.

The paper (section II-E) poses least |f - f_s|^2 under friction and names this route without saying which of its forms.
Ours: friction as pyramids, which make the program quadratic; the closed form first, which is the answer where it
violates nothing; else a vertex of a linear program to start from, and the primal active-set method of R. Fletcher,
"A general quadratic programming algorithm", J. Inst. Mathematics and its Applications 7, 1971: minimise on the faces
of a working set, take up the face that blocks the step, give up the one whose multiplier pulls.

How it fails: steps multiply with contacts and with sides, and a batch gains nothing. Where many faces meet, as in the
apex of a contact that carries nothing, steps have no length; after as many of these as there are faces the first
candidate is taken instead of the best, which cannot go on for ever.
"""

import numpy as np

from jaxgrasp.literature.active_set import Shortest, first_point, shortest
from jaxgrasp.literature.host_problem import HostProblem, HostResult, balanced, solve_each
from jaxgrasp.literature.method_answer import MethodAnswer, MethodStatus
from jaxgrasp.literature.method_input import read_input
from jaxgrasp.literature.pyramids import Pyramid, check_pyramid, facet_rows, normal_rows
from jaxgrasp.model.arrays import AnyArray, Float
from jaxgrasp.model.grasp import Grasp
from jaxgrasp.problem.flatten import read_sharing_name
from jaxgrasp.validation.checked import checked

HOLDS = 1e-9
"""What a face may be violated by, the load being one, where it does not depend on the unknowns."""


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
    """The constrained problem of the paper over friction pyramids, by an active-set method.

    Args:
        grasp: contacts ``(..., n)``, concrete; leading axes broadcast against the wrench's.
        wrench: what the contacts must exert ``(..., 6)`` [N, N.m].
        sharing: the weights k: ``"uniform"`` or ``"A"`` for 1, F_2 (eq. 5), or ``"squeeze"`` or ``"B"`` for s, F_3
            (eq. 13); a contact of weight zero keeps its squeezing force.
        sides: facets of each pyramid, 3 or more.
        pyramid: ``"inscribed"``, edges on the cone: forces are ones that friction allows; or ``"circumscribed"``,
            facets on the cone: forces may slip, by up to mu (1 / cos(pi / sides) - 1).
        max_steps: changes of the working set allowed.
        throw: whether bad values raise; if not, their problem's status is INVALID_DATA.

    Returns:
        A MethodAnswer whose objective is F_2 [N^2] or F_3 [N], and whose iterations are changes of the working set
        and the pivots that led to the first vertex; none where the closed form is the answer.

    Raises:
        ValueError: for an argument that cannot be used.
        GraspError: for data that cannot be used, naming the entry.
    """
    check_pyramid(sides, pyramid)
    weights_name = read_sharing_name(sharing)
    if max_steps < 1:
        raise ValueError(f"max_steps is {max_steps}: expected 1 or more")
    given = read_input(grasp, wrench, throw=throw)
    return solve_each(given, lambda problem: _solve(problem, weights_name, sides, pyramid, max_steps))


def _solve(problem: HostProblem, sharing: str, sides: int, pyramid: Pyramid, max_steps: int) -> HostResult:
    """In y = (f - s a) / sqrt(k) = particular + basis z, whose length is that of z but for a constant."""
    weights = problem.squeeze if sharing == "squeeze" else np.ones_like(problem.squeeze)
    roots = np.repeat(np.sqrt(weights), 3)
    own = (problem.squeeze[:, None] * problem.normals).ravel()
    rest = problem.wrench - problem.balance @ own
    balance = balanced(problem._replace(balance=problem.balance * roots, wrench=rest))
    faces = _faces(problem, sides, pyramid, own, roots)
    size = np.linalg.norm(faces.rows @ balance.basis, axis=-1)
    bounds = faces.bounds - faces.rows @ balance.particular
    moving = size > HOLDS * np.sqrt(weights.max())
    if not balance.reached or np.any(bounds[~moving] < -HOLDS):
        return HostResult(MethodStatus.INFEASIBLE)
    reduced = Shortest(faces.rows[moving] @ balance.basis / size[moving, None], bounds[moving] / size[moving])
    start, pivots = first_point(reduced)
    if start is None:
        return HostResult(MethodStatus.INFEASIBLE, iterations=pivots)
    found = shortest(reduced, start, max_steps)
    if found is None:
        return HostResult(MethodStatus.NOT_CONVERGED, iterations=pivots + max_steps)
    y = balance.particular + balance.basis @ found.z
    unit = problem.load if sharing == "squeeze" else problem.load**2
    return HostResult(MethodStatus.SOLVED, own + roots * y, unit * float(y @ y) / 2, pivots + found.changes)


def _faces(problem: HostProblem, sides: int, pyramid: Pyramid, own: np.ndarray, roots: np.ndarray) -> Shortest:
    """Facets and the bar on pulling, in y."""
    parts = (facet_rows(problem, sides, pyramid), normal_rows(problem))
    rows, bounds = (np.concatenate(part) for part in zip(*parts, strict=True))
    return Shortest(rows * roots, bounds - rows @ own)
