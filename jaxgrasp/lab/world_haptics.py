"""Computing side of the haptic loop in a world of many objects: an engine moves them, the hand feels them all."""

from dataclasses import dataclass
from functools import cache, partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from jaxgrasp.glove.model import GloveModel
from jaxgrasp.grip.monitor import Hold, Law
from jaxgrasp.grip.obstacles import felt_surfaces, surface_torques
from jaxgrasp.grip.scene import check_scene
from jaxgrasp.hand.detection import Contacts
from jaxgrasp.hand.kinematics import pose_hand
from jaxgrasp.lab.glove_hand import GloveHand, glove_hand, touching_hand
from jaxgrasp.lab.haptic_loop import Followed, HandHaptics, TickAnswer
from jaxgrasp.lab.haptic_tick import FlatProgram, Leaves
from jaxgrasp.model.arrays import AnyArray, Float
from jaxgrasp.model.hand import HandFrames, Link, Pose
from jaxgrasp.world.hand_share import (
    HandShare,
    closest_share,
    joined_contacts,
    pressing_torques,
    share_at,
    surface_groups,
    touches_of,
)
from jaxgrasp.world.many_bodies import Engine, HandMove, World, WorldState, holding_weights, left_at_rest
from jaxgrasp.world.quasi_static import QuasiStaticEngine


class _TickState(NamedTuple):
    """State carried from one tick to the next."""

    state: WorldState
    frames: HandFrames
    contacts: Contacts
    wrench: Float[np.ndarray, "N 6"]
    """Filtered wrench of the hand on each object [N, N.m]."""


@dataclass
class WorldHaptics(HandHaptics):
    """A hand in a glove among several objects, driven by ``tick``; the first tick compiles for 6 to 20 s.

    The engine computes the motion of the objects and thus the wrench of the hand on each: rate of momentum less weight
    and loads by table, obstacles and other objects. The force law distributes it over the current contacts.
    """

    world: World
    model: GloveModel
    fixed_angles: Float[AnyArray, "J"]
    """Angles of all joints [rad]; joints that the glove does not read keep them."""
    state: WorldState
    """State of the objects, at the start and then at the last tick."""
    engine: Engine
    law: Law = "closed-form"
    """Force law of the hand on each object, for the torques."""
    smoothing: float = 0.02
    """Time constant of the filter of wrenches [s]: they contain accelerations, which are differences of the glove's
    readings. 0 for no filter."""

    def __post_init__(self) -> None:
        check_scene(self.world.scene)
        self._glove = glove_hand(self.world.scene.hand, self.model, self.fixed_angles)
        leaves, structure = jax.tree.flatten((self.world, self._glove))
        self._leaves = tuple(map(jnp.asarray, leaves))
        self._programs = _compiled(structure, self.law)
        self._weights = holding_weights(self.world)
        self._tick_state: _TickState | None = None
        self._share: Leaves | None = None

    @property
    def glove(self) -> GloveHand:
        return self._glove

    @property
    def share(self) -> HandShare | None:
        """Return the forces of the hand at the last tick."""
        return None if self._share is None else self._programs.feel.tree(1, self._share)

    @property
    def links(self) -> tuple[Link, ...]:
        return self.world.scene.hand.links

    def contact_forces(self) -> tuple[Float[np.ndarray, "C 3"], Float[np.ndarray, "C 3"]]:
        share = self.share
        if share is None:
            nothing = np.zeros((len(self.links) * len(self.world.bodies), 3))
            return nothing, nothing
        forces, normals = jax.device_get((share.exerted, share.touches.contacts.normals))
        return np.asarray(forces, float).reshape(-1, 3), np.asarray(normals, float).reshape(-1, 3)

    @property
    def followed(self) -> Followed:
        wrench = self._weights if self._tick_state is None else self._tick_state.wrench
        return Followed(self.state.placed, wrench, np.asarray(self.world.scene.contributions), self.state.time)

    def compute_torques(
        self, dt: float, smoothing: float, angles: Float[np.ndarray, "channels"], wrist: Pose
    ) -> TickAnswer:
        before = self._tick_state
        if before is not None and dt <= 0:
            state, frames, _, wrench = before
            return self._answer(angles, wrist, state, frames, wrench)
        frames = self._frames(angles, wrist)
        if before is None:
            state, contacts = self.state, self._feel(angles, wrist, self.state, self._weights)[2]
            wrench = left_at_rest(self.engine, state, contacts, frames, self._weights)
        else:
            step = self.engine.step(before.state, HandMove(before.contacts, before.frames, frames), dt)
            state, wrench = step.state, smoothing * before.wrench + (1 - smoothing) * step.left_to_hand(self._weights)
        return self._answer(angles, wrist, state, frames, wrench)

    def _answer(
        self,
        angles: Float[np.ndarray, "channels"],
        wrist: Pose,
        state: WorldState,
        frames: HandFrames,
        wrench: np.ndarray,
    ) -> TickAnswer:
        torques, slope, contacts, share = self._feel(angles, wrist, state, wrench)

        def commit() -> None:
            self.state, self._share = state, share
            self._tick_state = _TickState(state, frames, contacts, wrench)

        return TickAnswer(torques, slope, commit)

    def _frames(self, angles: Float[np.ndarray, "channels"], wrist: Pose) -> HandFrames:
        """Compute the frames of the hand."""
        pose = self._programs.pose
        (leaves,) = pose(self._leaves, angles, (wrist.origin, wrist.rotation))
        return pose.tree(0, jax.device_get(leaves))

    def _feel(
        self, angles: Float[np.ndarray, "channels"], wrist: Pose, state: WorldState, wrench: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, Contacts, Leaves]:
        """Compute the torques and their slope, the contacts of the hand, and the leaves of its forces."""
        feel = self._programs.feel
        placed = state.placed.origin, state.placed.rotation
        rendered, share, contacts = feel(
            self._leaves, angles, (wrist.origin, wrist.rotation), placed, state.time, wrench
        )
        (torques, slope), contacts = jax.device_get((rendered, contacts))
        return torques, slope, feel.tree(2, contacts), share

    def warm_up(self, wrist: Pose) -> None:
        super().warm_up(wrist)
        if isinstance(self.engine, QuasiStaticEngine):
            self.engine.warm_up()


