"""``jaxgrasp glove run``: the virtual hand in a glove, in virtual time or now, on one computer or on two."""

import time
from collections.abc import Callable, Iterable, Sequence
from typing import TYPE_CHECKING, Any

import jax.numpy as jnp
import numpy as np

from jaxgrasp.cli.glove import check_ports, which_glove
from jaxgrasp.cli.glove_arguments import Run
from jaxgrasp.cli.glove_orders import FIRST, CutTorques, Orders
from jaxgrasp.cli.machine import compiling, set_up_jax
from jaxgrasp.cli.terminal import announce, show
from jaxgrasp.files.csv_rows import write_rows
from jaxgrasp.files.replace import check_writable
from jaxgrasp.glove.devices import device_baud, find_device_class
from jaxgrasp.glove.glove_device import GloveDevice
from jaxgrasp.glove.line import SerialLine, check_port, open_port
from jaxgrasp.glove.loop.exchange import GloveState, TorqueLaw
from jaxgrasp.glove.loop.glove_process import GloveProcess
from jaxgrasp.glove.loop.peers import EngineLink
from jaxgrasp.glove.loop.rendering import OLDEST_LAW, TickTimes, TorqueRecord, loop_delay
from jaxgrasp.glove.model import GloveModel
from jaxgrasp.glove.network.link import NetworkLink
from jaxgrasp.glove.network.messages import MAX_NUMBERS, VARIABLE, load_key
from jaxgrasp.glove.other_devices.alignment import Alignment, at_home, load_alignment
from jaxgrasp.glove.other_devices.openxr import WristTracker
from jaxgrasp.glove.other_devices.polhemus import Tracker
from jaxgrasp.glove.simulated.simulated_glove import Fingers
from jaxgrasp.glove.substitution import MAX_TEMPERATURE, Substitution, SubstitutionLaw
from jaxgrasp.grip.scene_file import GrippedScene, SceneFile, human_scale_warnings, load_scene, scene_path
from jaxgrasp.lab.contact_sensations import ContactSensations
from jaxgrasp.lab.grasp_and_lift import Story, grasp_and_lift
from jaxgrasp.lab.haptic_loop import HandHaptics, Haptics, pose_at, run_loop
from jaxgrasp.lab.loaded_scene import loaded_scene
from jaxgrasp.lab.world_haptics import WorldHaptics
from jaxgrasp.model.hand import Pose
from jaxgrasp.report.glove_picture import write_glove_picture
from jaxgrasp.validation.checked import check_positive
from jaxgrasp.world.quasi_static import QuasiStaticEngine
from jaxgrasp.world.world_file import world_of

if TYPE_CHECKING:
    from jaxgrasp.cli.glove_arguments import Teleop
    from jaxgrasp.view.view_slots import ViewFeed

Tick = Callable[[float, Any, Pose], TorqueLaw]

COMPILED = "the hand, its contacts and its torques"
KEYLESS = f"warning: no key: anyone on the network can speak for the other side; give both --key-file, or {VARIABLE}"
OLDEST_POSE = 0.1
"""Age beyond which a tracker's pose is not acted on [s]."""
SLOWEST = 1.5 / OLDEST_LAW
"""Rate of ticks below which forces grow too old between two of them, even if a tick takes a third of that time [Hz]."""


