"""``jaxgrasp glove test``: each sensor is read, each joint moves, each motor pulls, and what is wrong is said."""

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from jaxgrasp.cli.glove import WHERE, check_ports, which_glove
from jaxgrasp.cli.glove_arguments import Test
from jaxgrasp.cli.glove_orders import FIRST, FRESH, GOES_ON, arm_and_confirm
from jaxgrasp.cli.terminal import show, typed
from jaxgrasp.glove.devices import find_device_class
from jaxgrasp.glove.glove_device import LinkState
from jaxgrasp.glove.guard import GuardState
from jaxgrasp.glove.loop.exchange import GloveState, TorqueLaw
from jaxgrasp.glove.loop.glove_process import GloveProcess
from jaxgrasp.glove.model import GloveModel
from jaxgrasp.glove.sensors import Encoders, Sensors, save_sensors
from jaxgrasp.validation.checked import check_positive

LINKED_WITHIN = 5.0
"""Longest time for a glove to answer [s]."""
RESTED = 2.0
"""Time for which a hand rests [s]."""
RAMPED, SETTLED, PULLED = 2.2, 0.3, 0.5
"""Time for the guard's ramp after arming, for a torque to settle, and for which it is then measured [s]."""
ATTEMPTS = 3
"""Number of times that a motor may fail before it counts."""
PERIOD = 0.005
MAX_NOISE, FLAT_RANGE = 1.0, (-25.0, 40.0)
"""Standard deviation of an angle at rest, and range of the angles of a flat hand [degrees]."""
MIN_RATE = 30.0
"""Lowest rate of new angles [Hz]: the guard latches at angles that are 50 ms old."""
MIN_TRAVEL, MIN_SPREAD = 25.0, 5.0
"""Smallest travel of a flexion and of an abduction that the person moves through [degrees]."""
TORQUE_RATIO, TORQUE_TOLERANCE = (0.4, 1.7), 0.003
"""Range of measured over commanded torque, and tolerance beside it [N.m]."""


@dataclass(frozen=True, eq=False)
class Listened:
    """States of a glove for a while."""

    duration_s: float
    """[s]"""
    read_at: Float[np.ndarray, "times"]
    """Times at which the angles were read [s], each once."""
    angles: Float[np.ndarray, "times channels"]
    """[degrees]"""
    causes: tuple[str, ...]
    """Reasons why the link was lost, each once."""


def test_command(arguments: Test) -> int:
    """Test the sensors, and the motors if asked for; return 1 if anything is wrong."""
    check_positive(arguments, "seconds")
    options, model, sensors = which_glove(arguments)
    if arguments.out is not None and arguments.device not in ("native", "doglove"):
        raise ValueError(f"out is {arguments.out}, and a glove of the device {arguments.device} is not calibrated")
    try:
        check_ports(arguments.port, options)
    except OSError as error:
        raise OSError(f"{error}; {WHERE}") from None
    device = find_device_class(arguments.device)
    if arguments.pull and not any(model.is_resisted):
        raise ValueError(f"pull was given, and {model.name} has no motor")
    if arguments.pull and device.capability.resists_by != "torque":
        raise ValueError(f"pull was given, and {model.name} resists by {device.capability.resists_by}, not by torque")
    findings: list[str] = []
    with GloveProcess(arguments.port, len(model.joints), **options, scale=FIRST) as glove:
        _wait_linked(glove)
        flat = "flat hand on a table"
        if arguments.linkage:
            flat = "straight linkage, without a hand, all bars of each finger in line,"
        show(f"rest the {flat} for {RESTED:g} s")
        rest = _listen(glove, RESTED)
        findings += judge_rest(rest, model)
        show(f"bend and stretch every joint, and spread and close the fingers, for {arguments.seconds:g} s")
        findings += judge_motion(_listen(glove, arguments.seconds), model)
        if arguments.pull:
            show("keep the fingers half bent")
            findings += _pull(glove, model, device.acceptance, measures=device.capability.measures_torque)
    counts = {name: value for name, value in glove.summary.items() if name not in ("torques", "edges", "late", "busy")}
    show(f"counted: {counts}")
    if arguments.out is not None and len(rest.read_at):
        zeros = sensors.encoders.zero - np.radians(np.median(rest.angles, 0))
        save_sensors(Sensors(Encoders(zeros, sensors.encoders.per_count), sensors.gauges), arguments.out)
        zero = "straight linkage" if arguments.linkage else "flat hand"
        show(f"written: {arguments.out}, in which the {zero} is at zero")
    for finding in findings:
        show(f"wrong: {finding}")
    show(f"{len(findings)} faults were found" if findings else "no fault was found")
    return 1 if findings else 0


