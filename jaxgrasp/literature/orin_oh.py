"""Linear programs of Orin and Oh, and of Cheng and Orin, who reduce the same program twice.

Orin and Oh: a weighted sum of effort and uneven load, minimised by a linear program.

D. E. Orin and S. Y. Oh, "Control of force distribution in robotic mechanisms containing closed kinematic chains",
ASME J. Dynamic Systems, Measurement, and Control 103(2), 1981: for legs on the ground, a weighted sum of the energy
that is consumed and of how unevenly the load is shared, under friction pyramids and bounds.

Reconstructed from descriptions in later work; the two terms are choices made here. Energy: the sum of joint torques by
size where a torque map is known, since a motor that holds still heats by its torque; else the sum of normal forces.
Load: the largest normal force.

Failures: the optimum is a vertex, so that forces lie on as many planes as they can, without any margin, and jump
from vertex to vertex as the load turns; it is often not unique, and then the simplex method picks any.

Cheng and Orin: the same linear program, reduced twice before the simplex method.

F.-T. Cheng and D. E. Orin, "Efficient algorithm for optimal force distribution: the compact-dual LP method", IEEE
Trans. Robotics and Automation 6(2), 1990: the balance of forces is brought to row-reduced echelon form, whose general
solution (3n - 6 free forces) removes it from the program; of the compact program that is left, which has few unknowns
and many inequalities, the dual is solved, which has few rows.

The measure is Orin and Oh's. Ours: which forces are free follows from a QR decomposition with pivoting, rather than
from elimination in the order of the contacts.

Failures: as the plain program does, whose optimum it finds; where that is not unique it may find another one. An
infeasible program shows as an unbounded dual. A modern solver removes the balance by itself, so that what was a
manifold gain in 1990 is little now.
"""

from collections.abc import Callable

import numpy as np

from jaxgrasp.literature.linear import (
    LinearOptimum,
    LinearProgram,
    Pyramid,
    check_pyramid,
    constraint_rows,
    solve_compact_dual,
    solve_plain,
)
from jaxgrasp.literature.method_input import MethodAnswer, MethodStatus, read_input
from jaxgrasp.literature.scaled_problems import Balance, HostProblem, HostResult, balanced, solve_each
from jaxgrasp.model.arrays import AnyArray, Float
from jaxgrasp.model.grasp import Grasp, Limits
from jaxgrasp.validation.checked import checked


@checked
def orin_oh(
    grasp: Grasp,
    wrench: Float[AnyArray, "*#batch 6"],
    *,
    limits: Limits | None = None,
    energy: float = 1.0,
    balance: float = 1.0,
    sides: int = 8,
    pyramid: Pyramid = "inscribed",
    throw: bool = True,
) -> MethodAnswer:
    """Minimise energy x (sum of efforts) + balance x (largest normal force), over friction pyramids.

    Args:
        grasp: contacts ``(..., n)``, concrete; leading axes broadcast against the wrench's and the limits'.
        wrench: wrench required of the contacts ``(..., 6)`` [N, N.m].
        limits: limits of normal forces and joint torques. A torque map, with or without bounds, makes the efforts the
            sizes of all joint torques [N.m]; without one they are the normal forces [N].
        energy: weight of the efforts, zero or more [1/(N.m), or 1/N].
        balance: weight of the largest normal force, zero or more [1/N].
        sides: facets of each pyramid, 3 or more.
        pyramid: ``"inscribed"``, edges on the cone: all forces are allowed by friction; or ``"circumscribed"``,
            facets on the cone: forces may slip, by up to mu (1 / cos(pi / sides) - 1).
        throw: whether invalid values raise; if not, their problem's status is INVALID_DATA.

    Returns:
        A MethodAnswer whose objective is the weighted sum, and whose iterations are pivots.

    Raises:
        ValueError: for an invalid argument.
        GraspError: for invalid data, by name of the entry.
    """
    solve = _solver(solve_plain, energy, balance, sides, pyramid)
    return solve_each(read_input(grasp, wrench, limits, throw), solve)


