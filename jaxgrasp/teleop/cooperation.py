"""Several robot hands that hold one object, teleoperated in parallel: the load shared over all of their contacts.

The wrench that the object needs is shared over the contacts of all hands at once, by eq. 16 or by the constrained
optimum, so that the forces sum to the load whatever the hands are. A hand that is lost fades out of the sharing, the
others take over its part without a jump, and lower the object.
"""

import math
from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float

from jaxgrasp.force.distribution import constrained_optimum
from jaxgrasp.model.grasp import Grasp
from jaxgrasp.model.solution import Verdict
from jaxgrasp.teleop.feedback import shared_forces
from jaxgrasp.teleop.follower import FollowerState

Sharing = Literal["closed-form", "optimum"]
FADING_TIME = 0.5
"""Time constant by which a lost hand's part fades [s]."""
LOWERING_SPEED = 0.05
"""Speed at which the other hands lower the object [m/s]."""
FRICTION = 0.8
"""Friction coefficient of the optimum, where none is given."""
LEAST_PART = 1e-6
"""Part of its squeezing forces below which a lost hand counts no more."""


class TeamShare(NamedTuple):
    """Part of one hand in the load."""

    forces: Float[np.ndarray, "C 3"]
    """Forces on the object at this hand's contacts, in the order of the measured ones [N]."""
    wrench: Float[np.ndarray, "6"]
    """Their wrench about the object's centre [N, N.m]."""
    part: float
    """Weight of this hand's squeezing forces, 1 while it is there."""


class TeamStep(NamedTuple):
    """Shares of all hands at one step."""

    shares: tuple[TeamShare, ...]
    is_balanced: bool
    """True if the forces sum to the load; False where the contacts cannot exert it."""
    lowering: float
    """Distance by which all hands are to be lowered from now on [m]."""
    notices: tuple[str, ...]
    """Sentences on hands that were lost or came back at this step."""


