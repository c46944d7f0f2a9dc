"""``jaxgrasp sensitivity``: which parameters matter along a task, and how."""

import math
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from jaxgrasp.cli.arguments import FollowSensitivity
from jaxgrasp.cli.machine import compiling, sampled_times, set_up_jax
from jaxgrasp.cli.terminal import show
from jaxgrasp.files.csv_rows import write_rows
from jaxgrasp.files.file_values import nearest
from jaxgrasp.files.replace import check_writable
from jaxgrasp.model.solution import methods_named
from jaxgrasp.sensitivity.naming import Labels
from jaxgrasp.sensitivity.study import Study, rankings, spells, study
from jaxgrasp.sensitivity.task_file import FINGERS, NamedTask, cylinder_task, load_task
from jaxgrasp.validation.checked import check_positive

BY_CONTACT = ("azimuths", "contributions", "depths", "friction", "heights", "points", "normals", "stiffness")
LISTED_PARAMETERS = 5
"""Parameters of a ranking that are said; the file has them all."""
MOST_VALUES = 4


def sensitivity_command(arguments: FollowSensitivity) -> int:
    """Differentiate, write, and say what matters."""
    check_positive(arguments, "seconds", "step")
    times = sampled_times(arguments.seconds, arguments.step)
    methods = [method.name for method in methods_named(arguments.methods)]
    if len(arguments.values) > MOST_VALUES:
        raise ValueError(f"values are {len(arguments.values)}: expected at most {MOST_VALUES}, which a figure can show")
    if arguments.task != "cylinder" and not Path(arguments.task).is_file():
        raise ValueError(f"task is {arguments.task!r}: expected a TOML file, or cylinder")
    check_writable(arguments.out)
    set_up_jax("float64")
    task, fingers = NamedTask(cylinder_task(), FINGERS) if arguments.task == "cylinder" else load_task(arguments.task)
    if arguments.finger not in fingers:
        raise ValueError(f"finger is {arguments.finger!r}{nearest(arguments.finger, fingers)}")
    by_contact = [name for name in BY_CONTACT if hasattr(task.parameters.held, name)]
    labels: Labels = dict.fromkeys((*by_contact, "slip_angle"), fingers)
    with compiling("the task and its derivatives"):
        results = study(task, times, methods, arguments.by, arguments.vary, arguments.values, labels)
    arguments.out.mkdir(parents=True, exist_ok=True)
    write_rows(arguments.out / "sensitivity.csv", _curves(results, fingers))
    write_rows(arguments.out / "ranking.csv", _rankings(results))
    show("\n".join(_result_lines(results, fingers, arguments.finger)))
    show(f"written: {arguments.out / 'sensitivity.csv'}, {arguments.out / 'ranking.csv'}")
    if arguments.report:
        from jaxgrasp.report.sensitivity_picture import write_sensitivity_picture

        try:
            path = arguments.out / "sensitivity.png"
            write_sensitivity_picture(path, results, arguments.finger, arguments.vary)
            show(f"figure:  {path}")
        except ImportError as error:
            show(f"no figure: {error}")
    return 0


def _curves(results: Study, fingers: Sequence[str]) -> Iterable[Sequence]:
    """Yield the header and a row for each method, finger and instant: slip angle [rad], and its derivatives."""
    first = next(iter(results.slips.values())).matrix
    units = [
        f"d slip_angle / d {parameter.label} [rad{f'/({parameter.unit})' if parameter.unit else ''}]"
        for parameter in first.parameters
    ]
    yield ["method", "finger", "time [s]", "slip_angle [rad]", *units]
    for method, trajectory in results.slips.items():
        nominal, derivatives = np.asarray(trajectory.matrix.nominal), np.asarray(trajectory.matrix.derivatives)
        for k, finger in enumerate(fingers):
            for t, time in enumerate(np.asarray(trajectory.times)):
                numbers = (nominal[t, k], *derivatives[t, k])
                yield [method, finger, f"{time:.6g}", *(f"{value:.9g}" for value in numbers)]


def _rankings(results: Study) -> Iterable[Sequence]:
    yield ["of the worst", "parameter", "unit", "value", "influence of 1% [%]"]
    matrix = results.reserve.matrix
    sizes = np.asarray(matrix.values)
    values = {entry.label: (entry.unit, value) for entry, value in zip(matrix.parameters, sizes, strict=True)}
    for name, ranked in rankings(results).items():
        for influence in ranked:
            unit, value = values[influence.label]
            yield [name, influence.label, unit, f"{value:.9g}", f"{influence.size:.6g}"]


def _result_lines(results: Study, fingers: Sequence[str], finger: str) -> list[str]:
    """Format worst slip angles, reserve of friction and the first parameters of each ranking as lines."""
    lines, k = [], fingers.index(finger)
    for method, trajectory in results.slips.items():
        times, slips = np.asarray(trajectory.times), np.degrees(trajectory.matrix.nominal)
        pulled = ", ".join(f"{begin:.2f} to {end:.2f} s" for begin, end in spells(times, slips[:, k] > 90))
        lines.append(
            f"{method}: worst slip angle {slips.max():.1f} degrees; {finger} {slips[:, k].max():.1f} degrees"
            + (f", pulled at from {pulled}" if pulled else "")
        )
    reserve = np.asarray(results.reserve.matrix.nominal)[:, 0]
    worst = int(np.argmin(reserve))
    at_worst_s = np.asarray(results.reserve.times)[worst]
    lines.append(f"reserve of friction: {reserve[worst]:.2f} at the worst, at {at_worst_s:.2f} s")
    for name, ranked in rankings(results).items():
        influences = ", ".join(f"{influence.label} {_size(influence.size)}" for influence in ranked[:LISTED_PARAMETERS])
        lines.append(f"{name}: 1% of a parameter moves the worst over time by, in %: {influences}")
    return lines


def _size(value: float) -> str:
    return f"{value:.2g}" if math.isfinite(value) else "without bound"
