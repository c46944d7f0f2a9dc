"""A trial of a task in virtual time: person, glove, network and robot, and the numbers that come of it."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxgrasp.glove.model import GloveModel, lrp_hand_master
from jaxgrasp.hand.closing import closing_kinematics
from jaxgrasp.hand.doglove_hand import doglove_hand, linkage_angles
from jaxgrasp.hand.human_hand import human_hand
from jaxgrasp.teleop.feedback import ForceFeedback
from jaxgrasp.teleop.follower import PalmPose
from jaxgrasp.teleop.mujoco_hand import TIMESTEP, HandModel, MujocoFollower, shadow_hand
from jaxgrasp.teleop.network import NetworkModel, SimulatedLink
from jaxgrasp.teleop.operator import OPEN_CLOSURE, PersonModel, Sight, SimulatedOperator
from jaxgrasp.teleop.retarget import Retargeting
from jaxgrasp.teleop.session import PersonMessage, PersonSide, RobotSide
from jaxgrasp.teleop.tasks import TaskName, TeleopTask, make_task
from jaxgrasp.teleop.wrist import SimulatedWrist
from jaxgrasp.validation.checked import checked

FINGERS = ("thumb", "index", "middle", "ring", "little")
FORCE_SCALE = 0.45
"""Scale of the forces that the glove renders: the robot's grip would saturate it."""
CONTROL_PERIOD = 2 * TIMESTEP
"""Time between two messages of a trial [s]: 250 Hz, to halve its cost; the simulation and the motors run at 500 Hz."""
LIMIT_S = 20.0
"""Time after which a trial has failed [s]."""
SETTLING_STEPS = 60
"""Calls of the retargeting at the start, from the open hand to the first posture."""


class TrialResult(NamedTuple):
    """Numbers of one trial."""

    is_success: bool
    reason: str
    """``done``, ``dropped``, ``not done`` where the person was mistaken, or ``time``."""
    seconds: float
    peak_force: float
    """Largest contact force of the object with the socket or the lower block and the table, after the lift [N]."""
    mean_force: float
    """Mean of that force while there was any [N]."""
    misses: int
    person_energy: float
    """Net energy that came into the network at the person's port [J]."""
    robot_energy: float
    """The same at the robot's port [J]."""
    least_net_energy: float
    """Least sum of both at any time [J]."""


@dataclass
class Workplace:
    """Programs that trials share, compiled once: both hands, retargeting and force feedback."""

    task_name: TaskName = "peg"
    hand_model: HandModel = field(default_factory=shadow_hand)
    glove_model: GloveModel = field(default_factory=lrp_hand_master)
    linkage: bool = False
    """True if the glove moves its own linkage on the person's hand, [`jaxgrasp.hand.doglove_hand`][]."""

    def __post_init__(self) -> None:
        self.task: TeleopTask = make_task(self.task_name)
        wearer = human_hand()
        self.person = doglove_hand() if self.linkage else wearer
        self.follower: MujocoFollower = self.task.follower(self.hand_model)
        self.retargeting = Retargeting(self.person, self.follower.hand, FINGERS, wearer=wearer)
        axes = np.asarray(self.retargeting.calibration.axes)
        self.feedback = ForceFeedback(self.person, self.glove_model, self.follower.hand, axes, FORCE_SCALE)
        closing = closing_kinematics(wearer)
        self.open, self.closed = np.asarray(closing.open, float), np.asarray(closing.closed, float)
        if self.linkage:
            self.open, self.closed = (linkage_angles(self.person, wearer, a) for a in (self.open, self.closed))
        self.channels = list(self.glove_model.joint_indices(self.person.joints))
        self.wrist_rotation = self.task.home.rotation @ axes

    def reset(self) -> None:
        """Put the world back to its start, with the hand open around the object."""
        self.retargeting.reset()
        angles = self.open + OPEN_CLOSURE * (self.closed - self.open)
        for _ in range(SETTLING_STEPS):
            posture = self.retargeting(angles)
        self.follower.restart(posture)