def _solver(
    optimise: Callable[[LinearProgram], LinearOptimum], energy: float, balance: float, sides: int, pyramid: Pyramid
) -> Callable[[HostProblem], HostResult]:
    """Return the solver of a problem's load program by ``optimise``; raise ValueError for invalid options."""
    check_pyramid(sides, pyramid)
    check_weights(energy, balance)

    def solve(problem: HostProblem) -> HostResult:
        program = load_program(problem, energy, balance, sides, pyramid)
        return forces_of(problem, balanced(problem), optimise(program))

    return solve


def check_weights(energy: float, balance: float) -> None:
    """Raise ValueError for invalid weights."""
    for name, weight in (("energy", energy), ("balance", balance)):
        if not 0 <= weight < np.inf:
            raise ValueError(f"{name} is {weight}: expected a finite number, zero or more")
    if energy == balance == 0:
        raise ValueError("energy and balance are both 0: expected at least one above 0")


def load_program(problem: HostProblem, energy: float, balance: float, sides: int, pyramid: Pyramid) -> LinearProgram:
    """Build the program in forces, sizes of torques where a map is given, and the largest normal force."""
    rows, bounds = constraint_rows(problem, sides, pyramid)
    contacts, joints = len(problem.contacts), len(problem.torque_rows)
    normals = np.zeros((contacts, 3 * contacts))
    for i, normal in enumerate(problem.normals):
        normals[i, 3 * i : 3 * i + 3] = normal
    torques, sizes = problem.torque_rows, np.eye(joints)
    zeros = np.zeros((joints, 1))
    efforts = np.zeros(3 * contacts) if joints else energy * normals.sum(0)
    return LinearProgram(
        cost=np.concatenate([efforts, np.full(joints, energy), [balance]]),
        equal=np.concatenate([problem.balance, np.zeros((6, joints + 1))], 1),
        right=problem.wrench,
        rows=np.block(
            [
                [rows, np.zeros((len(rows), joints + 1))],
                [torques, -sizes, zeros],
                [-torques, -sizes, zeros],
                [normals, np.zeros((contacts, joints)), np.full((contacts, 1), -1.0)],
            ]
        ),
        bounds=np.concatenate([bounds, np.zeros(2 * joints + contacts)]),
    )


def forces_of(problem: HostProblem, balance: Balance, optimum: LinearOptimum) -> HostResult:
    """Balance the forces of an optimum, which HiGHS solves to its tolerance, to rounding."""
    if not balance.reached:
        return HostResult(MethodStatus.INFEASIBLE, iterations=optimum.pivots)
    if optimum.x is None:
        return HostResult(optimum.status, iterations=optimum.pivots)
    forces = optimum.x[: 3 * len(problem.contacts)]
    forces = forces + balance.inverse @ (problem.wrench - problem.balance @ forces)
    return HostResult(optimum.status, forces, problem.load * optimum.value, optimum.pivots)


@checked
def cheng_orin(
    grasp: Grasp,
    wrench: Float[AnyArray, "*#batch 6"],
    *,
    limits: Limits | None = None,
    energy: float = 1.0,
    balance: float = 1.0,
    sides: int = 8,
    pyramid: Pyramid = "inscribed",
    throw: bool = True,
) -> MethodAnswer:
    """Minimise the objective of [`jaxgrasp.literature.orin_oh`][], by the compact dual.

    Args are those of [`jaxgrasp.literature.orin_oh`][], and so are errors.

    Returns:
        A MethodAnswer with the same statuses and objectives as the plain program's; forces too, where the optimum is
        unique. Iterations are pivots of the dual.
    """
    solve = _solver(solve_compact_dual, energy, balance, sides, pyramid)
    return solve_each(read_input(grasp, wrench, limits, throw), solve)
