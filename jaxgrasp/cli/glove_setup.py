"""``jaxgrasp glove align`` and ``calibrate``: how a tracker stands, and the lines of the glove's sensors."""

import csv
import math
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from jaxgrasp.cli.glove_arguments import Align, Calibrate
from jaxgrasp.cli.terminal import show, typed
from jaxgrasp.files.file_values import decimal_number
from jaxgrasp.glove.devices import load_model
from jaxgrasp.glove.line import SerialLine
from jaxgrasp.glove.model import GloveModel
from jaxgrasp.glove.other_devices.alignment import Alignment, aligned, save_alignment, with_lever
from jaxgrasp.glove.other_devices.polhemus import Tracker, TrackerSample
from jaxgrasp.glove.sensors import CalibrationLine, Sensors, fit_encoders, fit_gauges, save_sensors
from jaxgrasp.report.glove_picture import write_calibration_picture

PLACES = {
    "home": "hold the hand at home, palm down and fingers forward, where the object will be before it",
    "forward": "move it forward by 10 cm or more, not turning it",
    "up": "bring it back home, then move it up by 10 cm or more",
}
LISTENED, STEADY = 0.5, 0.005
"""Time of sampling at a place [s], and largest distance between samples of one place [m]."""
TURNED = 10.0
"""Time for which a hand turns in place [s]."""
TURN = (
    f"rest the wrist on a table's edge; then, for {TURNED:.0f} s, roll the hand and bend the wrist to and fro in all "
    "directions, the wrist staying in its place"
)


def align_command(arguments: Align) -> int:
    """Ask for the three places and for turns in place, and write the alignment that they tell."""
    tracker = Tracker(SerialLine(arguments.tracker, arguments.tracker_baud), arguments.tracker_protocol)
    try:
        samples = {name: _sample_at(tracker, instruction, typed) for name, instruction in PLACES.items()}
        alignment = aligned(samples["home"], samples["forward"], samples["up"])
        if arguments.turn:
            alignment = _with_turns(tracker, alignment, typed)
    finally:
        tracker.close()
    save_alignment(alignment, arguments.out)
    if arguments.turn:
        lever = ", ".join(str(round(1e3 * x)) for x in alignment.lever.tolist())
        show(f"the receiver is at ({lever}) mm from the wrist's centre: forward, left, up in the palm-down hand's axes")
    else:
        show("the receiver counts as at the wrist's centre: a hand that turns in place will seem to move")
    show(f"written: {arguments.out}; jaxgrasp glove run --alignment {arguments.out} uses it")
    return 0


def _with_turns(tracker: Tracker, alignment: Alignment, ask: Callable[[str], object]) -> Alignment:
    """Ask the person to turn the hand in place until the turns tell the lever arm, and return the alignment with it."""
    while True:
        ask(f"{TURN}; Enter to begin ")
        samples = _listen_turning(tracker)
        if not samples:
            raise OSError(f"the tracker sent nothing for {TURNED} s: check that it is on")
        try:
            return with_lever(alignment, samples)
        except ValueError as error:
            show(f"{error}; try again")


