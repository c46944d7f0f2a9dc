"""What a grasp is worth at one instant, ready to be drawn: NumPy arrays, whatever it came from."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jax import Array

from jaxgrasp.force.slip import friction_margin
from jaxgrasp.grip.monitor import Assessment, Law
from jaxgrasp.model.grasp import Grasp
from jaxgrasp.model.hand import Pose
from jaxgrasp.model.solution import Verdict, is_balanced


class Hand(NamedTuple):
    """A posed hand."""

    links: np.ndarray
    """Poses of its links ``(L, 3, 4)``."""
    joints: Sequence[str]
    torques: np.ndarray
    """Of the contacts on its joints ``(J,)`` [N.m]: negative against flexion."""


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
    law: Law
    names: Sequence[str]
    """Of the contacts."""
    object_pose: np.ndarray
    """``(3, 4)``"""
    hand: Hand | None = None
    rests: bool = False
    """Whether the table carries what the hand does not hold."""

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

    def answers(self) -> tuple[tuple[str, object, np.ndarray], ...]:
        """Method, solution and margins of both laws."""
        both = self.assessment.closed, self.assessment.optimum
        return tuple(zip(("B", "B-optimum"), both, self.margins, strict=True))

    def forces(self, name: str) -> np.ndarray:
        """The forces of a method ``(n, 3)`` [N]; zero where they balance nothing, for then they are none."""
        solution = dict((method, answer) for method, answer, _ in self.answers())[name]
        balanced = bool(is_balanced(int(solution.verdict)))
        return np.where(self.there[:, None] & balanced, np.asarray(solution.forces), 0.0)


def margins_of(grasp: Grasp, assessment: Assessment) -> tuple[Array, Array]:
    """The friction margins of both laws ``(n,)`` [rad]."""
    closed, optimum = (
        friction_margin(grasp, answer.forces, answer.moments) for answer in (assessment.closed, assessment.optimum)
    )
    return closed, optimum


def pose_matrix(pose: Pose) -> np.ndarray:
    """Poses as matrices ``(..., 3, 4)``."""
    return np.concatenate([np.asarray(pose.rotation), np.asarray(pose.origin)[..., None]], -1)
