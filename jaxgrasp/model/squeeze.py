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

DIGITS = ("thumb", *FINGERS)
ALL_PHALANGES = ("metacarpal", *PHALANGES)
"""Phalanges of thumb and fingers; in a precision grip only the tips touch, and the whole finger has their number."""
PINCH_SHARES = (0.33, 0.33, 0.17, 0.15)
"""Mean shares of index, middle, ring and little finger in the force of a static five-finger pinch, at 10 to 30 % of the
strongest one and spans of 45 and 65 mm: R. G. Radwin, S. Oh, T. R. Jensen, J. G. Webster, External finger forces in
submaximal five-finger static pinch prehension, Ergonomics 35(3):275-288, 1992."""


def precision_contributions(n_digits: int) -> Contributions:
    """Return the contributions to a precision grip of the thumb against one to four fingertips.

    The fingers share as measured (``PINCH_SHARES``), in the same ratios where fewer of them take part. The thumb, which
    opposes them, exerts as much as all of them together: equilibrium, which the measurement's dynamometer enforces too.
    The mean over the digits is 1, as over the phalanges of Table I, so the whole squeeze is that of contributions of 1.
    Against a single finger both are 1.

    Args:
        n_digits: number of digits that touch, thumb included: 2 to 5; the fingers are counted from the index on.
    """
    shares = np.ones(len(FINGERS)) if n_digits == 2 else np.array(PINCH_SHARES)
    fingers = n_digits / 2 * shares / shares[: n_digits - 1].sum()
    by_digit = tuple(float(c) for c in (n_digits / 2, *fingers))
    source = "equilibrium" if n_digits == 2 else "Radwin et al., Ergonomics 35(3):275-288, 1992, and equilibrium"
    return Contributions(
        grip=f"precision, {n_digits} digits",
        fingers=DIGITS,
        phalanges=ALL_PHALANGES,
        values=_read_only((by_digit,) * len(ALL_PHALANGES)),
        source=source,
    )


CIRCULAR_SHARES = (0.38, 0.11, 0.13, 0.19, 0.19)
"""Shares of thumb, index, middle, ring and little finger in the force of a grip around a round object of 50 to 100 mm,
within what was measured: more than 38 % for the thumb, 18 to 23 % for ring and little finger, least for the index
finger, 11 % or more; the middle finger has the rest. H. Kinoshita, T. Murase, T. Bandou, Grip posture and forces during
holding cylindrical objects with circular grips, Ergonomics 39(9):1163-1176, 1996. On a sphere, thumb, ring and little
finger were found to exert more than 71 % (76 % here): C. Pylatiuk et al., Distribution of grip force in three different
functional prehension patterns, Journal of Medical Engineering & Technology 30(3):176-182, 2006."""

SPHERICAL_POWER_GRIP = Contributions(
    grip="spherical power",
    fingers=DIGITS,
    phalanges=ALL_PHALANGES,
    values=_read_only((tuple(len(DIGITS) * share for share in CIRCULAR_SHARES),) * len(ALL_PHALANGES)),
    source="Kinoshita et al., Ergonomics 39(9):1163-1176, 1996 (of whole digits; it names no palm)",
)
"""How much each digit contributes to a grip around a ball; its phalanges alike, since only digits were measured. The
mean over the digits is 1, as over the phalanges of Table I."""
