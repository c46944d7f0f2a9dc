"""What the search for an objective's optimum hands back."""

from typing import NamedTuple

from jax import Array

from jaxgrasp.solver.multiplier_bounds import Multipliers


class SearchResult(NamedTuple):
    """Forces, their bound and its proof, in the units of ``ConeProblem``."""

    y: Array
    """``(B, n, c)``."""
    bound: Array
    """``(B,)``: that no forces are better than."""
    multipliers: Multipliers
    """What proves it, and how the value moves."""
    shares: Array | None
    """``(B, n)``: of what contacts bear, in an objective that is about the largest of them."""
    missed: Array
    """``(B,)``: by how much forces miss equations and limits."""
