"""Result of the search for an objective's optimum."""

from typing import NamedTuple

from jax import Array

from jaxgrasp.solver.multiplier_bounds import Multipliers


class SearchResult(NamedTuple):
    """Forces, their bound and its proof, in the units of ``ConeProblem``."""

    y: Array
    """``(B, n, c)``."""
    bound: Array
    """``(B,)``: value that no forces exceed in quality."""
    multipliers: Multipliers
    """Multipliers that prove the bound, and give the derivative of the value."""
    shares: Array | None
    """``(B, n)``: multipliers of the contacts' shares, for an objective over the largest share; else None."""
    residual: Array
    """``(B,)``: residual of equations and limits."""
