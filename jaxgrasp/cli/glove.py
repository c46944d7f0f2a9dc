"""``jaxgrasp glove simulate``, ``monitor`` and ``ports``; none needs JAX."""

import contextlib
import math
import os
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from jaxgrasp.cli.glove_arguments import GloveArmed, GloveDriven, GloveFiles, Monitor, Ports, Simulate
from jaxgrasp.cli.terminal import show
from jaxgrasp.files.replace import FolderHeldError, locked
from jaxgrasp.glove.devices import check_joints_from, device_baud, find_device_class, load_model, make_device
from jaxgrasp.glove.glove_device import GloveDevice, LinkState
from jaxgrasp.glove.guard import Guard, check_latch_log
from jaxgrasp.glove.line import PipeLine, check_port, open_port
from jaxgrasp.glove.model import GloveModel
from jaxgrasp.glove.other_devices.doglove import BOARD_BAUD
from jaxgrasp.glove.other_devices.opengloves import encode_input, input_pipe
from jaxgrasp.glove.sensors import Sensors
from jaxgrasp.glove.simulated.simulator import Simulator
from jaxgrasp.validation.checked import check_finite, check_not_negative, check_positive

SHOWN_EVERY = 0.1
"""Time between two lines of the monitor [s]."""
TROUBLE_EVERY = 2.0
"""Time between two complaints [s]."""
NAMED_EVERY = 10
"""Lines of the monitor after which a screen is told the channels' names again."""
DEGREES, MILLI = "\N{DEGREE SIGN}", "[mN\N{MIDDLE DOT}m]"
TURN = 0.005
WHERE = "`jaxgrasp glove ports` lists the ports, `jaxgrasp glove simulate` makes one, in the folder where it runs"
HALF_PERIOD = 2.0
"""Half the period of a simulated person's movement to and fro [s]."""


def which_glove(arguments: GloveFiles) -> tuple[dict[str, Any], GloveModel, Sensors]:
    """Check the arguments; return the glove's options for another process, its model, and its sensors."""
    check_positive(arguments, "baud")
    named = {"model": arguments.model, "calibration": arguments.calibration}
    options: dict[str, Any] = {name: str(path.resolve()) for name, path in named.items() if path is not None}
    if isinstance(arguments, GloveDriven):
        check_positive(arguments, "full_scale")
        find_device_class(arguments.device)
        options |= {"device": arguments.device, "full_scale": arguments.full_scale}
        check_joints_from(arguments.device, arguments.joints_from)
        options |= {"hand": arguments.hand} | ({"linkage": True} if arguments.linkage else {})
        if arguments.joints_from is not None:
            options |= {"joints_from": arguments.joints_from}
    options |= {"baud": device_baud({"baud": arguments.baud, **options})}
    if isinstance(arguments, GloveArmed) and arguments.log is not None:
        check_latch_log(arguments.log)
        options |= {"log": str(arguments.log.resolve())}
    return options, *load_model(options)


def check_ports(port: str, options: dict[str, Any]) -> None:
    """Check that the port of a glove, and that from which its joints are read if it is another, can be opened.

    Raises:
        LineError: if one cannot be opened.
    """
    check_port(port, options["baud"])
    if "joints_from" in options:
        check_port(options["joints_from"], BOARD_BAUD)


def simulate_command(arguments: Simulate) -> int:
    """Run until the time is over, or someone interrupts, which is no error."""
    check_finite(arguments, "bend")
    check_not_negative(arguments, "spoil")
    check_positive(arguments, "seconds")
    options, model, _ = which_glove(arguments)
    if not arguments.port.absolute().parent.is_dir():
        raise ValueError(f"port is {arguments.port}: there is no folder {arguments.port.absolute().parent}")
    with contextlib.ExitStack() as stack:
        try:
            stack.enter_context(locked(arguments.port.absolute().parent, part=arguments.port.name))
        except FolderHeldError as error:
            raise ValueError(f"port is {arguments.port}, which another simulated glove uses: {error}") from None
        if arguments.port.is_symlink() and _is_left_over(arguments.port):
            arguments.port.unlink()
        if arguments.port.exists():
            raise ValueError(f"port is {arguments.port}: expected a name that does not exist yet")
        simulated = Simulator(port=str(arguments.port.absolute()), friction=arguments.friction, **options)
        return _simulate(arguments, model, simulated)


def _is_left_over(link: Path) -> bool:
    """Check that a link, locked by no simulated glove, is the remains of a killed process.

    Such a link is broken, or leads to a pseudo-terminal that another program may own by now.
    """
    return not link.exists() or os.readlink(link).startswith(("/dev/pts/", "/dev/ttys"))


