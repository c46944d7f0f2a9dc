"""``jaxgrasp glove calibrate``: recorded pairs to a calibration."""

import csv
import math
from pathlib import Path

import numpy as np

from jaxgrasp.cli.glove_arguments import Calibrate
from jaxgrasp.cli.terminal import show
from jaxgrasp.glove.calibrate import CalibrationLine, fit_encoders, fit_gauges, load_model, save_sensors
from jaxgrasp.glove.model import GloveModel
from jaxgrasp.glove.sensors import Sensors
from jaxgrasp.report.calibration_picture import write_calibration_picture

COLUMNS = ("sensor", "channel", "counts", "value")
SENSORS = ("encoder", "gauge")


def calibrate_command(arguments: Calibrate) -> int:
    """Read, fit, write, and say how well it fits."""
    model, nominal = load_model({"model": arguments.model})
    pairs = read_pairs(arguments.pairs, model)
    encoders, gauges = nominal.encoders, nominal.gauges
    lines: dict[str, CalibrationLine] = {}
    if "encoder" in pairs:
        encoders, lines["encoder"] = fit_encoders(*pairs["encoder"])
    if "gauge" in pairs:
        gauges, lines["gauge"] = fit_gauges(*pairs["gauge"], nominal.gauges.arm, nominal.gauges.full)
    save_sensors(Sensors(encoders, gauges), arguments.out)
    for sensor, line in lines.items():
        show(_said(sensor, line, model))
    for sensor in SENSORS:
        if sensor not in lines:
            show(f"no pairs of a {sensor}: its nominal calibration stays")
    show(f"written: {arguments.out}")
    if arguments.plot:
        _plot(arguments, pairs, lines, model)
    return 0


def read_pairs(path: Path, model: GloveModel) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Counts and values ``(pairs, channels)`` of each sensor that a file has; NaN fills shorter channels.

    Raises:
        ValueError: for a file without these columns, and lines that are no pair; the message names the line.
    """
    with open(path, newline="", encoding="utf-8") as stream:
        reader = csv.DictReader(stream)
        missing = [name for name in COLUMNS if name not in (reader.fieldnames or ())]
        if missing:
            raise ValueError(f"{path} has no column {missing[0]!r}: expected {', '.join(COLUMNS)}")
        found = [_pair(row, reader.line_num, path, model) for row in reader]
    pairs = {}
    for sensor in SENSORS:
        of_channels = [
            [(counts, value) for one, place, counts, value in found if one == sensor and place == k]
            for k in range(len(model.joints))
        ]
        longest = max(map(len, of_channels))
        if longest:
            counts, values = np.zeros((longest, len(of_channels)), int), np.full((longest, len(of_channels)), np.nan)
            for k, some in enumerate(of_channels):
                for i, (count, value) in enumerate(some):
                    counts[i, k], values[i, k] = count, value
            pairs[sensor] = counts, values
    if not pairs:
        raise ValueError(f"{path} has no pairs")
    return pairs


def _pair(row: dict[str, str], line: int, path: Path, model: GloveModel) -> tuple[str, int, int, float]:
    where = f"{path}, line {line}"
    if row["sensor"] not in SENSORS:
        raise ValueError(f"{where}: sensor is {row['sensor']!r}: expected {' or '.join(SENSORS)}")
    if row["channel"] not in model.joints:
        raise ValueError(f"{where}: channel is {row['channel']!r}: expected one of {', '.join(model.joints)}")
    try:
        counts, value = int(row["counts"]), float(row["value"])
    except (TypeError, ValueError):
        raise ValueError(f"{where}: counts {row['counts']!r}, value {row['value']!r}: expected numbers") from None
    if not math.isfinite(value):
        raise ValueError(f"{where}: value is {value}: expected a finite number")
    return row["sensor"], model.joints.index(row["channel"]), counts, value


def _said(sensor: str, line: CalibrationLine, model: GloveModel) -> str:
    unit, factor = ("\N{DEGREE SIGN}", math.degrees(1)) if sensor == "encoder" else ("N", 1.0)
    worst = int(np.nanargmax(line.rms))
    rms = f"{factor * np.median(line.rms):.3g} {unit}"
    return f"{sensor}s: residuals {rms} in the median, {factor * line.rms[worst]:.3g} {unit} at {model.joints[worst]}"


def _plot(arguments: Calibrate, pairs: dict, lines: dict[str, CalibrationLine], model: GloveModel) -> None:
    path = arguments.out.with_suffix(".png")
    try:
        write_calibration_picture(path, pairs, lines, model.joints)
        show(f"figure:  {path}")
    except ImportError as error:
        show(f"no figure: {error}")