def judge_rest(listened: Listened, model: GloveModel) -> list[str]:
    """Return what is wrong with the angles of a hand that rests flat."""
    findings = [f"the link was lost: {cause}" for cause in listened.causes]
    if len(listened.read_at) < 2:
        return [*findings, "no angles came"]
    rate = len(listened.read_at) / listened.duration_s
    if rate < MIN_RATE:
        findings.append(f"angles came {rate:.0f} times a second: expected at least {MIN_RATE:.0f}")
    noise, means = listened.angles.std(0), np.median(listened.angles, 0)
    for k, joint in enumerate(model.joints):
        if not np.isfinite(means[k]):
            findings.append(f"{joint} reads no number")
            continue
        if noise[k] > MAX_NOISE:
            findings.append(f"{joint} moves by {noise[k]:.1f} degrees (standard deviation) though the hand rests")
        if not FLAT_RANGE[0] <= means[k] <= FLAT_RANGE[1]:
            findings.append(f"{joint} reads {means[k]:.0f} degrees on the flat hand: calibrate it, or check its plug")
    return findings


def judge_motion(listened: Listened, model: GloveModel) -> list[str]:
    """Return which joints did not move, or the wrong way, while a person bent and spread all of them."""
    findings = [f"the link was lost: {cause}" for cause in listened.causes]
    if len(listened.read_at) < 2:
        return [*findings, "no angles came"]
    lowest, highest = np.percentile(listened.angles, [2, 98], axis=0)
    for k, joint in enumerate(model.joints):
        is_spread = "abduction" in joint
        smallest = MIN_SPREAD if is_spread else MIN_TRAVEL
        travel = highest[k] - lowest[k]
        if not travel >= smallest:
            findings.append(
                f"{joint} moved by {travel:.1f} degrees: expected at least {smallest:g}; check its encoder and its plug"
            )
        elif not is_spread and -lowest[k] > highest[k]:
            findings.append(
                f"{joint} counts down as it bends, to {lowest[k]:.0f} degrees: calibrate it, its sign is wrong"
            )
    return findings


def judge_pull(
    model: GloveModel,
    channel: int,
    commanded: Float[np.ndarray, "times channels"],
    measured: Float[np.ndarray, "times channels"],
) -> list[str]:
    """Return what is wrong with the torques that were measured while one motor pulled.

    Args:
        model: of the glove.
        channel: whose motor pulled.
        commanded: torques that left [N.m].
        measured: torques that were measured [N.m].
    """
    asked, given = np.median(commanded[:, channel]), np.median(measured[:, channel])
    joint = model.joints[channel]
    if not np.isfinite(given):
        return [f"the torque of {joint} is not measured"]
    least, most = TORQUE_RATIO[0] * asked - TORQUE_TOLERANCE, TORQUE_RATIO[1] * asked + TORQUE_TOLERANCE
    findings = []
    if not least <= given <= most:
        findings.append(f"{joint} pulled {given:.4f} N.m: commanded {asked:.4f}")
    others: Bool[np.ndarray, channels] = np.array(model.is_resisted)
    others[channel] = False
    pulls = np.where(others, np.median(np.abs(measured), 0), 0.0)
    worst = int(np.argmax(pulls))
    if pulls[worst] > max(TORQUE_TOLERANCE, 0.5 * asked):
        findings.append(
            f"{model.joints[worst]} pulled {pulls[worst]:.4f} N.m as {joint} was to pull: are they swapped?"
        )
    return findings