def _simulate(arguments: Simulate, model: GloveModel, simulated: Simulator) -> int:
    end = math.inf if arguments.seconds is None else time.perf_counter() + arguments.seconds
    with contextlib.suppress(KeyboardInterrupt), simulated as simulator:
        show(f"a simulated glove waits at {arguments.port}")
        if arguments.spoil:
            simulator.order(spoil=arguments.spoil, seed=0)
        goes_there = True
        while time.perf_counter() < end:
            if arguments.bend:
                angle = math.radians(arguments.bend) if goes_there else 0.0
                simulator.order(bend=[angle] * len(model.joints), lasts=HALF_PERIOD)
                goes_there = not goes_there
            time.sleep(max(0.0, min(HALF_PERIOD, end - time.perf_counter())))
    return 0


def monitor_command(arguments: Monitor) -> int:
    """Show what the sensors say and how old it is, one line each time."""
    check_positive(arguments, "seconds")
    options, model, sensors = which_glove(arguments)
    if arguments.publish is not None and arguments.linkage:
        raise ValueError("publish takes the joints of a human hand, and --linkage reads those of the linkage: drop one")
    try:
        check_ports(arguments.port, options)
    except OSError as error:
        raise OSError(f"{error}; {WHERE}") from None
    host = make_device(options, model, sensors, lambda: open_port(arguments.port, options["baud"]), Guard(model))
    show("channels: " + ", ".join(model.joints))
    publish = _publisher(arguments.publish, model)
    linked = False

    def turn(time_s: float) -> None:
        nonlocal linked
        host.poll(time_s)
        host.send(time_s, np.zeros(len(model.joints)), time_s)
        linked = linked or host.state >= LinkState.LINKED
        if host.state >= LinkState.LINKED:
            publish(host.reading.angles)

    try:
        header = f"{'[' + DEGREES + ']':>9}  {' '.join(f'{_short(name):>4}' for name in model.joints)}"
        _watch(
            arguments,
            header,
            turn,
            lambda elapsed, time_s: reading_line(host, elapsed, time_s),
            lambda: host.state >= LinkState.LINKED,
        )
    finally:
        host.close(time.perf_counter())
    if not linked:
        raise OSError(f"no glove answered: {host.trouble}; {WHERE}")
    return 0


def _publisher(pipe: str | None, model: GloveModel) -> Callable[[np.ndarray], object]:
    """Return a function that writes angles ``(channels,)`` [rad] to OpenGloves' input pipe, if one is given.

    Raises:
        LineError: if the pipe cannot be opened.
    """
    if pipe is None:
        return lambda angles: None
    line = PipeLine(input_pipe(pipe) if pipe in ("right", "left") else pipe, writes=True)
    joints = [*model.joints, *(coupled.joint for coupled in model.coupled)]
    transmission = model.transmission(joints)
    return lambda angles: line.write(encode_input(dict(zip(joints, (angles @ transmission).tolist(), strict=True))))


def _watch(
    arguments: Monitor,
    header: str,
    turn: Callable[[float], None],
    format_line: Callable[[float, float], str],
    is_there: Callable[[], bool],
) -> None:
    """Turn until the time is over or someone interrupts, and print what is said as often as is due."""
    started = time.perf_counter()
    # An answer takes a moment: nothing is missing before that.
    next_shown = started + SHOWN_EVERY
    end = math.inf if arguments.seconds is None else started + arguments.seconds
    lines = 0
    with contextlib.suppress(KeyboardInterrupt):
        while (time_s := time.perf_counter()) < end:
            turn(time_s)
            if is_there() and lines == 0:
                next_shown = time_s
            if time_s >= next_shown:
                next_shown = time_s + (SHOWN_EVERY if is_there() else TROUBLE_EVERY)
                # On a screen the names do not scroll away; in a file they stand once.
                if is_there() and (lines == 0 or (sys.stdout.isatty() and lines % NAMED_EVERY == 0)):
                    show(header)
                lines += is_there()
                show(format_line(time_s - started, time_s))
            time.sleep(TURN)


def reading_line(host: GloveDevice, elapsed: float, time_s: float) -> str:
    """Format angles [degrees], their age and, if measured, torques [mN m], in lines of less than 100 columns."""
    if host.state < LinkState.LINKED:
        return f"{elapsed:7.1f} s  {host.trouble}"
    reading = host.reading
    angles = " ".join(f"{angle:4.0f}" for angle in np.degrees(reading.angles))
    torques = ""
    if host.capability.measures_torque:
        torques = f"\n{MILLI:>9}  {' '.join(f'{1e3 * torque:4.0f}' for torque in reading.torques)}"
    age = 1e3 * (time_s - reading.angles_at)
    end = "  a gauge is at its end" if reading.saturated.any() else ""
    also = f"  {host.status_text()}".rstrip()
    return f"{elapsed:7.1f} s  {angles}   {age:.0f} ms old{end}{also}{torques}"


def _short(joint: str) -> str:
    """Shorten a joint's name to about four letters, the first of which tells the finger."""
    finger, _, suffix = joint.partition(" ")
    return f"{finger[:1]}{suffix}" if suffix else finger[:4]


def ports_command(command: Ports) -> int:
    """Print device and description of each serial port."""
    from serial.tools.list_ports import comports

    ports = sorted(comports())
    for port in ports:
        show(f"{port.device}  {port.description}")
    if not ports:
        show("no serial port was found")
    return 0
