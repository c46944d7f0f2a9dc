"""The price of friction: what a closed form leaves out by ignoring it."""

from typing import Any

import numpy as np

from jaxgrasp.model.solution import Verdict


def price_of_friction(closed: Any, optimum: Any, verdict: Any) -> np.ndarray:
    """(F* - F) / F*, by the objectives F of a closed form and F* of its optimum, whose verdict is given.

    Zero where the closed form is the optimum; it means nothing where there is no optimum.
    """
    already = verdict == Verdict.CLOSED_FORM_OPTIMAL
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(already, 0, (optimum - closed) / optimum)
