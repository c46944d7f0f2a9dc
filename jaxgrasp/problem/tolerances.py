"""Every threshold of the solver in one place, from the precision of the data."""

from dataclasses import dataclass
from functools import cache

import numpy as np


@dataclass(frozen=True)
class Tolerances:
    """Thresholds in the dimensionless coordinates of ``scaling.py``."""

    rank: float
    """Spread of the contacts, relative to their radius, below which torque about an axis is out of reach."""
    range: float
    """Share of a wrench out of reach that still counts as rounding of the data."""
    pivot: float
    """Pivot of the inertia matrix below which a problem is solved in its principal axes."""
    singular: float
    """Pivot of the dual's curvature below which derivatives take it for zero."""
    gradient: float
    """Whitened residual of a converged optimum."""
    gap: float
    """Relative duality gap of a converged optimum."""
    balance: float
    """Part of its load that a sound answer may miss: 7.5e-9, in float32 1.7e-4. Of contacts that all lie at one point,
    the load's torque is measured by the point's distance from the frame's origin, or 1 m there."""
    torque: float
    """Part of the torques of soft fingers' forces and moments that a sound answer may miss. Contacts that carry most of
    the load may lie close to the centre, where their torques are far smaller than the load times the length."""
    sums: float
    """Part of the forces, each with its lever, that sums of them may miss by rounding."""
    largest: float
    """Larger numbers in the data are invalid: products of a few of them would overflow."""
    largest_load: float
    """A larger load is invalid: its square would overflow. It is the squeezing forces, the wrench's force and its
    torque about the contacts' centre over their distance from that, added up [N]."""
    smallest: float
    """Lengths and sums of weights below this are invalid, but for 0: their squares lose their digits."""
    proof: float
    """Total force, in units of the load, that a certificate must prove to be needed to count as a proof."""


@cache
def tolerances(dtype: np.dtype) -> Tolerances:
    eps, most, least = (float(getattr(np.finfo(dtype), name)) for name in ("eps", "max", "tiny"))
    return Tolerances(
        rank=64 * eps,
        range=eps**0.5 / 16,
        pivot=eps**0.25,
        singular=eps**0.7,
        gradient=eps**0.75,
        gap=eps**0.5 / 64,
        balance=eps**0.5 / 2,
        torque=eps ** (1 / 3),
        sums=16 * eps,
        largest=most**0.4,
        largest_load=most**0.48,
        smallest=least**0.4,
        proof=1 / (16 * eps**0.5),
    )
