"""The paper's sensitivity analysis as a whole: slip angles along a task by several methods, and what moves them."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from jaxgrasp.model.task import Task
from jaxgrasp.sensitivity.matrix import Influence, SensitivityMatrix
from jaxgrasp.sensitivity.naming import Labels
from jaxgrasp.sensitivity.outputs import Output, friction_reserve
from jaxgrasp.sensitivity.trajectory import SensitivityTrajectory, sensitivity_trajectory

RESERVE_INSTANTS = 64
"""At so many instants at most the reserve is looked at, which takes a thousand times as long as a slip angle."""
WHOLE = {"azimuths": 1.0, "heights": 0.05}
"""What counts as the whole of a parameter whose own size means nothing, since its zero was chosen: 1 rad, 5 cm."""


class Study(NamedTuple):
    """What was found along a task."""

    slips: dict[str, SensitivityTrajectory]
    """Slip angles [rad] by method, with those of one parameter varied."""
    reserve: SensitivityTrajectory
    """Reserve of friction, at some of the instants."""


def study(
    task: Task,
    times: np.ndarray,
    methods: Sequence[str],
    by: Sequence[str],
    vary: str,
    values: Sequence[float],
    labels: Labels,
) -> Study:
    """Slip angles by each method, their derivatives, curves for the varied parameter, and the reserve of friction.

    Args:
        task: grasp and wrench over time.
        times: ascending ``(T,)`` [s].
        methods: A, B, A-optimum or B-optimum.
        by: names of the task's parameters.
        vary: the name of one.
        values: what it is given.
        labels: as for [`jaxgrasp.sensitivity.sensitivity_matrix`][], of the slip angles too.

    Raises:
        ValueError: as [`jaxgrasp.sensitivity.sensitivity_trajectory`][] does.
    """
    slips = {
        method: sensitivity_trajectory(
            task, times, Output("slip_angle", method), by, vary={vary: values}, labels=labels
        )
        for method in methods
    }
    some = times[:: -(-len(times) // RESERVE_INSTANTS)]
    ours = {name: these for name, these in labels.items() if name != "slip_angle"}
    return Study(slips, sensitivity_trajectory(task, some, friction_reserve, by, labels=ours))


def ranking(matrix: SensitivityMatrix) -> list[Influence]:
    """By how many per cent one per cent of each parameter moves the outputs, in the mean; the largest first."""
    known = {entry.name for entry in matrix.parameters}
    return matrix.ranking({name: size for name, size in WHOLE.items() if name in known})


def spells(times: np.ndarray, there: np.ndarray) -> list[tuple[float, float]]:
    """When something begins and ends to be so, to half an instant."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], there.astype(int), [0]])))
    middles = np.concatenate([[times[0]], (times[1:] + times[:-1]) / 2, [times[-1]]])
    return [(float(middles[begin]), float(middles[end])) for begin, end in edges.reshape(-1, 2)]