class _Programs(NamedTuple):
    pose: FlatProgram
    feel: FlatProgram


@cache
def _compiled(structure: Any, law: Law) -> _Programs:
    """Compile the programs for worlds of this structure: frames of the hand, and torques."""
    return _Programs(
        FlatProgram(partial(_pose, structure=structure)), FlatProgram(partial(_feel, structure=structure, law=law))
    )


def _pose(leaves: Leaves, angles: Array, wrist: tuple[Array, Array], *, structure: Any) -> tuple[HandFrames]:
    world, glove = jax.tree.unflatten(structure, leaves)
    return (pose_hand(world.scene.hand, glove.posture(angles, Pose(*wrist))),)


def _feel(
    leaves: Leaves,
    angles: Array,
    wrist: tuple[Array, Array],
    object_pose: tuple[Array, Array],
    time: Array,
    wrench: Array,
    *,
    structure: Any,
    law: Law,
) -> tuple[tuple[Array, Array], HandShare, Contacts]:
    """Compute torques against flexion, their slope, and the forces of the hand, with all objects at their poses.

    Where no allowed forces hold an object, by the optimum the closest forces act, with the slope of fixed forces.
    """
    world, glove = jax.tree.unflatten(structure, leaves)
    world, wrist_pose, placed = world.at_time(time), Pose(*wrist), Pose(*object_pose)

    hand = world.scene.hand
    frames = pose_hand(hand, glove.posture(angles, wrist_pose))
    groups = surface_groups(world, placed)
    surfaces = [(group.shape, group.placed) for group in groups]
    touching = touching_hand(hand, frames, surfaces + felt_surfaces(world.scene))

    def torques_of(frames: HandFrames, contacts: list[Contacts]) -> tuple[Array, HandShare]:
        touches = touches_of(world, placed, joined_contacts(groups, contacts[: len(groups)]))
        blocked = surface_torques(world.scene, frames, contacts[len(groups) :])
        share = share_at(world, frames, placed, touches, blocked, wrench, law=law)
        return share.torques, share

    torques, slope, share = touching.torques_and_slope(glove, torques_of)
    if law == "closed-form":
        return (torques, slope), share, share.touches.contacts

    def closest() -> tuple[Array, Array, HandShare]:
        nearest = closest_share(world, glove.posture(angles, wrist_pose), placed, share)

        def torques_of(frames: HandFrames, contacts: list[Contacts]) -> tuple[Array, None]:
            torques = pressing_torques(world, frames, share.touches, nearest.by_hand)
            return torques + surface_torques(world.scene, frames, contacts[len(groups) :]), None

        return *touching.torques_and_slope(glove, torques_of)[:2], nearest

    slips = jnp.any(share.assessment.hold == Hold.SLIPPING)
    torques, slope, share = lax.cond(slips, closest, lambda: (torques, slope, share))
    return (torques, slope), share, share.touches.contacts
