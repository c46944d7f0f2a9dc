"""``jaxgrasp teleop``: a robot hand in MuJoCo, teleoperated by a simulated person or by a glove."""

import contextlib
import time
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxgrasp.cli.glove import check_ports, which_glove
from jaxgrasp.cli.glove_arguments import Teleop
from jaxgrasp.cli.glove_orders import FIRST, Orders
from jaxgrasp.cli.glove_run import KEYLESS, SLOWEST, Wrist, chosen_substitution, parse_address
from jaxgrasp.cli.machine import compiling, set_up_jax
from jaxgrasp.cli.terminal import announce, show
from jaxgrasp.files.csv_rows import write_rows
from jaxgrasp.files.replace import check_writable
from jaxgrasp.glove.devices import find_device_class
from jaxgrasp.glove.line import SerialLine, check_port
from jaxgrasp.glove.loop.glove_process import GloveProcess
from jaxgrasp.glove.loop.rendering import TickTimes
from jaxgrasp.glove.network.link import NetworkLink
from jaxgrasp.glove.network.messages import load_key
from jaxgrasp.glove.other_devices.polhemus import Tracker
from jaxgrasp.glove.substitution import Substitution, finger_indices
from jaxgrasp.teleop.follower import COMMAND_RATE, PalmPose
from jaxgrasp.teleop.live import OLDEST, RobotConnection, RobotElsewhere, RobotHere, run_person, run_robot
from jaxgrasp.teleop.mujoco_hand import MujocoFollower
from jaxgrasp.teleop.network import NetworkModel, SimulatedLink
from jaxgrasp.teleop.session import PersonMessage, PersonSide, RobotMessage, RobotSide, substitute_contacts
from jaxgrasp.teleop.trial import TrialResult, Workplace, run_trial
from jaxgrasp.validation.checked import check_positive

if TYPE_CHECKING:
    from jaxgrasp.view.teleop_page import TeleopFeed

Watch = Callable[[float, MujocoFollower, np.ndarray], None]


def teleop_command(arguments: Teleop) -> int:
    """Check the arguments, compile, and teleoperate."""
    check_positive(arguments, "seconds", "rate", "trials", "tracker_baud")
    chosen_substitution(arguments)
    network = NetworkModel(1e-3 * arguments.delay, 1e-3 * arguments.jitter, arguments.loss)
    options, glove_model, _ = which_glove(arguments)
    _check_ends(arguments, options)
    if arguments.out is not None:
        check_writable(arguments.out.parent)
    set_up_jax("float64")
    with compiling("both hands, retargeting and force feedback"):
        workplace = Workplace(arguments.scene, glove_model=glove_model, linkage=arguments.linkage)
        workplace.reset()
    with _page(arguments, workplace) as page:
        if arguments.serve is not None:
            return _serve(arguments, workplace, page)
        if arguments.glove is not None:
            return _by_glove(arguments, workplace, network, options, page)
        return _by_simulated_person(arguments, workplace, network, page)


def _check_ends(arguments: Teleop, options: dict[str, Any]) -> None:
    if arguments.glove is not None:
        check_ports(arguments.glove, options)
        if arguments.rate < SLOWEST:
            raise ValueError(f"rate is {arguments.rate:g}: expected at least {SLOWEST:g} [Hz], or the glove lets go")
    for name in ("robot", "tracker", "log"):
        if getattr(arguments, name) is not None and arguments.glove is None:
            raise ValueError(f"{name} needs a glove: pass --glove PORT")
    if arguments.wrist and (arguments.glove or arguments.serve or not arguments.feedback):
        raise ValueError(
            "wrist is a force on the simulated person's wrist: leave out --glove, --serve and --no-feedback"
        )
    if arguments.linkage and arguments.glove is None and arguments.serve is None:
        raise ValueError("linkage is that of a glove: pass --glove PORT, and --linkage to the side that serves too")
    if arguments.seconds is not None and arguments.glove is None and arguments.serve is None:
        raise ValueError("seconds needs a glove or a server: the simulated person ends by itself")
    if arguments.substitution and arguments.robot is not None:
        raise ValueError("substitution is computed at the robot's side: pass it to the side that serves")
    if arguments.substitution and not (arguments.glove or arguments.serve or arguments.view):
        raise ValueError("substitution is felt in a glove or seen on a page: pass --glove PORT or --view")
    if arguments.serve is not None and arguments.glove is not None:
        raise ValueError("serve and glove are both given: the glove's side calls with --robot")
    if arguments.out is not None and (arguments.glove or arguments.serve):
        raise ValueError("out is for trials of the simulated person: leave out --glove and --serve")
    if arguments.view and arguments.robot is not None:
        raise ValueError("view shows the robot's world, which is elsewhere: pass --view to the side that serves")
    for name in ("serve", "robot"):
        if (address := getattr(arguments, name)) is not None:
            parse_address(name, address)
            if not load_key(arguments.key_file):
                announce(KEYLESS)
    if arguments.tracker is not None:
        check_port(arguments.tracker, arguments.tracker_baud)


def _by_simulated_person(
    arguments: Teleop, workplace: Workplace, network: NetworkModel, page: "TeleopFeed | None"
) -> int:
    results = []
    for seed in range(arguments.seed, arguments.seed + arguments.trials):
        watch = None
        if page is not None:
            watch = _paced(page, workplace, f"{arguments.scene}, seed {seed}", chosen_substitution(arguments))
        result = run_trial(
            workplace,
            seed,
            network=network,
            has_feedback=arguments.feedback,
            has_wrist=arguments.wrist,
            on_step=watch,
        )
        results.append((seed, result))
        show(result_line(seed, result))
    if arguments.trials > 1:
        successes = sum(result.is_success for _, result in results)
        show(f"{successes} of {arguments.trials} trials done")
    if arguments.out is not None:
        rows = [[seed, *(f"{x:.6g}" if isinstance(x, float) else x for x in result)] for seed, result in results]
        write_rows(arguments.out, [["seed", *TrialResult._fields], *rows])
        show(f"written: {arguments.out}")
    return 0


