"""The squeeze factor: the total of allowed normal forces as a multiple of the hand's squeezing forces."""

from dataclasses import replace

import numpy as np

from jaxgrasp.batch.contact_sets import ContactSets
from jaxgrasp.model.solution import is_held

LITTLE = 2.0**-20
"""Factor that makes squeezing forces nearly zero."""


def total_squeeze(sets: ContactSets) -> np.ndarray:
    """Return the sum of squeezing forces of each grasp ``(N, 1)`` [N]."""
    return np.add.reduceat(sets.squeeze.astype(float), sets.offsets[:-1])[:, None]


def normal_force_ratio(sets: ContactSets, forces: np.ndarray, verdict: np.ndarray, squeezed: np.ndarray) -> np.ndarray:
    """Return the sum of normal forces over a sum of squeezing forces ``(N, W)``.

    Args:
        sets: the grasps.
        forces: ``(M, W, 3)`` [N], by one method.
        verdict: ``(N, W)``.
        squeezed: the sum to compare with ``(N, 1)`` [N].

    Returns:
        NaN where the forces do not hold, and where the hand squeezes with nothing.
    """
    # Ratio sum_i n_i.f_i / sum_i s_i of each grasp and wrench.
    pressed = np.einsum("cwi,ci->cw", forces.astype(float), sets.normals.astype(float))
    total = np.add.reduceat(pressed, sets.offsets[:-1], axis=0)
    return np.divide(total, squeezed, out=np.full(total.shape, np.nan), where=is_held(verdict) & (squeezed > 0))


def clip_to_one(sets: ContactSets, factor: np.ndarray) -> np.ndarray:
    """Return factors with 1 in place of all that are no larger, to the root of the rounding."""
    return np.where(factor <= 1 + float(np.finfo(sets.points.dtype).eps) ** 0.5, 1, factor)


def with_little_squeeze(sets: ContactSets, chosen: np.ndarray) -> ContactSets:
    """Return grasps that hardly squeeze, those of the problems ``chosen (N, W)``; others have nothing to hold."""
    contact_mask = np.repeat(chosen.any(1), sets.sizes)
    squeeze = np.where(contact_mask, sets.squeeze * sets.squeeze.dtype.type(LITTLE), 0).astype(sets.squeeze.dtype)
    wrench = np.where(chosen[..., None], sets.wrench, 0).astype(sets.wrench.dtype)
    return replace(sets, squeeze=squeeze, wrench=wrench)