def _sample_at(tracker: Tracker, instruction: str, ask: Callable[[str], object]) -> TrackerSample:
    """Ask the person to go to a place, and return a sample once the hand holds still there."""
    while True:
        ask(f"{instruction}; Enter when it is there ")
        samples = _listen(tracker)
        if not samples:
            raise OSError(
                f"the tracker sent nothing for {LISTENED} s: check that it is on, and that its protocol is right"
            )
        positions = np.stack([sample.position for sample in samples])
        apart = float(np.linalg.norm(positions - positions[0], axis=1).max())
        if apart <= STEADY:
            return samples[len(samples) // 2]
        show(f"the hand moved by {1e3 * apart:.0f} mm meanwhile: expected at most {1e3 * STEADY:.0f}; try again")


def _listen_turning(tracker: Tracker) -> list[TrackerSample]:
    """Collect the tracker's samples of a hand that turns in place."""
    return _listen(tracker, TURNED)


def _listen(tracker: Tracker, duration_s: float = LISTENED) -> list[TrackerSample]:
    """Collect the tracker's samples for ``duration_s`` seconds, each once."""
    samples: list[TrackerSample] = []
    started = time.perf_counter()
    while (time_s := time.perf_counter()) < started + duration_s:
        sample = tracker.poll(time_s)
        if sample is not None and tracker.sampled_at >= started and (not samples or sample is not samples[-1]):
            samples.append(sample)
        time.sleep(0.005)
    return samples


COLUMNS = ("sensor", "channel", "counts", "value")
SENSORS = ("encoder", "gauge")
MOST_COUNTS = 2.0**31
"""No counter of a glove goes further, and no glove feels a value [rad, N] as large as the next."""
LARGEST_VALUE = 1e6


def calibrate_command(arguments: Calibrate) -> int:
    """Read, fit, write, and say how well it fits."""
    model, nominal = load_model({"model": arguments.model, "device": arguments.device})
    pairs = read_pairs(arguments.pairs, model)
    encoders, gauges = nominal.encoders, nominal.gauges
    lines: dict[str, CalibrationLine] = {}
    if "encoder" in pairs:
        encoders, lines["encoder"] = fit_encoders(*pairs["encoder"])
    if "gauge" in pairs:
        gauges, lines["gauge"] = fit_gauges(*pairs["gauge"], nominal.gauges.arm, nominal.gauges.full)
    save_sensors(Sensors(encoders, gauges), arguments.out)
    for sensor, line in lines.items():
        show(_residuals_line(sensor, line, model))
    for sensor in SENSORS:
        if sensor not in lines:
            show(f"no pairs of a {sensor}: its nominal calibration stays")
    show(f"written: {arguments.out}")
    if arguments.plot:
        _plot(arguments, pairs, lines, model)
    return 0


def read_pairs(path: Path, model: GloveModel) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Read counts and values ``(pairs, channels)`` of each sensor in a CSV file; NaN fills shorter channels.

    Raises:
        ValueError: for a file without these columns, and lines that are no pair; the message names the line.
    """
    try:
        with open(path, newline="", encoding="utf-8") as stream:
            reader = csv.DictReader(stream)
            missing = [name for name in COLUMNS if name not in (reader.fieldnames or ())]
            if missing:
                raise ValueError(f"{path} has no column {missing[0]!r}: expected {', '.join(COLUMNS)}")
            rows = [_pair(row, reader.line_num, path, model) for row in reader]
    except (csv.Error, UnicodeDecodeError) as error:
        raise ValueError(f"{path} is not CSV in UTF-8: {error}") from None
    pairs = {}
    for sensor in SENSORS:
        by_channel = [
            [(counts, value) for row_sensor, channel, counts, value in rows if row_sensor == sensor and channel == k]
            for k in range(len(model.joints))
        ]
        longest = max(map(len, by_channel))
        if longest:
            counts, values = np.zeros((longest, len(by_channel)), int), np.full((longest, len(by_channel)), np.nan)
            for k, channel_pairs in enumerate(by_channel):
                for i, (count, value) in enumerate(channel_pairs):
                    counts[i, k], values[i, k] = count, value
            pairs[sensor] = counts, values
    if not pairs:
        raise ValueError(f"{path} has no pairs")
    return pairs


def _pair(row: dict[str, str], line: int, path: Path, model: GloveModel) -> tuple[str, int, int, float]:
    location = f"{path}, line {line}"
    if row["sensor"] not in SENSORS:
        raise ValueError(f"{location}: sensor is {row['sensor']!r}: expected {' or '.join(SENSORS)}")
    if row["channel"] not in model.joints:
        raise ValueError(f"{location}: channel is {row['channel']!r}: expected one of {', '.join(model.joints)}")
    counts, value = _number(location, "counts", row, MOST_COUNTS), _number(location, "value", row, LARGEST_VALUE)
    if counts != round(counts):
        raise ValueError(f"{location}: counts is {counts}: expected a whole number")
    return row["sensor"], model.joints.index(row["channel"]), int(counts), value


def _number(location: str, name: str, row: dict[str, str], largest: float) -> float:
    try:
        number = decimal_number(row[name] or "")
    except ValueError as error:
        raise ValueError(f"{location}: {name} {error}") from None
    if not abs(number) <= largest:
        raise ValueError(f"{location}: {name} is {number:g}: expected a number up to {largest:g}")
    return number


def _residuals_line(sensor: str, line: CalibrationLine, model: GloveModel) -> str:
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
