"""Interface of a rival: a name, a licence, and the preparation for a batch of problems."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import numpy as np

from jaxgrasp.testing.references import Problems


class Answers(NamedTuple):
    """A rival's answers to a batch, in the user's units."""

    forces: np.ndarray
    """``(B, n, 3)`` [N]."""
    multiplier: np.ndarray | None
    """Multiplier of G f = w about the frame's origin ``(B, 6)``; None where the method has none for the true cones."""
    solved: np.ndarray
    """Where the rival itself claims to have solved the problem that it poses ``(B,)``."""
    infeasible: np.ndarray
    """Where it claims that no forces exist ``(B,)``."""


class Prepared(NamedTuple):
    """A rival that has compiled and allocated whatever depends on shapes and sparsity alone, or can be kept."""

    run: Callable[[], Any]
    """Solves the whole batch from data in the rival's own layout to its own kind of result: this is timed."""
    read: Callable[[Any], Answers]
    """The result in the user's units: not timed."""


@dataclass(frozen=True)
class Rival:
    """A method at one tolerance and precision."""

    name: str
    package: str
    """The distribution that it comes in."""
    licence: str
    prepare: Callable[[Problems, np.ndarray], Prepared]
    """Takes problems and sharing weights ``(B, n)``; a batch of one is posed as a single problem."""
    tolerance: float
    """What the solver is asked for, in its own terms."""
    dtype: str = "float64"
    batched: bool = True
    """Whether one call solves a batch; otherwise the batch is a loop in Python."""
    cones: Literal["circular", "pyramids", "none"] = "circular"
    """What it takes for friction: only ``circular`` is the problem itself."""

    def solve(self, problem: Problems, weights: np.ndarray) -> Answers:
        prepared = self.prepare(problem, weights)
        return prepared.read(prepared.run())


@dataclass(frozen=True)
class Differentiator:
    """A way to compute the Jacobian of method B's constrained forces by the squeezing forces."""

    name: str
    package: str
    licence: str
    prepare: Callable[[Problems], Callable[[], np.ndarray]]
    """Makes ready the call that is timed: it returns ``(B, n, 3, n)``, forces solved for anew."""
