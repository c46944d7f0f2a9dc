"""What every engine answers: where the objects of a world are a step later, and what acted on them on the way."""

from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np

from jaxgrasp.hand.detection import Contacts
from jaxgrasp.model.arrays import AnyArray, Float, Int
from jaxgrasp.model.hand import HandFrames
from jaxgrasp.world.many_bodies import WorldState

HAND, TABLE, OBSTACLES = -1, -2, -3
"""What touches an object and is none."""


class HandMove(NamedTuple):
    """What the hand does in a step."""

    contacts: Contacts
    """``(N, L)``: of its links with the objects at first."""
    now: HandFrames
    """Its frames at first."""
    later: HandFrames
    """Those at the end; every link moves steadily from one to the other."""


class Loads(NamedTuple):
    """What acts on each of N objects, as wrenches about its centre along the world's axes: means over a step."""

    by_table: Float[np.ndarray, "N 6"]
    """[N, N.m]"""
    by_obstacles: Float[np.ndarray, "N 6"]
    by_things: Float[np.ndarray, "N N 6"]
    """On each object (first axis) by each other one."""
    by_hand: Float[np.ndarray, "N 6"]
    """As the engine has it."""

    @property
    def by_world(self) -> Float[np.ndarray, "N 6"]:
        """By all but the hand."""
        return self.by_table + self.by_obstacles + self.by_things.sum(1)


def summed_loads(
    owners: Int[np.ndarray, "m 2"],
    points: Float[np.ndarray, "m 3"],
    forces: Float[np.ndarray, "m 3"],
    centers: Float[AnyArray, "N 3"],
    couples: Float[np.ndarray, "m 3"] | None = None,
) -> Loads:
    """The loads of contact forces, and of couples with them.

    Args:
        owners: the object that each force acts on, and what exerts it: an object that feels its opposite, or
            HAND, TABLE or OBSTACLES.
        points: where they act [m].
        forces: on the first of each [N].
        centers: of the objects [m].
        couples: on the first of each, where fingers are soft [N.m].
    """
    count = len(centers)
    couples = np.zeros(forces.shape) if couples is None else couples
    total = np.zeros((count, count + 3, 6))
    for sign, (mine, its) in ((1.0, owners.T), (-1.0, owners.T[::-1])):
        on = np.flatnonzero(mine >= 0)
        pushes = sign * forces[on]
        torques = np.cross(points[on] - centers[mine[on]], pushes) + sign * couples[on]
        wrenches = np.concatenate([pushes, torques], 1)
        # What is no object comes after the objects.
        np.add.at(total, (mine[on], np.where(its[on] < 0, count - 1 - its[on], its[on])), wrenches)
    by = {source: total[:, count - 1 - source] for source in (HAND, TABLE, OBSTACLES)}
    return Loads(by[TABLE], by[OBSTACLES], total[:, :count], by[HAND])


class Step(NamedTuple):
    """What an engine answers for one step in time."""

    state: WorldState
    """After it."""
    loads: Loads
    gained: Float[np.ndarray, "N 6"]
    """Rate of momentum, linear and angular, of each object [N, N.m]."""
    solved: bool
    """Whether the engine solved its own equations as closely as it means to."""

    def left_to_hand(self, weights: Float[np.ndarray, "N 6"]) -> Float[np.ndarray, "N 6"]:
        """What the hand must have exerted on each object, if these wrenches hold their weights [N, N.m]."""
        return weights + self.gained - self.loads.by_world


AT_REST = 0.01
"""How long a step at rest is, by which it is known what the hand bears at first [s]."""


@runtime_checkable
class Engine(Protocol):
    """Moves the objects of one world; it knows the world from when it was made."""

    def step(self, state: WorldState, hand: HandMove, dt: float) -> Step:
        """The world a step later.

        Args:
            state: of all objects at first.
            hand: what the hand does.
            dt: how long it takes [s].
        """
        ...


def left_at_rest(
    engine: Engine, state: WorldState, contacts: Contacts, frames: HandFrames, weights: Float[np.ndarray, "N 6"]
) -> Float[np.ndarray, "N 6"]:
    """What a hand that does not move has to exert on each object, which table and others may bear [N, N.m].

    Args:
        engine: of the world.
        state: of its objects.
        contacts: of the hand with them.
        frames: of the hand.
        weights: the wrenches that hold the objects' weights.
    """
    return engine.step(state, HandMove(contacts, frames, frames), AT_REST).left_to_hand(weights)
