"""Kerr and Roth: forces farthest from every constraint, by a linear program.

J. Kerr and B. Roth, "Analysis of multifingered hands", Int. J. Robotics Research 4(4), 1986: friction cones as tangent
planes, joint torques bounded; internal forces are chosen such that the least distance to any of these planes is
largest.

Reconstructed from descriptions in later work; choices made here: distances measured in the space of all contact forces
(each row has unit length there) rather than of internal force magnitudes, pyramids whose facets may also lie on the
cone, and that a bound on normal forces counts as a plane like any other.

Failures, beside those of pyramids: without a bound on every normal force the distance grows
without end, and with one the hand squeezes as hard as the bound allows, however light the object (the paper's own
objection). Forces jump where another plane becomes the closest, and where several forces are equally far from all
planes the simplex method picks any. A contact without friction has a distance of zero, and then so has the grasp.
"""

import numpy as np

from jaxgrasp.literature.linear import LinearProgram, Pyramid, check_pyramid, constraint_rows, solve_plain
from jaxgrasp.literature.method_input import MethodAnswer, MethodStatus, read_input
from jaxgrasp.literature.scaled_problems import HostProblem, HostResult, balanced, solve_each
from jaxgrasp.model.arrays import AnyArray, Float
from jaxgrasp.model.grasp import Grasp, Limits
from jaxgrasp.validation.checked import checked


@checked
def kerr_roth(
    grasp: Grasp,
    wrench: Float[AnyArray, "*#batch 6"],
    *,
    limits: Limits,
    sides: int = 8,
    pyramid: Pyramid = "inscribed",
    throw: bool = True,
) -> MethodAnswer:
    """Compute the forces farthest from slipping and from every limit, over friction pyramids.

    Args:
        grasp: contacts ``(..., n)``, concrete; leading axes broadcast against the wrench's and the limits'.
        wrench: wrench required of the contacts ``(..., 6)`` [N, N.m].
        limits: limits of normal forces and joint torques; together they must bound every force, or the result is
            UNBOUNDED.
        sides: facets of each pyramid, 3 or more.
        pyramid: ``"inscribed"``, edges on the cone: all forces are allowed by friction; or ``"circumscribed"``,
            facets on the cone: forces may slip, by up to mu (1 / cos(pi / sides) - 1).
        throw: whether invalid values raise; if not, their problem's status is INVALID_DATA.

    Returns:
        A MethodAnswer whose objective is the least distance to any plane [N], and whose iterations are pivots.

    Raises:
        ValueError: for an invalid argument, or limits without any bound from above.
        GraspError: for invalid data, by name of the entry.
    """
    check_pyramid(sides, pyramid)
    if limits.normal_max is None and limits.torque_max is None:
        raise ValueError("limits have no upper bound: expected normal_max, or torque_map with torque_max")
    return solve_each(read_input(grasp, wrench, limits, throw), lambda problem: _solve(problem, sides, pyramid))


def _solve(problem: HostProblem, sides: int, pyramid: Pyramid) -> HostResult:
    """Solve for internal forces z and the distance d >= 0: rows (p + N z) + d <= bounds."""
    balance = balanced(problem)
    if not balance.reached:
        return HostResult(MethodStatus.INFEASIBLE)
    rows, bounds = constraint_rows(problem, sides, pyramid)
    internal = np.column_stack([rows @ balance.basis, np.ones(len(rows))])
    unknowns = internal.shape[1]
    cost = np.zeros(unknowns)
    cost[-1] = -1.0
    program = LinearProgram(
        cost=cost,
        equal=np.zeros((0, unknowns)),
        right=np.zeros(0),
        rows=np.concatenate([internal, cost[None]]),
        bounds=np.append(bounds - rows @ balance.particular, 0.0),
    )
    result = solve_plain(program)
    if result.x is None:
        return HostResult(result.status, iterations=result.pivots)
    forces = balance.particular + balance.basis @ result.x[:-1]
    return HostResult(result.status, forces, problem.load * result.x[-1], result.pivots)
