"""What a grasp is worth at one instant, ready to be drawn: NumPy arrays, whatever it came from."""

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
    """A hand at that instant."""

    links: np.ndarray
    """Poses of its links ``(L, 3, 4)``."""
    joints: Sequence[str]
    torques: np.ndarray
    """Torques of the contacts on its joints ``(J,)`` [N.m]: negative against flexion."""


class Seen(NamedTuple):
    """One grasp under one load, of ``n`` contacts at most."""

    grasp: Grasp
    """In a frame whose axes are the world's."""
    origin: np.ndarray
    """Where that frame stands in the world ``(3,)`` [m]."""
    wrench: np.ndarray
    """What the contacts must exert ``(6,)``, about that origin [N, N.m]."""
    assessment: Assessment
    margins: tuple[np.ndarray, np.ndarray]
    """Friction margins of the closed form and of the optimum ``(n,)`` [rad]; infinite of contacts without load."""
    closed_touches: np.ndarray
    """What each contact does by the closed form: codes of a [`jaxgrasp.grip.Touch`][]."""
    law: Law
    names: Sequence[str]
    """Names of the contacts."""
    object_pose: np.ndarray
    """``(3, 4)``"""
    hand: PosedHand | None = None
    rests: bool = False
    """Whether the table carries what the hand does not hold."""
    moving: np.ndarray = np.zeros((0, 3, 4))
    """Poses of further objects and of obstacles that move."""

    @property
    def there(self) -> np.ndarray:
        """Which contacts touch ``(n,)``."""
        present = self.grasp.present
        return np.ones(len(self.grasp.points), bool) if present is None else np.asarray(present) > 0.5

    @property
    def points(self) -> np.ndarray:
        """Contacts in the world ``(n, 3)`` [m]."""
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
        """What each contact does ``(n,)``: by the law that is applied or, where that has no forces, by the closed form,
        which may have some; absent where neither has.
        """
        applied = self.assessment.optimum if self.law == "optimum" else self.assessment.closed
        for answer, touches in ((applied, self.assessment.touches), (self.assessment.closed, self.closed_touches)):
            if is_balanced(int(answer.verdict)):
                return np.asarray(touches)
        return np.full(len(self.there), Touch.ABSENT)

    def answers(self) -> tuple[tuple[str, Solution, np.ndarray], ...]:
        """Method, solution and margins of both laws."""
        both = self.assessment.closed, self.assessment.optimum
        return tuple(zip(("B", "B-optimum"), both, self.margins, strict=True))

    def forces(self, answer: Solution) -> np.ndarray:
        """Forces ``(n, 3)`` [N]; zero where they balance nothing, for then they are none."""
        return np.where(self.there[:, None] & bool(is_balanced(int(answer.verdict))), np.asarray(answer.forces), 0.0)


class Judged(NamedTuple):
    """What an assessment leaves to be found."""

    margins: tuple[Array, Array]
    closed_touches: Array


def numbers_as_arrays(tree: Tree) -> Tree:
    """The tree with all its numbers as arrays, so that a program is compiled once whatever they are."""
    kinds = {int: float, float: float}
    return jax.tree.map(lambda leaf: jnp.asarray(leaf, kinds.get(type(leaf))), tree)


def judged_by_both(grasp: Grasp, assessment: Assessment) -> Judged:
    """The friction margins of both laws, and what contacts do by the closed form."""
    closed, optimum = assessment.closed, assessment.optimum
    margins = [friction_margin(grasp, answer.forces, answer.moments) for answer in (closed, optimum)]
    return Judged((margins[0], margins[1]), assess(grasp, closed, optimum, "closed-form").touches)