@checked
def run_trial(
    workplace: Workplace,
    seed: int,
    *,
    network: NetworkModel | None = None,
    has_feedback: bool = True,
    has_wrist: bool = False,
    person_model: PersonModel | None = None,
    on_step: Callable[[float, MujocoFollower, np.ndarray], None] | None = None,
) -> TrialResult:
    """Run a trial with a simulated person.

    Args:
        workplace: task and programs; it is reset first.
        seed: of the person's and the network's noise.
        network: faults of the network; none where not given.
        has_feedback: False for a glove without torque, where only the screen tells what happens.
        has_wrist: True if with feedback a simulated arm master exerts the contacts' force on the wrist too.
        person_model: numbers of the person.
        on_step: called after each step with time, robot and the glove's torques, for a picture or a film.
    """
    task, follower = workplace.task, workplace.follower
    workplace.reset()
    network = NetworkModel() if network is None else network
    rng = np.random.default_rng(seed)
    outgoing, incoming, screen = (SimulatedLink(network, rng) for _ in range(3))
    round_trip = 2 * network.delay + network.jitter
    person = SimulatedOperator(
        task, workplace.open, workplace.closed, workplace.channels, rng, model=person_model, round_trip=round_trip
    )
    wrist_device = SimulatedWrist() if has_wrist and has_feedback else None
    near = PersonSide(workplace.person, workplace.glove_model, CONTROL_PERIOD, wrist_device=wrist_device)
    feedback = workplace.feedback if has_feedback else None
    far = RobotSide(follower, workplace.retargeting, feedback, has_wrist=wrist_device is not None)
    joints, channels = len(workplace.person.joints), len(workplace.channels)
    torques, forces, least, lifted = np.zeros(channels), [], 0.0, False
    step, reason = 0, "time"
    while (timestamp := step * CONTROL_PERIOD) < LIMIT_S:
        step += 1
        picture = screen.receive(timestamp)
        sight = None if picture is None else Sight(picture[:3], picture[3:])
        wrist_force = None if wrist_device is None else wrist_device.read(timestamp)[:3]
        flexions, shift = person.step(timestamp, torques, sight, wrist_force)
        reply = incoming.receive(timestamp) if has_feedback else None
        if reply is not None:
            near.receive(incoming.arrived_at, reply)
        wrist = PalmPose(task.home.origin + shift.origin, shift.rotation @ workplace.wrist_rotation)
        torques, message = near.step(timestamp, flexions, person.others, wrist)
        outgoing.send(timestamp, message.vector())
        heard = outgoing.receive(timestamp)
        answer = far.step(timestamp, None if heard is None else PersonMessage.of(heard, joints))
        if has_feedback:
            incoming.send(timestamp, answer.vector())
        screen.send(timestamp, np.concatenate([task.tip(follower), follower.data.body("object").xmat[2::3]]))
        net = near.port.tank.net + (far.port.tank.net if far.port else 0.0)
        least = min(least, net)
        lifted = lifted or person.phase == "approach"
        if lifted:
            forces.append(float(np.linalg.norm(follower.environment_force())))
        if on_step is not None:
            on_step(timestamp, follower, torques)
        if person.is_finished:
            reason = "done" if task.is_done(follower) else "not done"
            break
        if (
            lifted
            and person.phase in ("aim", "approach", "lower", "slide", "retreat")
            and not len(far.state.contacts.links)
        ):
            reason = "dropped"
            break
    touching = np.array([force for force in forces if force > 0.05] or [0.0])
    return TrialResult(
        reason == "done",
        reason,
        timestamp,
        float(touching.max()),
        float(touching.mean()),
        person.misses,
        near.port.tank.net,
        far.port.tank.net if far.port else 0.0,
        least,
    )


GRIP_CLOSURES = (0.5, 0.6)
"""Range of the closures of the grips of ``record_torques``."""


def record_torques(glove_model: GloveModel, count: int, seed: int = 0) -> list[Float[np.ndarray, "_ channels"]]:
    """Record the glove's torques over whole trials, half of each task, each with another grip [N.m].

    Args:
        glove_model: of the glove.
        count: number of trials.
        seed: of the first trial.
    """
    tasks: tuple[TaskName, ...] = ("peg", "stack")
    recorded = []
    for first, task in enumerate(tasks):
        workplace = Workplace(task, glove_model=glove_model)
        for k in range(first, count, len(tasks)):
            closure = float(np.random.default_rng([seed, k]).uniform(*GRIP_CLOSURES))
            recorded.append(_record_trial(workplace, seed + k, PersonModel(grip_closure=closure)))
    return recorded


def _record_trial(workplace: Workplace, seed: int, person_model: PersonModel) -> Float[np.ndarray, "T channels"]:
    rows: list[np.ndarray] = []

    def on_step(timestamp: float, follower: MujocoFollower, torques: np.ndarray) -> None:
        rows.append(torques.copy())

    run_trial(workplace, seed, person_model=person_model, on_step=on_step)
    return np.array(rows)
