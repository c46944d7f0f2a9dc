"""Interface of engines: the state of a world's objects one step later, and the loads that acted on them meanwhile."""

from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np

from jaxgrasp.hand.detection import Contacts
from jaxgrasp.model.arrays import AnyArray, Float, Int
from jaxgrasp.model.hand import HandFrames
from jaxgrasp.world.many_bodies import WorldState

HAND, TABLE, OBSTACLES = -1, -2, -3
"""Codes of bodies in contact that are not objects of the world."""


class HandMove(NamedTuple):
    """Motion of the hand in one step, and its contacts at the start."""

    contacts: Contacts
    """``(N, L)``: contacts of its links with the objects at the start."""
    current: HandFrames
    """Frames of the hand at the start."""
    later: HandFrames
    """Frames at the end; every link moves steadily in between."""


class Loads(NamedTuple):
    """Loads on each of N objects, as wrenches about its centre along the world's axes: means over a step."""

    by_table: Float[np.ndarray, "N 6"]
    """[N, N.m]"""
    by_obstacles: Float[np.ndarray, "N 6"]
    by_bodies: Float[np.ndarray, "N N 6"]
    """On each object (first axis) by each other object."""
    by_hand: Float[np.ndarray, "N 6"]
    """By the hand, in the engine's own contact model."""

    @property
    def by_world(self) -> Float[np.ndarray, "N 6"]:
        """Return the loads by all bodies but the hand."""
        return self.by_table + self.by_obstacles + self.by_bodies.sum(1)


def summed_loads(
    owners: Int[np.ndarray, "m 2"],
    points: Float[np.ndarray, "m 3"],
    forces: Float[np.ndarray, "m 3"],
    centers: Float[AnyArray, "N 3"],
    couples: Float[np.ndarray, "m 3"] | None = None,
) -> Loads:
    """Sum contact forces, and couples with them, into loads on the objects.

    Args:
        owners: index of the object that each force acts on, and of the body that exerts it: an object, which gets the
            opposite force, or HAND, TABLE or OBSTACLES.
        points: points of application [m].
        forces: forces on the first body of each pair [N].
        centers: centres of the objects [m].
        couples: couples on the first body of each pair, where fingers are soft [N.m].
    """
    count = len(centers)
    couples = np.zeros(forces.shape) if couples is None else couples
    total = np.zeros((count, count + 3, 6))
    for sign, (acted_on, source) in ((1.0, owners.T), (-1.0, owners.T[::-1])):
        index = np.flatnonzero(acted_on >= 0)
        pushes = sign * forces[index]
        # (p - c) x f + m
        torques = np.cross(points[index] - centers[acted_on[index]], pushes) + sign * couples[index]
        wrenches = np.concatenate([pushes, torques], 1)
        # Hand, table and obstacles have columns after those of the objects.
        np.add.at(
            total, (acted_on[index], np.where(source[index] < 0, count - 1 - source[index], source[index])), wrenches
        )
    by = {code: total[:, count - 1 - code] for code in (HAND, TABLE, OBSTACLES)}
    return Loads(by[TABLE], by[OBSTACLES], total[:, :count], by[HAND])


class Step(NamedTuple):
    """Result of an engine for one step in time."""

    state: WorldState
    """State after the step."""
    loads: Loads
    gained: Float[np.ndarray, "N 6"]
    """Rate of momentum, linear and angular, of each object [N, N.m]."""
    solved: bool
    """True if the engine solved its own equations to its tolerance."""

    def left_to_hand(self, weights: Float[np.ndarray, "N 6"]) -> Float[np.ndarray, "N 6"]:
        """Return the wrench that the hand must have exerted on each object, given the wrenches that balance their
        weights [N, N.m]."""
        return weights + self.gained - self.loads.by_world


AT_REST = 0.01
"""Length of the step at rest that shows the loads on the hand at the start [s]."""


@runtime_checkable
class Engine(Protocol):
    """Integrator of the objects of one world, which its constructor takes."""

    def step(self, state: WorldState, hand: HandMove, dt: float) -> Step:
        """Move the world by one step.

        Args:
            state: state of all objects at the start.
            hand: motion of the hand in the step, and its contacts.
            dt: length of the step [s].
        """
        ...


def left_at_rest(
    engine: Engine, state: WorldState, contacts: Contacts, frames: HandFrames, weights: Float[np.ndarray, "N 6"]
) -> Float[np.ndarray, "N 6"]:
    """Compute the wrench that a resting hand must exert on each object, beside table and other bodies [N, N.m].

    Args:
        engine: engine of the world.
        state: state of its objects.
        contacts: contacts of the hand with them.
        frames: frames of the hand.
        weights: wrenches that balance the objects' weights.
    """
    return engine.step(state, HandMove(contacts, frames, frames), AT_REST).left_to_hand(weights)
