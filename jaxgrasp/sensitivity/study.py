"""The paper's sensitivity analysis: slip angles along a task by several methods, and the influence of parameters on
them."""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from jaxgrasp.model.solution import METHODS
from jaxgrasp.model.task import Task
from jaxgrasp.sensitivity.matrix import Influence, SensitivityMatrix
from jaxgrasp.sensitivity.naming import Labels
from jaxgrasp.sensitivity.trajectory import SensitivityTrajectory, SlipAngles, friction_reserve, trajectory_call

RESERVE_INSTANTS = 64
"""Largest number of instants of the reserve, which takes a thousand times as long as a slip angle."""
REFERENCE_SPREADS = {"azimuths": 1.0, "heights": 0.05}
"""Spread of a parameter whose own size means nothing, since its zero is arbitrary: 1 rad, 5 cm."""


class Study(NamedTuple):
    """Results of a sensitivity analysis along a task."""

    slips: dict[str, SensitivityTrajectory]
    """Slip angles [rad] by method, with curves for the varied parameter."""
    reserve: SensitivityTrajectory
    """Reserve of friction, at a subset of the instants."""


def study(
    task: Task,
    times: np.ndarray,
    methods: Sequence[str],
    by: Sequence[str],
    vary: str,
    values: Sequence[float],
    labels: Labels,
) -> Study:
    """Compute slip angles by each method, their derivatives, curves for the varied parameter, and the reserve of
    friction.

    Args:
        task: grasp and wrench over time.
        times: ascending ``(T,)`` [s].
        methods: A, B, A-optimum or B-optimum.
        by: names of the task's parameters.
        vary: name of the varied parameter.
        values: its values.
        labels: as for [`jaxgrasp.sensitivity.sensitivity_matrix`][], of the slip angles too.

    Raises:
        ValueError: as [`jaxgrasp.sensitivity.sensitivity_trajectory`][] does.
    """
    slips = {
        method: trajectory_call(task, times, SlipAngles.by(method), by, vary={vary: values}, labels=labels, once=True)
        for method in methods
    }
    sparse_times = times[:: -(-len(times) // RESERVE_INSTANTS)]
    reserve_labels = {name: texts for name, texts in labels.items() if name != "slip_angle"}
    reserve = trajectory_call(task, sparse_times, friction_reserve, by, labels=reserve_labels, once=True)
    # Nearly all of the time is compilation, which can run on another core; the longest starts first. Methods of one
    # program run one after the other: the first compiles it.
    with ThreadPoolExecutor() as pool:
        reserve_result = pool.submit(reserve)
        groups = [[name for name in methods if METHODS[name].constrained is flag] for flag in (True, False)]
        results = [pool.submit(_in_turn, {name: slips[name] for name in names}) for names in groups]
        by_method = {name: trajectory for result in results for name, trajectory in result.result().items()}
        return Study({method: by_method[method] for method in methods}, reserve_result.result())


def _in_turn(calls: dict[str, Callable[[], SensitivityTrajectory]]) -> dict[str, SensitivityTrajectory]:
    """Run the calls one after the other."""
    return {name: call() for name, call in calls.items()}


def at_worst(matrix: SensitivityMatrix, *, largest: bool) -> SensitivityMatrix:
    """Reduce outputs over time ``(T, M)`` to each output's worst instant, with its derivatives there.

    A shift in time, as by another speed, moves an output at every instant, but not its worst: at an extremum the
    derivative of the curve's height is that at its place.

    Args:
        matrix: matrix with a leading axis of time.
        largest: True if the largest value is the worst, False for the smallest.
    """
    nominal, derivatives = np.asarray(matrix.nominal), np.asarray(matrix.derivatives)
    bad = nominal if largest else -nominal
    # Instants without a derivative (no forces hold) cannot be attributed to parameters.
    is_known = np.isfinite(bad) & ~np.isnan(derivatives).any(-1)
    worst = np.where(is_known, bad, -np.inf).argmax(0)
    output = np.arange(nominal.shape[1])
    return SensitivityMatrix(
        jnp.asarray(derivatives[worst, output]),
        jnp.asarray(nominal[worst, output]),
        matrix.values,
        matrix.outputs,
        matrix.parameters,
    )


def rankings(result: Study) -> dict[str, list[Influence]]:
    """Rank the parameters by the change of the worst over time, in per cent for one per cent; the largest first.

    The worst of the slip angles is each finger's largest, by method; that of the reserve of friction its smallest.
    """
    slips = {
        f"slip angles, {name}": _ranking(at_worst(trajectory.matrix, largest=True))
        for name, trajectory in result.slips.items()
    }
    return slips | {"reserve of friction": _ranking(at_worst(result.reserve.matrix, largest=False))}


def _ranking(matrix: SensitivityMatrix) -> list[Influence]:
    names = {entry.name for entry in matrix.parameters}
    return matrix.ranking({name: size for name, size in REFERENCE_SPREADS.items() if name in names})


def spells(times: np.ndarray, is_true: np.ndarray) -> list[tuple[float, float]]:
    """Return the intervals in which a condition is true, to half an instant."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], is_true.astype(int), [0]])))
    middles = np.concatenate([[times[0]], (times[1:] + times[:-1]) / 2, [times[-1]]])
    return [(float(middles[begin]), float(middles[end])) for begin, end in edges.reshape(-1, 2)]