def _wait_linked(glove: GloveProcess) -> None:
    end = time.perf_counter() + LINKED_WITHIN
    while time.perf_counter() < end and glove.is_alive():
        state = glove.state()
        if state is not None and state.link >= LinkState.LINKED:
            return
        time.sleep(PERIOD)
    state = glove.state()
    raise OSError(f"no glove answered: {'the process has ended' if state is None else state.cause}; {WHERE}")


def _listen(
    glove: GloveProcess, duration_s: float, each: Callable[[GloveState], None] = lambda state: None
) -> Listened:
    """Collect new angles for a while; ``each`` is called with every state."""
    times: list[float] = []
    angles: list[np.ndarray] = []
    causes: dict[str, None] = {}
    end = time.perf_counter() + duration_s
    while time.perf_counter() < end:
        state = glove.state()
        if state is not None:
            each(state)
            if state.link < LinkState.LINKED:
                causes[state.cause] = None
            elif not times or state.angles_at > times[-1]:
                times.append(state.angles_at)
                angles.append(np.degrees(state.angles))
        time.sleep(PERIOD)
    channels = 0 if not angles else len(angles[0])
    return Listened(duration_s, np.array(times), np.array(angles).reshape(len(times), channels), tuple(causes))


def _pull(glove: GloveProcess, model: GloveModel, acceptance: str, *, measures: bool) -> list[str]:
    """Let each motor pull in turn, once the person has said so, and return what is wrong."""
    words = acceptance or "arm"
    show(f"{GOES_ON if acceptance else 'the motors will pull'}; to go on, type: {words}")
    if (typed("") or "").strip() != words:
        return ["the motors were not tested: the person did not agree"]
    findings: list[str] = []
    try:
        for channel in np.flatnonzero(model.is_resisted).tolist():
            channel_findings: list[str] = []
            for _ in range(ATTEMPTS):
                # On a busy machine the glove lets go now and then; what is wrong stays so.
                channel_findings = _pull_one(glove, model, channel, acceptance, measures=measures)
                if not channel_findings:
                    break
            findings += channel_findings
    except ValueError as error:
        findings.append(f"the glove could not be armed: {error}")
    glove.disarm()
    return findings


def _pull_one(glove: GloveProcess, model: GloveModel, channel: int, accepted: str, *, measures: bool) -> list[str]:
    """Let one motor pull, and return what is wrong.

    Raises:
        ValueError: if the glove is not armed.
    """
    joint, channels = model.joints[channel], len(model.joints)
    torques, slope = np.where(np.arange(channels) == channel, model.limits, 0.0), np.zeros((channels, channels))
    armed: list[GloveState] = []

    def write(state: GloveState) -> None:
        glove.write(TorqueLaw(time.perf_counter(), True, np.nan_to_num(state.angles), torques, slope))
        if state.guard == GuardState.ARMED:
            armed.append(state)

    _listen(glove, 0.1, write)
    state = glove.state()
    if state is None or state.guard != GuardState.ARMED:
        _arm(glove, accepted, write)
        _listen(glove, RAMPED, write)
    _listen(glove, SETTLED, write)
    armed.clear()
    _listen(glove, PULLED, write)
    state = glove.state()
    if not armed or state is None or state.guard != GuardState.ARMED:
        return [f"torque ended while {joint} pulled: {'' if state is None else state.cause}"]
    commanded = np.array([state.torques for state in armed])
    measured = np.array([state.measured for state in armed])
    given = f", measured {np.median(measured[:, channel]):.4f}" if measures else ""
    show(f"{joint}: commanded {np.median(commanded[:, channel]):.4f} N.m{given}")
    return judge_pull(model, channel, commanded, measured) if measures else []


def _arm(glove: GloveProcess, accepted: str, write: Callable[[GloveState], None]) -> None:
    """Arm the glove while fresh laws go on to be written."""
    is_over = threading.Event()

    def feed() -> None:
        while not is_over.wait(PERIOD):
            state = glove.state()
            if state is not None:
                write(state)

    thread = threading.Thread(target=feed, daemon=True)
    thread.start()
    try:
        arm_and_confirm(glove, accepted, FRESH)
    finally:
        is_over.set()
        thread.join()