def run_command(arguments: Run) -> int:
    """Play the story, or render what a glove touches now."""
    check_positive(arguments, "seconds", "rate", "tracker_baud")
    if not arguments.listen and arguments.rate < SLOWEST:
        raise ValueError(
            f"rate is {arguments.rate:g}: expected at least {SLOWEST:g} [Hz], since a glove lets go of forces that are "
            f"{1e3 * OLDEST_LAW:.0f} ms old"
        )
    options, model, _ = which_glove(arguments)
    if arguments.listen and arguments.port is None:
        raise ValueError("listen needs the port of the glove")
    if arguments.connect and arguments.port is not None:
        raise ValueError("--port and --connect were both given: expected one of them")
    if (arguments.listen or arguments.connect) and TorqueLaw.size(len(model.joints)) > MAX_NUMBERS:
        raise ValueError(
            f"{model.name} has {len(model.joints)} channels, too many for a datagram between two computers: give "
            "--model, a file of 17 or fewer"
        )
    file = load_scene(scene_path(arguments.scene))
    if arguments.follow_grip and file.other:
        raise ValueError(
            f"follow-grip was given, and the scene has {len(file.other)} tables [[other]]: expected none, since a "
            "grip is recognised on a single object"
        )
    alignment = _check_ends(arguments, options)
    chosen_substitution(arguments)
    _check_substitution(arguments)
    if arguments.host != Run.host and not arguments.view:
        raise ValueError(f"host is {arguments.host}, for the page of --view: add --view")
    if arguments.view and (arguments.listen or (arguments.port is None and arguments.connect is None)):
        raise ValueError("view needs a glove, by port or connect: it shows the engine's side of the loop")
    if arguments.listen:
        return _serve(arguments, model, options)
    for line in human_scale_warnings(file):
        announce(line)
    set_up_jax("float64")
    if arguments.port is None and arguments.connect is None:
        return _play(arguments, model, file)
    return _render(arguments, model, options, alignment, file)


def _check_ends(arguments: Run, options: dict[str, Any]) -> Alignment | None:
    """Check ports, addresses and files of both ends before compilation; return the tracker's alignment, if given."""
    if arguments.port is None and arguments.connect is None:
        for name in ("seconds", "control", "tracker", "alignment", "log"):
            if getattr(arguments, name):
                raise ValueError(f"{name} needs the port of a glove: without one, all happens in virtual time")
        if arguments.device != "native":
            raise ValueError(f"device is {arguments.device!r}: expected native where all happens in virtual time")
    for name in ("listen", "connect"):
        if (address := getattr(arguments, name)) is not None:
            parse_address(name, address)
            if not load_key(arguments.key_file):
                announce(KEYLESS)
    alignment = None if arguments.alignment is None else load_alignment(arguments.alignment)
    if arguments.port is not None:
        check_ports(arguments.port, options)
    if arguments.tracker is not None:
        check_port(arguments.tracker, arguments.tracker_baud)
    return alignment


def chosen_substitution(arguments: "Run | Teleop", friction: float | None = None) -> Substitution | None:
    """Return a substitution of the arguments, of fingers that do not touch; None where none is asked for.

    Args:
        arguments: with ``substitution`` and ``warmest``.
        friction: coefficient of friction that slip margins are taken with; that of the law where not given.

    Raises:
        ValueError: for a temperature that is out of range, or given without ``substitution``.
    """
    if not arguments.substitution:
        if arguments.warmest != Run.warmest:
            raise ValueError(f"warmest is {arguments.warmest:g}, for --substitution: add --substitution")
        return None
    if not SubstitutionLaw.resting_temperature <= arguments.warmest <= MAX_TEMPERATURE:
        raise ValueError(
            f"warmest is {arguments.warmest:g}: expected {SubstitutionLaw.resting_temperature:g} to "
            f"{MAX_TEMPERATURE:g} deg C"
        )
    frictions = {} if friction is None else {"friction": friction}
    return Substitution(SubstitutionLaw(highest_temperature=arguments.warmest, **frictions))


def _check_substitution(arguments: Run) -> None:
    if not arguments.substitution:
        return
    if arguments.listen:
        raise ValueError("substitution is computed at the engine's side: pass it to the side that connects")
    if arguments.port is None and arguments.connect is None:
        raise ValueError("substitution is felt in a glove: pass --port or --connect")
    if find_device_class(arguments.device).sense is GloveDevice.sense:
        raise ValueError(f"substitution was given, and the device {arguments.device} has no vibration")


