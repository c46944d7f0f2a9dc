"""Process that owns the glove's line: ``python -m jaxgrasp.glove.loop.io_process``; it never imports JAX.

Options come as JSON in its only argument, orders (``arm``, ``disarm``, ``stop``, ``scale``) as lines of JSON on its
standard input, whose end ends it; events go out as lines of JSON. However it ends, it tries to send a last zero, and
the device's own watchdog does not depend on that.
"""

import json
import queue
import signal
import sys
import threading
import time
from pathlib import Path
from typing import Any

from jaxgrasp.glove.devices import device_baud, load_model, make_device
from jaxgrasp.glove.guard import Guard, GuardState, append_latch, check_latch_log
from jaxgrasp.glove.line import open_port
from jaxgrasp.glove.loop.child import tell
from jaxgrasp.glove.loop.exchange import TorqueLaw
from jaxgrasp.glove.loop.peers import LinkPeer, NoPeer, Peer, SlotPeer
from jaxgrasp.glove.loop.release import Release
from jaxgrasp.glove.loop.rendering import OLDEST_LAW, SLOWEST_TURNS, IOController, TickTimes, turn_rate
from jaxgrasp.glove.model import GloveModel
from jaxgrasp.glove.monitors import TensionControl
from jaxgrasp.glove.network.link import NetworkLink
from jaxgrasp.glove.network.messages import load_key

OPTIONS = {
    *("port", "baud", "model", "calibration", "rate", "scale", "ramp", "projection", "control", "oldest"),
    *("slots", "listen", "transport", "key_file", "device", "full_scale", "log", "joints_from", "hand"),
    "linkage",
}
END_SIGNALS = [getattr(signal, name) for name in ("SIGTERM", "SIGINT", "SIGHUP", "SIGBREAK") if hasattr(signal, name)]
"""Signals that end the process: termination, interrupt, closed terminal."""
UNFREED = "no release program would free it if this program died"
FIRST_SCALE = 0.05
"""Default scale of all torques, for the first time that power is on."""


def main() -> None:
    """Run until the standard input ends or a signal comes."""
    options = json.loads(sys.argv[1])
    for name in END_SIGNALS:
        signal.signal(name, _exit)
    orders: queue.SimpleQueue[str | None] = queue.SimpleQueue()
    threading.Thread(target=_listen, args=(orders,), daemon=True).start()
    controller = build(options)
    release = Release(options) if controller.host.capability.outlives_host else None
    default_rate = turn_rate(options["baud"]) if options.get("device", "native") == "native" else SLOWEST_TURNS
    times = TickTimes(1.0 / options.get("rate", default_rate))
    try:
        run(controller, times, orders, release, options.get("log"))
    finally:
        # Whoever ends it twice must not keep it from its last zero.
        for name in END_SIGNALS:
            signal.signal(name, signal.SIG_IGN)
        controller.host.close(time.perf_counter())
        controller.peer.close()
        if release is not None:
            release.close(is_free=controller.host.is_free)
        tell({"summary": times.summary() | controller.host.report() | {"torques": controller.record.summary()}})


def build(options: dict[str, Any]) -> IOController:
    """Create the loop that the options describe.

    Raises:
        ValueError: for options that are unknown or out of range.
    """
    for name in options:
        if name not in OPTIONS:
            raise ValueError(f"option is {name!r}: expected one of {', '.join(sorted(OPTIONS))}")
    for name in ("baud", "rate", "full_scale"):
        value = 1 if options.get(name) is None else options[name]
        if isinstance(value, bool) or not isinstance(value, int | float) or not 0 < value < 1e9:
            raise ValueError(f"{name} is {value!r}: expected a positive number")
    if options.get("control", False) not in (True, False):
        raise ValueError(f"control is {options['control']!r}: expected true or false")
    model, sensors = load_model(options)
    bounds = {name: options[name] for name in ("projection", "ramp") if name in options}
    guard = Guard(model, scale=options.get("scale", FIRST_SCALE), **bounds)
    options["baud"] = device_baud(options)
    if options.get("log") is not None:
        check_latch_log(options["log"])
    host = make_device(options, model, sensors, lambda: open_port(options["port"], options["baud"]), guard)
    control = TensionControl(len(model.joints)) if options.get("control") else None
    oldest = options.get("oldest", OLDEST_LAW)
    return IOController(host, _peer(options, model, oldest), oldest=oldest, control=control)


