"""A batch of grasp problems as plain arrays: what generators make and references judge."""

from typing import NamedTuple

import numpy as np


class Contacts(NamedTuple):
    """Contacts before a wrench is chosen."""

    points: np.ndarray
    normals: np.ndarray
    friction: np.ndarray
    squeeze: np.ndarray


class Problems(NamedTuple):
    """A batch of problems of one kind, in float64."""

    kind: str
    points: np.ndarray
    normals: np.ndarray
    friction: np.ndarray
    squeeze: np.ndarray
    wrench: np.ndarray
    feasible: bool | None
    """True or False where the construction decides it for every sharing; None where it depends on the sharing."""
    witness: np.ndarray | None = None
    """Allowed forces ``(B, n, 3)`` that the wrench was made of, where there are any."""

    def cast(self, dtype: type) -> "Problems":
        """Round the problems to ``dtype``; the rounded problems are different problems, and so without a witness."""
        arrays = {name: getattr(self, name).astype(dtype) for name in (*Contacts._fields, "wrench")}
        return self._replace(**arrays, witness=None)

    def weights(self, sharing: str) -> np.ndarray:
        """Return the sharing weights k ``(B, n)`` of a named method, ``squeeze`` or ``uniform``."""
        return {"squeeze": self.squeeze, "uniform": np.ones_like(self.squeeze)}[sharing]