def _play(arguments: Run, model: GloveModel, file: SceneFile) -> int:
    check_writable(arguments.out)
    with compiling(f"{COMPILED}, and playing the whole story"):
        gripped = loaded_scene(file, arguments.linkage)
        story = grasp_and_lift(model, arguments.law, gripped, _haptics(arguments, model, file, gripped))
    arguments.out.mkdir(parents=True, exist_ok=True)
    table = arguments.out / "glove.csv"
    write_rows(table, _rows(story, model))
    show(_story_line(story))
    for line in TorqueRecord.lines(story.torque_summary):
        show(line)
    show(f"written: {table}")
    picture = arguments.out / "glove.png"
    curves = (story.times, story.torques, story.angles, story.ticks, story.heights, story.marks)
    try:
        write_glove_picture(picture, model.joints, *curves)
        show(f"figure:  {picture}")
    except ImportError as error:
        show(f"no figure: {error}")
    return 0


def _rows(story: Story, model: GloveModel) -> Iterable[Sequence]:
    """Yield the header and a row each five milliseconds: time, torques [N.m], angles [rad], and height [m]."""
    torques, angles = (
        [f"{name} {joint}" for joint in model.joints] for name in ("against flexion [N.m]", "angle [rad]")
    )
    yield ["time [s]", *torques, *angles, "height [m]"]
    heights = np.interp(story.times, story.ticks, story.heights)
    for k in range(0, len(story.times), 5):
        numbers = (*story.torques[k], *story.angles[k], heights[k])
        yield [f"{story.times[k]:.3f}", *(f"{number:.6g}" for number in numbers)]


def _story_line(story: Story) -> str:
    cut, again = story.marks["cable cut"], story.marks["armed again"]
    before, after = story.times < cut, (story.times >= cut) & (story.times < again)
    held = story.times[after & np.any(story.torques > 0, axis=1)]
    off_ms = 1e3 * (held[-1] - cut) if len(held) else 0.0
    return (
        f"most torque {story.torques[before].max():.3f} N.m, lifted {100 * story.heights.max():.1f} cm; after the cut "
        f"no torque from {off_ms:.0f} ms on; armed again, {story.torques[-1].max():.3f} N.m"
    )


def _serve(arguments: Run, model: GloveModel, options: dict) -> int:
    """Own the glove's line for an engine that calls."""
    host, port = parse_address("listen", arguments.listen or "")
    extra = {"listen": (host, port), "scale": FIRST, "projection": arguments.projection}
    if arguments.key_file is not None:
        extra["key_file"] = str(arguments.key_file.resolve())
    with GloveProcess(arguments.port or "", len(model.joints), **options, **extra, control=arguments.control) as glove:
        show(f"waits for an engine at {host}:{port}; orders: arm, full, disarm, stop, quit")
        orders = Orders(glove, find_device_class(arguments.device).acceptance, model.joints)
        end = None if arguments.seconds is None else time.perf_counter() + arguments.seconds
        while not orders.is_over and (end is None or time.perf_counter() < end) and glove.is_alive():
            time.sleep(0.05)
        if not glove.is_alive():
            raise OSError("the process that owned the glove's line has ended")
    _show_end(orders, glove)
    return 0


def _show_end(orders: Orders, glove: GloveProcess) -> None:
    """Show why torque ended, which torques were cut, and the times of the line, after the process has ended."""
    show(orders.summary())
    if not glove.summary:
        return
    for line in TorqueRecord.lines(glove.summary["torques"]):
        show(line)
    show(f"the line: {TickTimes.text(glove.summary)}")