class Team:
    """Sharing of one object's load over several followers."""

    def __init__(
        self,
        names: Sequence[str],
        sharing: Sharing = "closed-form",
        *,
        friction: float = FRICTION,
        max_silence: float = 0.025,
    ) -> None:
        """Create a team of which no hand was heard.

        Args:
            names: of the hands, for notices.
            sharing: by eq. 16, or by the constrained optimum where it exists.
            friction: coefficient for the optimum.
            max_silence: time without a newer measurement after which a hand is lost [s].

        Raises:
            ValueError: for no hands, a name that comes twice, another sharing, or numbers that are not positive.
        """
        if not names or len(set(names)) < len(names):
            raise ValueError(f"names is {list(names)}: expected one name or more, each once")
        if sharing not in ("closed-form", "optimum"):
            raise ValueError(f"sharing is {sharing!r}: expected 'closed-form' or 'optimum'")
        for name, value in {"friction": friction, "max_silence": max_silence}.items():
            if not (math.isfinite(value) and value > 0):
                raise ValueError(f"{name} is {value}: expected a positive number")
        self.names, self._sharing = tuple(names), sharing
        self._friction, self._max_silence = friction, max_silence
        self._parts = np.ones(len(names))
        self._is_lost = np.zeros(len(names), bool)
        self._last: list[FollowerState | None] = [None] * len(names)
        self._stepped_at: float | None = None
        self.lowered = 0.0
        """Distance by which the hands were told to lower the object so far [m]."""

    def step(self, timestamp: float, states: Sequence[FollowerState | None], load: Float[np.ndarray, "6"]) -> TeamStep:
        """Share the load over all hands.

        Args:
            timestamp: time now, on the clock of the measurements [s].
            states: newest measurement of each hand; None for a hand that sent nothing yet.
            load: wrench that the hands must exert on the object about its centre, in the world's axes [N, N.m].

        Raises:
            ValueError: for another number of states than there are hands.
        """
        if len(states) != len(self.names):
            raise ValueError(f"states has {len(states)} entries: expected one for each of {len(self.names)} hands")
        dt = 0.0 if self._stepped_at is None else max(timestamp - self._stepped_at, 0.0)
        self._stepped_at = timestamp
        notices = self._find_lost(timestamp, states)
        # A lost hand keeps its last contacts while its part fades.
        self._parts = np.where(self._is_lost, self._parts * math.exp(-dt / FADING_TIME), 1.0)
        self._parts[self._is_lost & (self._parts < LEAST_PART)] = 0.0
        if self._is_lost.any() and not self._is_lost.all():
            self.lowered += LOWERING_SPEED * dt
        contacts = [None if state is None else state.contacts for state in self._last]
        centre = next((state.object_centre for state in states if state is not None), np.zeros(3))
        counts = [0 if c is None else len(c.links) for c in contacts]
        present = [c for c in contacts if c is not None]
        if not present or not sum(counts):
            nothing = TeamShare(np.zeros((0, 3)), np.zeros(6), 1.0)
            return TeamStep((nothing,) * len(self.names), not np.any(load), self.lowered, notices)
        arms = np.concatenate([c.points - centre for c in present])
        normals = np.concatenate([c.normals for c in present])
        forces = np.concatenate([c.forces for c in present])
        squeeze = np.maximum(np.sum(normals * forces, -1), 0.0) * np.repeat(self._parts, counts)
        shared = self._share(arms, normals, squeeze, load)
        residual = load - _wrench(arms, shared)
        is_balanced = bool(np.abs(residual).max() <= 1e-9 * max(1.0, float(np.abs(load).max())))
        bounds = np.cumsum(counts)[:-1]
        parts = zip(np.split(arms, bounds), np.split(shared, bounds), self._parts, strict=True)
        shares = tuple(TeamShare(f, _wrench(a, f), float(part)) for a, f, part in parts)
        return TeamStep(shares, is_balanced, self.lowered, notices)

    def _share(
        self,
        arms: Float[np.ndarray, "n 3"],
        normals: Float[np.ndarray, "n 3"],
        squeeze: Float[np.ndarray, "n"],
        load: Float[np.ndarray, "6"],
    ) -> Float[np.ndarray, "n 3"]:
        if self._sharing == "optimum":
            grasp = Grasp(arms, normals, np.full(len(arms), self._friction), squeeze)
            solution = constrained_optimum(grasp, load)
            if int(solution.verdict) in (Verdict.OPTIMAL, Verdict.CLOSED_FORM_OPTIMAL):
                forces = np.asarray(solution.forces)
                # What the solver's tolerance leaves of the load is shared by eq. 16.
                remainder = load - _wrench(arms, forces)
                return forces + shared_forces(arms, normals, squeeze, remainder) - _internal(arms, normals, squeeze)
        return shared_forces(arms, normals, squeeze, load)

    def _find_lost(self, timestamp: float, states: Sequence[FollowerState | None]) -> tuple[str, ...]:
        notices = []
        for k, (name, state) in enumerate(zip(self.names, states, strict=True)):
            if state is None:
                trouble = "has not answered"
            elif state.cause:
                trouble = f"made an emergency stop: {state.cause}"
            elif timestamp - state.at > self._max_silence:
                trouble = f"has been silent for {1e3 * (timestamp - state.at):.0f} ms"
            else:
                trouble = ""
            if trouble and not self._is_lost[k]:
                notices.append(f"{name} {trouble}: the other hands take its load over and lower the object")
            if not trouble and self._is_lost[k]:
                notices.append(f"{name} is back")
            self._is_lost[k] = bool(trouble)
            if not trouble:
                self._last[k] = state
        return tuple(notices)


def _wrench(arms: Float[np.ndarray, "n 3"], forces: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "6"]:
    return np.concatenate([forces.sum(0), np.cross(arms, forces).sum(0)])


def _internal(
    arms: Float[np.ndarray, "n 3"], normals: Float[np.ndarray, "n 3"], squeeze: Float[np.ndarray, "n"]
) -> Float[np.ndarray, "n 3"]:
    """Return the forces of eq. 16 without a load: they balance to zero."""
    return shared_forces(arms, normals, squeeze, np.zeros(6))
