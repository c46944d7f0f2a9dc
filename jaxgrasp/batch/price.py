"""The price of friction: the share of the optimum's objective that a closed form leaves out by ignoring friction."""

from typing import Any

import numpy as np

from jaxgrasp.model.arrays import Float
from jaxgrasp.model.solution import Solution, Verdict, is_optimum
from jaxgrasp.validation.checked import checked


@checked
def price_of_friction(closed: Solution, optimum: Solution) -> Float[np.ndarray, "*batch"]:
    """Compute the share (F* - F) / F* of the optimum's objective that the closed form leaves out by ignoring friction.

    Args:
        closed: answers of [`jaxgrasp.closed_form`][].
        optimum: answers of [`jaxgrasp.constrained_optimum`][] to the same problems, by the same sharing.

    Returns:
        Shares ``(*batch)``, 0 to 1: 0 where the closed form is the optimum, NaN where there is no optimum.

    Raises:
        ValueError: where ``optimum`` holds a verdict of closed forms, or the leading axes do not broadcast.

    Example:
        >>> import jaxgrasp, numpy as np
        >>> grasp = jaxgrasp.Grasp([[0, 0, -1], [0, 0, 1]], [[0, 0, 1], [0, 0, -1]], [0.5, 0.5], [1, 1])
        >>> closed, optimum = jaxgrasp.closed_form_and_optimum(grasp, np.array([1.5, 0, 0, 0, 0, 0]))
        >>> round(float(jaxgrasp.price_of_friction(closed, optimum)), 3)
        0.308
    """
    verdict = np.asarray(optimum.verdict)
    if np.any(verdict == Verdict.OUTSIDE_CONES):
        index = tuple(int(k) for k in np.argwhere(verdict == Verdict.OUTSIDE_CONES)[0])
        raise ValueError(
            f"optimum.verdict{list(index) or ''} is OUTSIDE_CONES: expected answers of constrained_optimum"
        )
    share = objective_gap(np.asarray(closed.objective), np.asarray(optimum.objective), verdict)
    # Rounding leaves objectives that are all but equal in either order.
    return np.where(is_optimum(verdict), np.maximum(share, 0), np.nan)


def objective_gap(closed: Any, optimum: Any, verdict: Any) -> np.ndarray:
    """Return (F* - F) / F*, by the objectives F of a closed form and F* of its optimum, whose verdict is given.

    Zero where the closed form is the optimum; the value has no meaning where there is no optimum.
    """
    already = verdict == Verdict.CLOSED_FORM_OPTIMAL
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(already, 0, (optimum - closed) / optimum)
