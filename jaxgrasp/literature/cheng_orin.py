"""Cheng and Orin: the same linear program, reduced twice before the simplex method.

F.-T. Cheng and D. E. Orin, "Efficient algorithm for optimal force distribution: the compact-dual LP method", IEEE
Trans. Robotics and Automation 6(2), 1990: the balance of forces is brought to row-reduced echelon form, whose general
solution (3n - 6 free forces) removes it from the program; of the compact program that is left, which has few unknowns
and many inequalities, the dual is solved, which has few rows.

The measure is Orin and Oh's, as defined in ``orin_oh.py``. Ours: which forces are free follows from a QR
decomposition with pivoting, rather than from elimination in the order of the contacts.

Failures: as the plain program does, whose optimum it finds; where that is not unique it may find another one. An
infeasible program shows as an unbounded dual. A modern solver removes the balance by itself, so that what was a
manifold gain in 1990 is little now.
"""

from jaxgrasp.literature.linear import solve_compact_dual
from jaxgrasp.literature.method_input import MethodAnswer, read_input
from jaxgrasp.literature.orin_oh import check_weights, forces_of, load_program
from jaxgrasp.literature.pyramids import Pyramid, check_pyramid
from jaxgrasp.literature.scaled_problems import HostProblem, HostResult, balanced, solve_each
from jaxgrasp.model.arrays import AnyArray, Float
from jaxgrasp.model.grasp import Grasp
from jaxgrasp.model.limits import Limits
from jaxgrasp.validation.checked import checked


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
    check_pyramid(sides, pyramid)
    check_weights(energy, balance)

    def solve(problem: HostProblem) -> HostResult:
        program = load_program(problem, energy, balance, sides, pyramid)
        return forces_of(problem, balanced(problem), solve_compact_dual(program))

    return solve_each(read_input(grasp, wrench, limits, throw), solve)
