"""The paper's sensitivity analysis as a whole: slip angles along a task by several methods, and what moves them."""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from jaxgrasp.model.compared_methods import METHODS
from jaxgrasp.model.task import Task
from jaxgrasp.sensitivity.matrix import Influence, SensitivityMatrix
from jaxgrasp.sensitivity.naming import Labels
from jaxgrasp.sensitivity.outputs import SlipAngles, friction_reserve
from jaxgrasp.sensitivity.trajectory import SensitivityTrajectory, trajectory_call

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
        method: trajectory_call(task, times, SlipAngles.by(method), by, vary={vary: values}, labels=labels, once=True)
        for method in methods
    }
    some = times[:: -(-len(times) // RESERVE_INSTANTS)]
    ours = {name: these for name, these in labels.items() if name != "slip_angle"}
    reserve = trajectory_call(task, some, friction_reserve, by, labels=ours, once=True)
    # Nearly all of the time is compiling, which another core can do as well; what takes longest begins first. Methods
    # of one program come one after the other: the first compiles it.
    with ThreadPoolExecutor() as pool:
        found = pool.submit(reserve)
        alike = [[name for name in methods if METHODS[name].constrained is each] for each in (True, False)]
        others = [pool.submit(_in_turn, {name: slips[name] for name in names}) for names in alike]
        answers = {name: one for each in others for name, one in each.result().items()}
        return Study({method: answers[method] for method in methods}, found.result())


def _in_turn(calls: dict[str, Callable[[], SensitivityTrajectory]]) -> dict[str, SensitivityTrajectory]:
    return {name: call() for name, call in calls.items()}


def at_worst(matrix: SensitivityMatrix, *, largest: bool) -> SensitivityMatrix:
    """Outputs over time ``(T, M)`` as each stands at its own worst instant, with its derivatives there.

    What only comes earlier or later, as by another speed, moves an output at every instant, and its worst not at all:
    at an extremum the derivative of the curve's height is that at its place.

    Args:
        matrix: of leading axis time.
        largest: whether the largest value is the worst, or the smallest.
    """
    nominal, derivatives = np.asarray(matrix.nominal), np.asarray(matrix.derivatives)
    bad = nominal if largest else -nominal
    # What has no derivative (no forces hold) has no worst that could be led back to parameters.
    known = np.isfinite(bad) & ~np.isnan(derivatives).any(-1)
    place = np.where(known, bad, -np.inf).argmax(0)
    which = np.arange(nominal.shape[1])
    return SensitivityMatrix(
        jnp.asarray(derivatives[place, which]),
        jnp.asarray(nominal[place, which]),
        matrix.values,
        matrix.outputs,
        matrix.parameters,
    )


def rankings(found: Study) -> dict[str, list[Influence]]:
    """By how many per cent one per cent of each parameter moves the worst over time; the largest first.

    Of the slip angles, each finger's largest, by method; and of the reserve of friction, its smallest.
    """
    slips = {f"slip angles, {name}": _ranking(at_worst(one.matrix, largest=True)) for name, one in found.slips.items()}
    return slips | {"reserve of friction": _ranking(at_worst(found.reserve.matrix, largest=False))}


def _ranking(matrix: SensitivityMatrix) -> list[Influence]:
    known = {entry.name for entry in matrix.parameters}
    return matrix.ranking({name: size for name, size in WHOLE.items() if name in known})


def spells(times: np.ndarray, there: np.ndarray) -> list[tuple[float, float]]:
    """When something begins and ends to be so, to half an instant."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], there.astype(int), [0]])))
    middles = np.concatenate([[times[0]], (times[1:] + times[:-1]) / 2, [times[-1]]])
    return [(float(middles[begin]), float(middles[end])) for begin, end in edges.reshape(-1, 2)]
