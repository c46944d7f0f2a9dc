"""A simulated person who teleoperates: a body with stiffness and inertia, noisy senses, and decisions that take time.

The numbers are ours, of the order that the literature reports: finger joints move by minimum-jerk plans [1] of their
equilibrium, with a stiffness about it, and a force on the wrist moves it from its intended place against the stiffness
of the arm [2]; a touch is answered after 0.15 s, a sight after 0.25 s; a change of the felt torque counts from a Weber
fraction on, that of the paper's Table III in the middle.

[1] T. Flash, N. Hogan, The coordination of arm movements, Journal of Neuroscience 5(7), 1985. [2] F. A. Mussa-Ivaldi,
N. Hogan, E. Bizzi, Neural, mechanical, and geometric factors subserving arm posture in humans, Journal of Neuroscience
5(10), 1985.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from jaxgrasp.teleop.follower import PalmPose
from jaxgrasp.teleop.tasks import GOAL_DEPTH, TeleopTask


@dataclass(frozen=True)
class PersonModel:
    """Numbers of a simulated person."""

    stiffness: float = 1.0
    """Of a finger joint about its equilibrium [N.m/rad]."""
    damping: float = 0.04
    """[N.m.s/rad]"""
    inertia: float = 4e-4
    """[kg.m2]"""
    arm_stiffness: float = 300.0
    """Of the wrist about its intended place [N/m]."""
    arm_damping: float = 20.0
    """[N.s/m]"""
    arm_mass: float = 1.5
    """[kg]"""
    touch_time: float = 0.15
    """From a felt change to an action [s]."""
    sight_time: float = 0.25
    """From a seen change to an action [s]."""
    weber: float = 0.15
    """Change of a joint's felt torque that is noticed, as a part of it."""
    least_change: float = 0.005
    """The same in absolute terms [N.m]."""
    place_error: float = 2e-3
    """Standard deviation of the place of the target as it is seen, along each axis [m]."""
    lag_threshold: float = 6e-3
    """Distance by which the seen object must lag behind the hand's motion before that is noticed [m]."""
    tremor: float = 2e-4
    """Standard deviation of the wrist's tremor [m]."""
    grip_closure: float = 0.56
    """Share of the way from the open to the closed hand in a grip."""
    descent_speed: float = 0.02
    """Speed at which the object is lowered, without delay [m/s]."""


class Sight(NamedTuple):
    """Picture on the person's screen, late by the network."""

    tip: Float[np.ndarray, "3"]
    """Lowest end of the object [m]."""
    axis: Float[np.ndarray, "3"]
    """The object's own upward axis, a unit vector."""

    @property
    def is_askew(self) -> bool:
        """Return whether a jammed object is too tilted to go on."""
        return bool(np.hypot(*self.axis[:2]) > ASKEW)


class _Move(NamedTuple):
    """A minimum-jerk motion of the hand's place and closure."""

    begins_at: float
    lasts: float
    start: Float[np.ndarray, "4"]
    end: Float[np.ndarray, "4"]

    def at(self, timestamp: float) -> Float[np.ndarray, "4"]:
        s = min(max((timestamp - self.begins_at) / self.lasts, 0.0), 1.0)
        return self.start + (self.end - self.start) * s**3 * (10 - 15 * s + 6 * s**2)

    def is_over(self, timestamp: float) -> bool:
        return timestamp >= self.begins_at + self.lasts


OPEN_CLOSURE = 0.25
"""Share of the way from the open to the closed hand at the start."""
LIFT = 0.08
"""Height by which the object is lifted over its start [m]."""
MARGIN = 0.012
"""Height over the target from which the object is lowered slowly [m]."""
SEARCH_STEP = 2e-3
"""Growth of the search spiral by a miss [m]."""
LIGHT_PRESS = 1.5e-3
"""Way into a felt surface by which the person presses while sliding over it [m]."""
NEAR = 3e-3
"""Height over the target below which a felt change is taken for its contact [m]."""
PRESSING_SPEED = 3e-4
"""Speed at which the press grows while sliding [m/s]."""
SLIDING_SPEED = 0.012
"""Speed of sliding over a felt surface in search of the hole [m/s]."""
ENTERED = 1.5e-3
"""Depth in the hole from which the person takes the peg for in it [m]."""
ASKEW = 0.2
"""Sine of the seen tilt from which a jammed object is taken out of the hole to be turned upright."""
UPRIGHT_TIME = 0.4
"""Time of that turn, and of the way out [s]."""
SETTLING_TIME = 0.2
"""Time in which the hand gets from the height of a felt contact to a light press [s]."""
LED_TIME = 0.3
"""Time in which the intended place follows a hole that pushes the hand sideways [s]."""
JAM_STEP = 1e-3
"""Standard deviation of a step aside where the peg jams, along each axis [m]."""
RETREAT = 4e-3
"""Way back up after a miss [m]."""