def _render(arguments: Run, model: GloveModel, options: dict, alignment: Alignment | None, file: SceneFile) -> int:
    """Compute contacts and forces, for a glove here or elsewhere."""
    with compiling(COMPILED):
        gripped = loaded_scene(file, arguments.linkage)
        haptics = _haptics(arguments, model, file, gripped)
        haptics.warm_up(pose_at(jnp.zeros(3)))
        rendering = _with_sensations(arguments, haptics, file)
    if arguments.port is not None and arguments.device == "native" and isinstance(haptics, Haptics):
        for line in trembling(haptics, device_baud(options), arguments.rate):
            announce(line)
    tracker, feed = _tracker(arguments), None
    wrist = Wrist(tracker, alignment)
    try:
        feed = _feed(arguments, haptics, gripped)
        end = None if arguments.seconds is None else time.perf_counter() + arguments.seconds
        if arguments.connect is not None:
            times = _as_engine(arguments, haptics, rendering, wrist, end, feed)
        else:
            extra = {"scale": FIRST, "projection": arguments.projection, "control": arguments.control}
            with GloveProcess(arguments.port or "", len(model.joints), **options, **extra) as glove:
                show("ready; orders: arm, full, disarm, stop, quit")
                orders = Orders(glove, find_device_class(arguments.device).acceptance, model.joints)
                goes_on = lambda time_s: not orders.is_over and glove.is_alive() and (end is None or time_s < end)  # noqa: E731
                tick, state = watched(haptics, glove.state, feed, rendering.tick)
                times = run_loop(tick, state, glove.write, wrist, arguments.rate, goes_on)
            if not glove.summary:
                raise OSError("the process that owned the glove's line has ended")
            _show_end(orders, glove)
            if arguments.substitution and glove.summary.get("vibrators", 1) == 0:
                show("no vibration was felt: the glove has no channel for it")
    finally:
        if tracker is not None:
            tracker.close()
        if feed is not None:
            feed.close()
    show(f"the engine: {TickTimes.text(times.summary())}")
    return 0


def trembling(haptics: Haptics, baud: int, rate: float) -> list[str]:
    """Return a warning where the held object feels stiffer than the line renders without trembling.

    Args:
        haptics: hand and object, before their first tick.
        baud: of the glove's line.
        rate: of the torque laws [Hz].
    """
    stiffness = haptics.lifted_stiffness()
    largest = Fingers().quiet_stiffness(loop_delay(baud, rate))
    if stiffness <= largest:
        return []
    return [
        f"the object in the hand feels {stiffness:.2g} N.m/rad stiff, and a line of {baud} baud with {rate:g} laws a "
        f"second renders up to about {largest:.2g} N.m/rad without trembling: give a higher --baud or --rate, or the "
        "object a lower stiffness"
    ]


def _haptics(arguments: Run, model: GloveModel, file: SceneFile, gripped: GrippedScene) -> Haptics | WorldHaptics:
    """Return the haptics of one object, or of a world of several that the quasi-static engine moves."""
    law, angles = arguments.law or gripped.law, np.asarray(gripped.closed.angles)
    if not file.other:
        return Haptics(gripped.scene, model, angles, gripped.placed, law, follows=arguments.follow_grip)
    world, state = world_of(file, gripped)
    return WorldHaptics(world, model, angles, state, QuasiStaticEngine(world, state), law)


def _with_sensations(
    arguments: Run, haptics: Haptics | WorldHaptics, file: SceneFile
) -> Haptics | WorldHaptics | ContactSensations:
    """Return the haptics with the sensations that the arguments ask for."""
    frictions = [file.object.friction, *(entry.friction for entry in file.other)]
    # The most slippery object warns first.
    substitution = chosen_substitution(arguments, min(frictions))
    return haptics if substitution is None else ContactSensations(haptics, substitution)


def _feed(arguments: Run, haptics: Haptics | WorldHaptics, gripped: GrippedScene) -> "ViewFeed | None":
    """Serve the page if asked for, compiled before the glove is armed; return its feed, or None."""
    if not arguments.view:
        return None
    from jaxgrasp.view.view_slots import Carried, ViewFeed

    page_data: dict[str, Any] = {"made": gripped, "law": haptics.law, "worn": haptics.glove}
    n_bodies = 1
    if isinstance(haptics, WorldHaptics):
        page_data |= {"world": haptics.world, "state": haptics.state}
        n_bodies = len(haptics.world.bodies)
    extra_size = Carried.size(n_bodies, len(gripped.scene.hand.links))
    with compiling("the page"):
        feed = ViewFeed(len(haptics.model.joints), extra_size, page_data, (arguments.view_port,), arguments.host)
    show(f"open {feed.addresses[0]} in a browser")
    return feed