def run(
    controller: IOController,
    times: TickTimes,
    orders: "queue.SimpleQueue[str | None]",
    release: Release | None = None,
    log: str | None = None,
) -> None:
    """Turn the loop at a steady rate and report changes; each latch goes into the log, if there is one."""
    reported: tuple[str, ...] = ()
    due = time.perf_counter()
    while True:
        while not orders.empty():
            order = orders.get()
            if order is None:
                return
            _obey(controller, release, json.loads(order))
        if release is not None and not release.signal_alive():
            controller.host.guard.trip(UNFREED)
        started = time.perf_counter()
        controller.step(started)
        host = controller.host
        status = (host.state.name, host.guard.state.name, host.trouble, host.guard.cause)
        if status != reported:
            if log is not None and host.guard.state == GuardState.LATCHED and status[1::2] != reported[1::2]:
                _log(log, started, controller, times)
            reported = status
            tell({"event": dict(zip(("link", "guard", "trouble", "cause"), status, strict=True)), "at": started})
        ended = time.perf_counter()
        times.add(started - due, ended - started)
        # A turn that was missed is not made up for: its answer would be as late as it is.
        due = max(due + times.period, ended)
        time.sleep(max(0.0, due - time.perf_counter()))


def _log(path: str, at: float, controller: IOController, times: TickTimes) -> None:
    """Append a latch to the log after torque has ended; a full or missing disk does not stop the loop."""
    host, turns = controller.host, times.summary()
    record = {"at": at, "cause": host.guard.cause, "link": host.state.name, "trouble": host.trouble}
    record |= {"counts": host.report()} | {name: turns[name] for name in ("turns", "overruns", "worst")}
    try:
        append_latch(path, record | {"frames": host.last_frames()})
    except OSError as error:
        tell({"unlogged": f"{path}: {error.strerror}", "at": at})


def _peer(options: dict[str, Any], model: GloveModel, oldest: float) -> Peer:
    channels = len(model.joints)
    if options.get("listen"):
        host, port = options["listen"]
        key = load_key(options.get("key_file"))
        transport = options.get("transport", "udp")
        size = TorqueLaw.size(channels)
        link = NetworkLink(host, port, size, listens=True, transport=transport, oldest=oldest, key=key)
        tell({"listens": link.port})
        return LinkPeer(link, channels)
    return SlotPeer(Path(options["slots"]), channels) if options.get("slots") else NoPeer()


def _obey(controller: IOController, release: Release | None, order: dict[str, Any]) -> None:
    timestamp = time.perf_counter()
    try:
        match order:
            case {"arm": accepted}:
                if release is not None and not release.signal_alive():
                    raise ValueError(f"the glove cannot be armed: {UNFREED}")
                controller.arm(timestamp, accepted)
            case {"disarm": _}:
                controller.host.disarm()
            case {"stop": _}:
                controller.host.stop(timestamp)
            case {"scale": scale}:
                controller.host.guard.rescale(scale)
            case {"report": _}:
                tell({"report": controller.host.report()})
                return
            case _:
                raise ValueError(f"order is {order}: expected one of arm, disarm, stop, scale, report")
    except (ValueError, TypeError) as error:
        tell({"refused": str(error), "at": timestamp})
    else:
        tell({"done": order, "at": timestamp})


def _listen(orders: "queue.SimpleQueue[str | None]") -> None:
    for line in sys.stdin:
        orders.put(line)
    orders.put(None)


def _exit(*_: object) -> None:
    raise SystemExit(0)


if __name__ == "__main__":
    main()
