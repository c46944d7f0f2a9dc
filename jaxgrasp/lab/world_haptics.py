"""The computing side of the haptic loop in a world of many objects: an engine moves them, the hand feels them all."""

from dataclasses import dataclass
from functools import cache, partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from jaxgrasp.glove.model import GloveModel
from jaxgrasp.grip.monitor import Hold, Law
from jaxgrasp.grip.obstacles import hand_torques
from jaxgrasp.grip.scene import check_scene
from jaxgrasp.hand.detection import Contacts
from jaxgrasp.hand.kinematics import pose_hand
from jaxgrasp.lab.flat_program import FlatProgram, Leaves
from jaxgrasp.lab.glove_hand import GloveHand, glove_hand, with_slope
from jaxgrasp.lab.haptic_loop import Followed, HandHaptics, TickAnswer
from jaxgrasp.model.arrays import AnyArray, Float
from jaxgrasp.model.hand import HandFrames, Pose
from jaxgrasp.world.hand_share import HandShare, closest_share, cut_share, find_touches, pressing_torques
from jaxgrasp.world.many_bodies import World, WorldState, holding_weights
from jaxgrasp.world.physics import Engine, HandMove, left_at_rest
from jaxgrasp.world.quasi_static import QuasiStaticEngine


class _Instant(NamedTuple):
    """What a tick leaves to the next."""

    state: WorldState
    frames: HandFrames
    contacts: Contacts
    wrench: Float[np.ndarray, "N 6"]
    """What the hand is to exert on each object, as it is felt [N, N.m]."""


@dataclass
class WorldHaptics(HandHaptics):
    """A hand in a glove among several objects, driven by ``tick``; the first compiles for half a minute or more.

    The engine says how the objects go and so what the hand must have exerted on each: its motion's wrench less its
    weight and what table, obstacles and other objects do. That, the law spreads over the contacts as they now are.
    """

    world: World
    model: GloveModel
    others: Float[AnyArray, "J"]
    """Angles of all joints [rad]; those that the glove does not read stay there."""
    state: WorldState
    """Where the objects are at first, then at the last tick."""
    engine: Engine
    law: Law = "closed-form"
    """Which forces the hand applies to each object: what is felt."""
    smoothing: float = 0.02
    """Time constant of the wrenches that are felt [s]: they hold accelerations, which are differences of what the glove
    reads. 0 for as they are."""

    def __post_init__(self) -> None:
        check_scene(self.world.scene)
        self._worn = glove_hand(self.world.scene.hand, self.model, self.others)
        leaves, structure = jax.tree.flatten((self.world, self._worn))
        self._leaves = tuple(map(jnp.asarray, leaves))
        self._programs = _compiled(structure, self.law)
        self._weights = holding_weights(self.world)
        self._instant: _Instant | None = None
        self._share: Leaves | None = None

    @property
    def worn(self) -> GloveHand:
        return self._worn

    @property
    def share(self) -> HandShare | None:
        """What the hand exerted at the last tick."""
        return None if self._share is None else self._programs.feel.tree(1, self._share)

    @property
    def followed(self) -> Followed:
        wrench = self._weights if self._instant is None else self._instant.wrench
        return Followed(self.state.placed, wrench, np.asarray(self.world.scene.contributions), self.state.time)

    def felt_after(self, passed: float, kept: float, angles: Float[np.ndarray, "channels"], wrist: Pose) -> TickAnswer:
        before = self._instant
        if before is not None and passed <= 0:
            state, frames, _, wrench = before
            return self._felt(angles, wrist, state, frames, wrench)
        frames = self._frames(angles, wrist)
        if before is None:
            state, contacts = self.state, self._feel(angles, wrist, self.state, self._weights)[2]
            wrench = left_at_rest(self.engine, state, contacts, frames, self._weights)
        else:
            step = self.engine.step(before.state, HandMove(before.contacts, before.frames, frames), passed)
            state, wrench = step.state, kept * before.wrench + (1 - kept) * step.left_to_hand(self._weights)
        return self._felt(angles, wrist, state, frames, wrench)

    def _felt(
        self,
        angles: Float[np.ndarray, "channels"],
        wrist: Pose,
        state: WorldState,
        frames: HandFrames,
        wrench: np.ndarray,
    ) -> TickAnswer:
        torques, slope, contacts, share = self._feel(angles, wrist, state, wrench)

        def keep() -> None:
            self.state, self._share = state, share
            self._instant = _Instant(state, frames, contacts, wrench)

        return TickAnswer(torques, slope, keep)

    def _frames(self, angles: Float[np.ndarray, "channels"], wrist: Pose) -> HandFrames:
        """The hand's frames."""
        pose = self._programs.pose
        (leaves,) = pose(self._leaves, angles, (wrist.origin, wrist.rotation))
        return pose.tree(0, jax.device_get(leaves))

    def _feel(
        self, angles: Float[np.ndarray, "channels"], wrist: Pose, state: WorldState, wrench: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, Contacts, Leaves]:
        """Torques and their slope, what the hand touches, and the leaves of what it exerts."""
        feel = self._programs.feel
        placed = state.placed.origin, state.placed.rotation
        rendered, share, touched = feel(
            self._leaves, angles, (wrist.origin, wrist.rotation), placed, state.time, wrench
        )
        (torques, slope), touched = jax.device_get((rendered, touched))
        return torques, slope, feel.tree(2, touched), share

    def warm_up(self, wrist: Pose) -> None:
        super().warm_up(wrist)
        if isinstance(self.engine, QuasiStaticEngine):
            self.engine.warm_up()