def watched(
    haptics: HandHaptics, state: Callable[[], GloveState | None], feed: "ViewFeed | None", tick_once: Tick
) -> tuple[Tick, Callable[[], GloveState | None]]:
    """Wrap the haptics' tick and the reader of the glove's state so that each tick also goes to the page's feed.

    Args:
        haptics: whose state the page shows.
        state: reader of the glove's state.
        feed: of the page; None without one.
        tick_once: tick of these haptics, with the sensations where they are asked for.
    """
    if feed is None:
        return tick_once, state
    from jaxgrasp.view.view_slots import Carried, ViewFrame

    latest: list[GloveState | None] = [None]

    def read() -> GloveState | None:
        latest[0] = state()
        return latest[0]

    def tick(time_s: float, angles: Any, wrist: Pose) -> TorqueLaw:
        law, read_last = tick_once(time_s, angles, wrist), latest[0]
        if read_last is not None:
            carried = Carried.at(wrist, haptics.followed)
            feed.write(ViewFrame.ticked(read_last, law, carried.vector()))
        return law

    return tick, read


def _as_engine(
    arguments: Run,
    haptics: Haptics | WorldHaptics,
    rendering: Haptics | WorldHaptics | ContactSensations,
    wrist: "Wrist",
    end: float | None,
    feed: "ViewFeed | None",
) -> TickTimes:
    host, port = parse_address("connect", arguments.connect or "")
    channels = len(haptics.model.joints)
    engine = EngineLink(NetworkLink(host, port, GloveState.size(channels), key=load_key(arguments.key_file)), channels)
    show(f"calls {host}:{port}; the glove is armed there")
    cut_torques = CutTorques(haptics.model.joints)
    read = lambda: _tell_cut_torques(engine.state(time.perf_counter()), cut_torques)  # noqa: E731
    tick, state = watched(haptics, read, feed, rendering.tick)
    try:
        return run_loop(
            tick,
            state,
            lambda law: engine.write(time.perf_counter(), law),
            wrist,
            arguments.rate,
            lambda time_s: end is None or time_s < end,
        )
    finally:
        engine.close()


def _tell_cut_torques(state: GloveState | None, cut_torques: CutTorques) -> GloveState | None:
    """Show which torques are cut, if that has to be told, and return the state."""
    if line := cut_torques.line(time.perf_counter(), state):
        show(line)
    return state


class Wrist:
    """Pose of the wrist: the origin, or a tracker's pose, aligned by three places or by the first sample."""

    def __init__(self, tracker: Tracker | WristTracker | None, alignment: Alignment | None = None) -> None:
        self._tracker, self._alignment = tracker, alignment

    def __call__(self, time_s: float) -> Pose | None:
        """Return the pose at the time ``time_s`` [s]; None while the tracker has no sample or only an old one."""
        if self._tracker is None:
            return pose_at(jnp.zeros(3))
        sample = self._tracker.poll(time_s)
        if sample is None or time_s - self._tracker.sampled_at > OLDEST_POSE:
            return None
        if self._alignment is None:
            self._alignment = at_home(sample)
        return pose_at(*self._alignment.pose(sample))


def _tracker(arguments: Run) -> Tracker | WristTracker | None:
    if arguments.tracker is None:
        return None
    if arguments.tracker_protocol == "openxr":
        return WristTracker(open_port(arguments.tracker, arguments.tracker_baud), hand=arguments.hand)
    return Tracker(SerialLine(arguments.tracker, arguments.tracker_baud), arguments.tracker_protocol)


def parse_address(name: str, text: str) -> tuple[str, int]:
    """Split HOST:PORT of the argument ``name``; raise ValueError for other text."""
    host, colon, port = text.rpartition(":")
    if not (colon and host and port.isdigit() and 0 < int(port) < 65536):
        raise ValueError(f"{name} is {text!r}: expected HOST:PORT")
    return host, int(port)