def result_line(seed: int, result: TrialResult) -> str:
    """Format the result of a trial as a line of text."""
    return (
        f"seed {seed}: {result.reason} after {result.seconds:.1f} s, {result.misses} misses, contact force at most "
        f"{result.peak_force:.1f} N, energy into the network {1e3 * result.person_energy:.1f} mJ by the person and "
        f"{1e3 * result.robot_energy:.1f} mJ by the robot, their sum at least {1e3 * result.least_net_energy:.2f} mJ"
    )


def _paced(page: "TeleopFeed", workplace: Workplace, title: str, substitution: Substitution | None) -> Watch:
    """Return a watcher that shows each step and keeps to real time."""
    started_at = time.perf_counter()
    fingers = finger_indices(tuple(workplace.follower.links))

    def watch(timestamp: float, follower: MujocoFollower, torques: np.ndarray) -> None:
        force = float(np.linalg.norm(follower.environment_force()))
        felt = None
        if substitution is not None:
            felt = substitute_contacts(substitution, timestamp, follower.contacts(), fingers)
        page.show(f"{title}: {timestamp:.1f} s, the object meets {force:.1f} N", torques, felt)
        time.sleep(max(0.0, started_at + timestamp - time.perf_counter()))

    return watch


def _by_glove(
    arguments: Teleop, workplace: Workplace, network: NetworkModel, options: dict, page: "TeleopFeed | None"
) -> int:
    near = PersonSide(workplace.person, workplace.glove_model, 1 / arguments.rate)
    joints, channels = len(workplace.person.joints), len(workplace.channels)
    robot: RobotConnection
    if arguments.robot is not None:
        host, port = parse_address("robot", arguments.robot)
        size, key = RobotMessage.size(channels), load_key(arguments.key_file)
        robot = RobotElsewhere(NetworkLink(host, port, size, oldest=OLDEST, key=key))
    else:
        rng = np.random.default_rng(arguments.seed)
        feedback = workplace.feedback if arguments.feedback else None
        side = RobotSide(
            workplace.follower, workplace.retargeting, feedback, substitution=chosen_substitution(arguments)
        )
        robot = RobotHere(side, SimulatedLink(network, rng), SimulatedLink(network, rng), joints)
    tracker = None
    if arguments.tracker is not None:
        tracker = Tracker(SerialLine(arguments.tracker, arguments.tracker_baud), arguments.tracker_protocol)
    wrist = Wrist(tracker)

    def pose_at(timestamp: float) -> PalmPose | None:
        moved, home = wrist(timestamp), workplace.task.home
        if moved is None:
            return None
        rotation = np.asarray(moved.rotation) @ workplace.wrist_rotation
        return PalmPose(home.origin + np.asarray(moved.origin), rotation)

    end = None if arguments.seconds is None else time.perf_counter() + arguments.seconds
    extra = {"scale": FIRST}
    try:
        with GloveProcess(arguments.glove or "", channels, **options, **extra) as glove:
            show("ready; orders: arm, full, disarm, stop, quit")
            orders = Orders(glove, find_device_class(arguments.device).acceptance, workplace.glove_model.joints)

            def goes_on(timestamp: float) -> bool:
                state = glove.state()
                if page is not None and state is not None:
                    felt = near.sensations if arguments.substitution else None
                    words = near.trouble or f"{arguments.scene}: the robot follows"
                    page.show(words, state.torques, felt, state)
                return not orders.is_over and glove.is_alive() and (end is None or timestamp < end)

            times = run_person(near, robot, glove.state, glove.write, pose_at, workplace.open, arguments.rate, goes_on)
        if not glove.summary:
            raise OSError("the process that owned the glove's line has ended")
    finally:
        robot.close()
        if tracker is not None:
            tracker.close()
    show(orders.summary())
    show(f"the person's side: {TickTimes.text(times.summary())}")
    return 0


def _serve(arguments: Teleop, workplace: Workplace, page: "TeleopFeed | None") -> int:
    host, port = parse_address("serve", arguments.serve or "")
    joints = len(workplace.person.joints)
    size, key = PersonMessage.size(joints), load_key(arguments.key_file)
    link = NetworkLink(host, port, size, listens=True, oldest=OLDEST, key=key)
    side = RobotSide(
        workplace.follower, workplace.retargeting, workplace.feedback, substitution=chosen_substitution(arguments)
    )
    show(f"the robot waits for a person at {host}:{link.port}")
    end = None if arguments.seconds is None else time.perf_counter() + arguments.seconds
    nothing = np.zeros(len(workplace.channels))

    def goes_on(timestamp: float) -> bool:
        if page is not None:
            page.show("the robot waits" if side.port is None else "the robot follows", nothing)
        return end is None or timestamp < end

    with contextlib.closing(link):
        times = run_robot(side, link, joints, COMMAND_RATE, goes_on)
    show(f"the robot's side: {TickTimes.text(times.summary())}")
    return 0


@contextlib.contextmanager
def _page(arguments: Teleop, workplace: Workplace) -> Iterator["TeleopFeed | None"]:
    if not arguments.view:
        yield None
        return
    from jaxgrasp.view.teleop_page import TeleopFeed

    limits = np.array(workplace.glove_model.limits)
    with TeleopFeed(workplace.follower, workplace.glove_model.joints, limits, arguments.view_port) as page:
        show(f"open {page.address} in a browser")
        yield page
