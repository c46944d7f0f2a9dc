"""What the search for an objective's optimum hands back."""

from typing import NamedTuple

from jax import Array

from jaxgrasp.objectives.prices import Prices


class Found(NamedTuple):
    """In the units of ``Posed``."""

    y: Array
    """``(B, n, c)``."""
    value: Array
    """``(B,)``: of these forces."""
    bound: Array
    """``(B,)``: that no forces are better than."""
    prices: Prices
    """What proves it, and how the value moves."""
    press: Array
    """``(B, n)``: presses that hold the contacts' constraints in the Lagrangian; zero where it holds none."""
    missed: Array
    """``(B,)``: by how much forces miss equations and limits."""