class _Programs(NamedTuple):
    pose: FlatProgram
    feel: FlatProgram


@cache
def _compiled(structure: Any, law: Law) -> _Programs:
    """Where the hand is, and what it feels, in worlds of this structure."""
    return _Programs(
        FlatProgram(partial(_pose, structure=structure)), FlatProgram(partial(_feel, structure=structure, law=law))
    )


def _pose(leaves: Leaves, angles: Array, wrist: tuple[Array, Array], *, structure: Any) -> tuple[HandFrames]:
    world, worn = jax.tree.unflatten(structure, leaves)
    return (pose_hand(world.scene.hand, worn.posture(angles, Pose(*wrist))),)


def _feel(
    leaves: Leaves,
    angles: Array,
    wrist: tuple[Array, Array],
    there: tuple[Array, Array],
    time: Array,
    wrench: Array,
    *,
    structure: Any,
    law: Law,
) -> tuple[tuple[Array, Array], HandShare, Contacts]:
    """Torques against flexion, their slope, and what the hand exerts, with all objects where they are.

    Where no allowed forces hold an object, by the optimum those count that come closest, as forces that stay.
    """
    world, worn = jax.tree.unflatten(structure, leaves)
    world, wrist_pose, placed = world.at_time(time), Pose(*wrist), Pose(*there)

    def both(angles: Array) -> tuple[Array, tuple[Array, HandShare]]:
        posture = worn.posture(angles, wrist_pose)
        share = cut_share(world, posture, placed, find_touches(world, posture, placed), wrench, law=law)
        torques = worn.resisting(share.torques)
        return torques, (torques, share)

    slope, (torques, share) = jax.jacfwd(both, has_aux=True)(angles)
    if law == "closed-form":
        return (torques, slope), share, share.touches.contacts

    def closest() -> tuple[Array, Array, HandShare]:
        found = closest_share(world, worn.posture(angles, wrist_pose), placed, share)

        def torques_at(angles: Array) -> Array:
            posture = worn.posture(angles, wrist_pose)
            pressed = pressing_torques(world, posture, share.touches, found.by_hand)
            return worn.resisting(pressed + hand_torques(world.scene, posture))

        return *with_slope(torques_at, angles), found

    slips = jnp.any(share.assessment.hold == Hold.SLIPPING)
    torques, slope, share = lax.cond(slips, closest, lambda: (torques, slope, share))
    return (torques, slope), share, share.touches.contacts
