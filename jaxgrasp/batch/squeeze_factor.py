"""The squeeze factor: the total of allowed normal forces as a multiple of the hand's squeezing forces."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from jaxgrasp.batch.contact_sets import ContactSets
from jaxgrasp.batch.engine import MethodResult
from jaxgrasp.model.solution import Verdict, is_held

LITTLE = 2.0**-20
"""Factor that makes squeezing forces nearly zero."""


def pressed_times(sets: ContactSets, results: Mapping[str, MethodResult], meant: ContactSets) -> np.ndarray:
    """Return the sum of normal forces over the sum of squeezing forces, of the result that presses least ``(N, W)``.

    Args:
        sets: the grasps of the results.
        results: by method; closed forms inside every cone count as 1, whatever they press.
        meant: the same grasps, with the squeezing forces to compare with.

    Returns:
        NaN where no result holds, and where the hand squeezes with nothing.
    """
    if not len(sets):
        return np.zeros((0, sets.wrenches))
    starts = sets.offsets[:-1]
    squeezed = np.add.reduceat(meant.squeeze.astype(float), starts)[:, None]
    factor = np.full((len(sets), sets.wrenches), np.nan)
    for result in results.values():
        pressed = np.einsum("cwi,ci->cw", result.forces.astype(float), sets.normals.astype(float))
        total = np.add.reduceat(pressed, starts, axis=0)
        needed = np.divide(total, squeezed, out=np.full(total.shape, np.nan), where=squeezed > 0)
        if sets is meant:
            needed[result.verdict == Verdict.CLOSED_FORM_OPTIMAL] = 1
        factor = np.where(is_held(result.verdict), np.fmin(factor, needed), factor)
    return factor


def as_it_squeezes(sets: ContactSets, factor: np.ndarray) -> np.ndarray:
    """Return factors with 1 in place of all that are no larger, to the root of the rounding."""
    return np.where(factor <= 1 + float(np.finfo(sets.points.dtype).eps) ** 0.5, 1, factor)


def with_little_squeeze(sets: ContactSets, chosen: np.ndarray) -> ContactSets:
    """Return grasps that hardly squeeze, those of the problems ``chosen (N, W)``; others have nothing to hold."""
    of_contacts = np.repeat(chosen.any(1), sets.sizes)
    squeeze = np.where(of_contacts, sets.squeeze * sets.squeeze.dtype.type(LITTLE), 0).astype(sets.squeeze.dtype)
    wrench = np.where(chosen[..., None], sets.wrench, 0).astype(sets.wrench.dtype)
    return replace(sets, squeeze=squeeze, wrench=wrench)
