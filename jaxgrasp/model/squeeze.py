"""Squeezing forces: the normal force that a penetration depth asks for, and how a hand shares it."""

from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxgrasp.model.arrays import AnyArray, Float
from jaxgrasp.paper.tables import CONTRIBUTIONS, FINGERS, PHALANGES
from jaxgrasp.validation.checked import checked


@checked
def squeezing(
    contribution: Float[AnyArray, "*#batch"] | float,
    stiffness: Float[AnyArray, "*#batch"] | float,
    depth: Float[AnyArray, "*#batch"] | float,
) -> Float[Array, "*batch"]:
    """Squeezing force s = c K delta of eq. 6 [N]; zero where the contact is open (depth < 0).

    Args:
        contribution: share c of the phalanx in the grip [1], for example a row of Table I.
        stiffness: of the simulated contact K [N/m].
        depth: penetration delta [m].
    """
    return jnp.asarray(contribution) * stiffness * jnp.maximum(depth, 0)


@dataclass(frozen=True)
class Contributions:
    """Contribution of each phalanx to a grip (the c of eq. 6)."""

    grip: str
    fingers: tuple[str, ...]
    phalanges: tuple[str, ...]
    values: np.ndarray
    """``(phalanges, fingers)``, dimensionless."""
    source: str

    def of(self, finger: str, phalanx: str) -> float:
        """Return the contribution of one phalanx; raises KeyError for a name that the table lacks."""
        for name, table in ((finger, self.fingers), (phalanx, self.phalanges)):
            if name not in table:
                raise KeyError(f"{name!r} is not in this table: expected one of {', '.join(table)}")
        return float(self.values[self.phalanges.index(phalanx), self.fingers.index(finger)])

    @property
    def finger_totals(self) -> np.ndarray:
        """Contribution of each whole finger, the last row of Table I."""
        return self.values.sum(0)


def _read_only(rows: tuple[tuple[float, ...], ...]) -> np.ndarray:
    values = np.array(rows)
    values.flags.writeable = False
    return values


CYLINDRICAL_POWER_GRIP = Contributions(
    grip="cylindrical power",
    fingers=FINGERS,
    phalanges=PHALANGES,
    values=_read_only(CONTRIBUTIONS),
    source="Tzafestas 2003, Table I (it names no thumb and no palm)",
)
"""The paper's Table I: how much each phalanx of four fingers contributes to a cylindrical power grip."""