class SimulatedOperator:
    """A person who carries out a task by what is seen and felt; driven by ``step`` in virtual time."""

    def __init__(
        self,
        task: TeleopTask,
        open_angles: Float[np.ndarray, "P"],
        closed_angles: Float[np.ndarray, "P"],
        channels: list[int],
        rng: np.random.Generator,
        *,
        model: PersonModel | None = None,
        round_trip: float = 0.0,
    ) -> None:
        """Create a person at rest, the hand open around the object.

        Args:
            task: to be done.
            open_angles: of all joints of the open hand [rad].
            closed_angles: of the closed hand [rad].
            channels: indices of the glove's joints.
            rng: source of all noise.
            model: numbers of the person.
            round_trip: delay of the network there and back, which the person has got used to [s].
        """
        self.task, self.model = task, PersonModel() if model is None else model
        self._open, self._way = open_angles, closed_angles - open_angles
        self._channels, self._rng, self._round_trip = channels, rng, round_trip
        self._speed = self.model.descent_speed / (1 + 2 * round_trip)
        self._target = task.target + rng.normal(0, self.model.place_error, 2)
        self._turn = _Move(0.0, 1.0, np.zeros(4), np.zeros(4))
        self._pivot, self._before_turn = np.zeros(3), np.zeros(3)
        self._place = np.zeros(4)
        self._place[3] = OPEN_CLOSURE
        self._move = _Move(0.0, 0.8, self._place.copy(), np.array([0, 0, 0, self.model.grip_closure]))
        self.phase = "close"
        self.flexions = self._equilibrium()
        """Angles of the glove's joints [rad]."""
        self._rates = np.zeros(len(channels))
        self._drive, self._tremor = np.zeros(3), np.zeros(3)
        self._yield, self._yield_speed = np.zeros(3), np.zeros(3)
        self._search, self.misses = 0, 0
        self._noticed_at: float | None = None
        self._lowered_from: tuple[float, float] | None = None
        self._noticed_height: float | None = None
        self._slid, self._slide_from, self._pressed_height = 0.0, np.zeros(2), 0.0
        self._last_tip: float | None = None
        self._tip_speed = 0.0
        self._felt = self._baseline = np.zeros(len(channels))
        self._last: float | None = None
        self.is_finished = False
        """True once the person believes that the task is done, or gives up."""

    @property
    def others(self) -> Float[np.ndarray, "P"]:
        """Angles of all joints of the hand; those of the glove's are in ``flexions`` [rad]."""
        return self._open + self._place[3] * self._way

    def step(
        self,
        timestamp: float,
        torques: Float[np.ndarray, "channels"],
        sight: Sight | None,
        wrist_force: Float[np.ndarray, "3"] | None = None,
    ) -> tuple[Float[np.ndarray, "channels"], PalmPose]:
        """Move on to a time; return the flexions [rad], and the displacement of the hand as a pose.

        Args:
            timestamp: time now [s].
            torques: of the glove against flexion [N.m].
            sight: what is on the screen; None before the first picture.
            wrist_force: on the wrist [N]; none where not given.
        """
        dt = 0.0 if self._last is None else timestamp - self._last
        self._last = timestamp
        self._decide(timestamp, dt, torques, sight)
        self._bend(dt, torques)
        if wrist_force is not None:
            self._yield_to(dt, wrist_force)
        self._shake(dt)
        shift, rotation = self._turned(timestamp)
        return self.flexions.copy(), PalmPose(self._place[:3] + shift + self._yield + self._tremor, rotation)

    @property
    def _height(self) -> float:
        """Height of the hand over its start, which the person feels [m]."""
        return float(self._place[2] + self._yield[2])

    def _equilibrium(self) -> Float[np.ndarray, "channels"]:
        return (self._open + self._place[3] * self._way)[self._channels]

    def _bend(self, dt: float, torques: Float[np.ndarray, "channels"]) -> None:
        """Move the finger joints: I q'' + B q' + K (q - q0) = -tau."""
        person = self.model
        pull = person.stiffness * (self._equilibrium() - self.flexions) - torques
        self._rates = _next_speed(self._rates, pull, dt, person.inertia, person.damping, person.stiffness)
        self.flexions = self.flexions + dt * self._rates

    def _shake(self, dt: float) -> None:
        """Let the wrist tremble: noise through two first-order lags of 0.1 s and 0.02 s, since an arm has inertia."""
        slow, fast = np.exp(-dt / 0.1), np.exp(-dt / 0.02)
        # The second lag leaves 0.1 / 0.12 of the variance, to first order in dt.
        size = self.model.tremor * np.sqrt(1.2 * (1 - slow**2))
        self._drive = slow * self._drive + size * self._rng.normal(size=3)
        self._tremor = fast * self._tremor + (1 - fast) * self._drive

    def _yield_to(self, dt: float, force: Float[np.ndarray, "3"]) -> None:
        """Move the wrist from its intended place: m y'' + b y' + k y = F."""
        person = self.model
        pull = force - person.arm_stiffness * self._yield
        self._yield_speed = _next_speed(
            self._yield_speed, pull, dt, person.arm_mass, person.arm_damping, person.arm_stiffness
        )
        self._yield = self._yield + dt * self._yield_speed

    def _decide(
        self, timestamp: float, dt: float, joint_torques: Float[np.ndarray, "channels"], sight: Sight | None
    ) -> None:
        # Felt torques and their slow means, against which changes count, joint by joint.
        self._felt = self._felt + min(dt / 0.02, 1.0) * (joint_torques - self._felt)
        if self.phase in ("close", "lift", "look", "carry", "aim", "approach"):
            self._baseline = self._baseline + min(dt / 0.3, 1.0) * (joint_torques - self._baseline)
        if self.phase == "lower":
            self._lower(timestamp, dt, sight)
            return
        if self.phase == "slide":
            self._slide(timestamp, dt, sight)
            return
        self._place = self._move.at(timestamp)
        if not self._move.is_over(timestamp):
            return
        place = self._place.copy()
        if self.phase == "close":
            place[2] = LIFT
            self._go("lift", timestamp, 0.6, place)
        elif self.phase == "lift":
            self._go("look", timestamp, 0.1 + self._round_trip, place)
        elif self.phase == "look" and sight is not None:
            # The seen tilt is taken back by a turn of the wrist, on the way to the target.
            self._straighten(timestamp, 0.8, sight)
            place[:2] += self._target - sight.tip[:2]
            self._go("carry", timestamp, 0.9, place)
        elif self.phase in ("carry", "retreat"):
            self._go("aim", timestamp, 0.1 + self._round_trip, place)
        elif self.phase == "aim" and sight is not None:
            if sight.is_askew:
                self._straighten(timestamp, UPRIGHT_TIME, sight, about_tip=True)
            place[:2] += self._target + _spiral(SEARCH_STEP * self._search) - sight.tip[:2]
            place[2] += self.task.contact_height + MARGIN - sight.tip[2]
            self._go("approach", timestamp, 0.4, place)
        elif self.phase == "approach":
            self.phase, self._noticed_at, self._lowered_from = "lower", None, None
            self._last_tip, self._tip_speed = None, -self._speed
        elif self.phase == "press":
            place[3] = OPEN_CLOSURE
            self._go("open", timestamp, 0.5, place)
        elif self.phase == "open":
            place[2] += LIFT
            self._go("leave", timestamp, 0.6, place)
        elif self.phase == "leave":
            self.is_finished = True

    def _lower(self, timestamp: float, dt: float, sight: Sight | None) -> None:
        """Lower the object until its contact is felt or seen, and then decide after the reaction time."""
        person, task = self.model, self.task
        self._place[2] -= self._speed * dt
        if sight is None:
            return
        depth = task.contact_height - sight.tip[2]
        if depth > 0:
            # In the hole the person lets the hand be led by it: what the wrist yields to becomes intended.
            self._place[:2] += min(dt / LED_TIME, 1.0) * self._yield[:2]
        if self._lowered_from is None:
            self._lowered_from = self._height, sight.tip[2]
        hand_start, tip_start = self._lowered_from
        # The hand's own motion, as late as the picture is.
        expected = tip_start + self._height - hand_start + self._speed * self._round_trip
        change = np.abs(self._felt - self._baseline)
        # The speed of the tip as it is seen: an object that still goes down has met nothing that stops it.
        if self._last_tip is not None:
            self._tip_speed += min(dt / 0.08, 1.0) * ((sight.tip[2] - self._last_tip) / dt - self._tip_speed)
        self._last_tip = sight.tip[2]
        is_sinking = depth > ENTERED and self._tip_speed < -0.3 * self._speed
        is_changed = change > np.maximum(person.weber * self._baseline, person.least_change)
        # A change far above the surface that is seen below is none of contact.
        is_near = depth > -NEAR - self._speed * self._round_trip
        is_felt = not is_sinking and is_near and bool(is_changed.any())
        is_seen = not is_sinking and sight.tip[2] - expected > person.lag_threshold
        if task.name == "peg" and depth >= GOAL_DEPTH:
            # Seen to be deep enough.
            self.is_finished = True
            return
        if self._noticed_at is None and (is_felt or is_seen):
            self._noticed_at = timestamp + (person.touch_time if is_felt else person.sight_time)
            self._noticed_height = self._place[2] if is_felt else None
        if self._noticed_at is None or timestamp < self._noticed_at:
            return
        self._noticed_at = None
        if not (is_felt or is_seen):
            # It was over before the person could act.
            return
        if task.name == "stack":
            self._go("press", timestamp, 0.1, self._place.copy())
            return
        self.misses += 1
        if self._noticed_height is not None and depth <= ENTERED:
            # A felt surface needs no look: the person lightens the press and slides over it, in a spiral.
            self._pressed_height = self._noticed_height - LIGHT_PRESS
            self.phase, self._slid = "slide", 0.0
            self._slide_from = self._place[:2].copy()
            return
        place = self._place.copy()
        place[2] += max(sight.tip[2] - expected, 0.0) + RETREAT
        if depth > ENTERED:
            if sight.is_askew:
                # Out of the hole, upright, and in again.
                place[2] += depth
                self._go("retreat", timestamp, UPRIGHT_TIME, place)
                return
            # It jams: back a little, beside, upright, and on.
            place[:2] += self._rng.normal(0, JAM_STEP, 2)
            self._straighten(timestamp, 0.2, sight)
            self._go("approach", timestamp, 0.25, place)
            return
        self._search += 1
        self._go("retreat", timestamp, 0.25, place)

    def _slide(self, timestamp: float, dt: float, sight: Sight | None) -> None:
        """Slide over the surface until the tip is seen to sink, then lower the object there."""
        self._slid += SLIDING_SPEED * dt
        self._pressed_height -= PRESSING_SPEED * dt
        self._place[2] += min(dt / SETTLING_TIME, 1.0) * (self._pressed_height - self._place[2])
        self._place[:2] = self._slide_from + _spiral(self._slid)
        if sight is None or self.task.contact_height - sight.tip[2] <= ENTERED / 2:
            self._noticed_at = None
            return
        if self._noticed_at is None:
            self._noticed_at = timestamp + self.model.touch_time
        if timestamp >= self._noticed_at:
            self.phase, self._noticed_at, self._lowered_from = "lower", None, None
            self._last_tip, self._tip_speed = None, -self._speed

    def _straighten(self, timestamp: float, lasts: float, sight: Sight, *, about_tip: bool = False) -> None:
        """Turn the wrist so that the seen tilt is taken back; ``about_tip`` moves the hand so that the tip stays."""
        self._before_turn, _ = self._turned(timestamp)
        hand = self.task.home.origin + self._place[:3] + self._before_turn + self._yield
        self._pivot = sight.tip - hand if about_tip else np.zeros(3)
        begin = self._turn.at(timestamp)
        self._turn = _Move(timestamp, lasts, begin, begin + np.append(np.cross(sight.axis, [0.0, 0.0, 1.0]), 0.0))

    def _turned(self, timestamp: float) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3 3"]]:
        """Return the shift of the hand by its turns, and its rotation."""
        rotation = Rotation.from_rotvec(self._turn.at(timestamp)[:3]).as_matrix()
        start = Rotation.from_rotvec(self._turn.start[:3]).as_matrix()
        # The tip p, seen from the hand at the start of the turn, stays: o + R R_0^T p = o_0 + p.
        return self._before_turn + self._pivot - rotation @ start.T @ self._pivot, rotation

    def _go(self, phase: str, timestamp: float, lasts: float, end: Float[np.ndarray, "4"]) -> None:
        self.phase = phase
        self._move = _Move(timestamp, lasts, self._place.copy(), end)


def _next_speed(
    speed: np.ndarray, pull: np.ndarray, dt: float, inertia: float, damping: float, stiffness: float
) -> np.ndarray:
    """Return the speed after an implicit Euler step of m y'' + b y' + k y = f, with the pull f - k y at its start."""
    return (inertia * speed + dt * pull) / (inertia + dt * damping + dt**2 * stiffness)


def _spiral(length: float) -> Float[np.ndarray, "2"]:
    """Return the point of an Archimedean spiral, with turns ``SEARCH_STEP`` apart, at an arc length from its middle."""
    turn = np.sqrt(4 * np.pi * length / SEARCH_STEP)
    return SEARCH_STEP * turn / (2 * np.pi) * np.array([np.cos(turn), np.sin(turn)])
