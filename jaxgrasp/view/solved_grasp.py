"""Solution of a grasp at an instant, ready to be drawn: NumPy arrays, independent of its source."""

from collections.abc import Sequence
from typing import NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxgrasp.force.slip import friction_margin
from jaxgrasp.grip.monitor import Assessment, Law, Touch, assess
from jaxgrasp.model.grasp import Grasp
from jaxgrasp.model.solution import Solution, Verdict, is_balanced

Tree = TypeVar("Tree")


class PosedHand(NamedTuple):
    """Pose and torques of a hand at an instant."""

    links: np.ndarray
    """Poses of its links ``(L, 3, 4)``."""
    joints: Sequence[str]
    torques: np.ndarray
    """Torques of the contacts on its joints ``(J,)`` [N.m]: negative against flexion."""


class SolvedGrasp(NamedTuple):
    """Grasp of at most ``n`` contacts under a load, with the solutions of both laws."""

    grasp: Grasp
    """Grasp in a frame with the world's axes."""
    origin: np.ndarray
    """Origin of that frame in the world ``(3,)`` [m]."""
    wrench: np.ndarray
    """Wrench that the contacts must exert ``(6,)``, about that origin [N, N.m]."""
    assessment: Assessment
    margins: tuple[np.ndarray, np.ndarray]
    """Friction margins of the closed form and of the optimum ``(n,)`` [rad]; infinite of contacts without load."""
    closed_touches: np.ndarray
    """State of each contact by the closed form: codes of a [`jaxgrasp.grip.Touch`][]."""
    law: Law
    names: Sequence[str]
    """Names of the contacts."""
    object_pose: np.ndarray
    """``(3, 4)``"""
    hand: PosedHand | None = None
    rests: bool = False
    """True if the table carries the load that the hand does not hold."""
    moving: np.ndarray = np.zeros((0, 3, 4))
    """Poses of further objects and of obstacles that move."""

    @property
    def touching(self) -> np.ndarray:
        """Mask ``(n,)`` of the contacts that touch."""
        present = self.grasp.present
        return np.ones(len(self.grasp.points), bool) if present is None else np.asarray(present) > 0.5

    @property
    def points(self) -> np.ndarray:
        """Positions of the contacts in the world ``(n, 3)`` [m]."""
        return np.asarray(self.grasp.points) + self.origin

    @property
    def escape(self) -> np.ndarray | None:
        """The twist about ``origin`` along which the object escapes, where it is proven that no forces hold it."""
        optimum = self.assessment.optimum
        if int(optimum.verdict) not in (Verdict.INFEASIBLE, Verdict.NO_CONTACTS):
            return None
        twist = -np.asarray(optimum.certificate, float)
        return twist if np.any(twist) else None

    @property
    def touches(self) -> np.ndarray:
        """State of each contact ``(n,)``: by the applied law or, if its forces do not balance the wrench, by the closed
        form; absent if neither balances.
        """
        applied = self.assessment.optimum if self.law == "optimum" else self.assessment.closed
        for answer, touches in ((applied, self.assessment.touches), (self.assessment.closed, self.closed_touches)):
            if is_balanced(int(answer.verdict)):
                return np.asarray(touches)
        return np.full(len(self.touching), Touch.ABSENT)

    def answers(self) -> tuple[tuple[str, Solution, np.ndarray], ...]:
        """Return method, solution and friction margins of both laws."""
        solutions = self.assessment.closed, self.assessment.optimum
        return tuple(zip(("B", "B-optimum"), solutions, self.margins, strict=True))

    def forces(self, answer: Solution) -> np.ndarray:
        """Return the forces ``(n, 3)`` [N] of a solution; zero at absent contacts and if they do not balance."""
        return np.where(self.touching[:, None] & bool(is_balanced(int(answer.verdict))), np.asarray(answer.forces), 0.0)


class LawComparison(NamedTuple):
    """Friction margins of both laws and contact states of the closed form."""

    margins: tuple[Array, Array]
    closed_touches: Array


def numbers_as_arrays(tree: Tree) -> Tree:
    """Convert all numbers of a tree to arrays, so that a program is compiled once for all values."""
    float_types = {int: float, float: float}
    return jax.tree.map(lambda leaf: jnp.asarray(leaf, float_types.get(type(leaf))), tree)


def compare_laws(grasp: Grasp, assessment: Assessment) -> LawComparison:
    """Compute the friction margins of both laws, and the contact states by the closed form."""
    closed, optimum = assessment.closed, assessment.optimum
    margins = [friction_margin(grasp, answer.forces, answer.moments) for answer in (closed, optimum)]
    return LawComparison((margins[0], margins[1]), assess(grasp, closed, optimum, "closed-form").touches)
