"""The computing side of the haptic loop in a world of many objects: an engine moves them, the hand feels them all."""

from dataclasses import dataclass
from functools import cache
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
from jaxgrasp.lab.glove_hand import GloveHand, glove_hand, with_slope
from jaxgrasp.lab.haptic_loop import Followed, HandHaptics, TickAnswer
from jaxgrasp.model.arrays import AnyArray, Float
from jaxgrasp.model.hand import HandFrames, Pose
from jaxgrasp.numerics.compiled_code import compile_options
from jaxgrasp.world.hand_share import HandShare, closest_share, cut_share, pressing_torques, touched_things
from jaxgrasp.world.many_bodies import World, WorldState, holding_weights
from jaxgrasp.world.physics import Engine, HandMove
from jaxgrasp.world.quasi_static import QuasiStaticEngine

AT_REST = 0.01
"""How long a step at rest is, by which it is known what the hand bears at first [s]."""


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
        leaves, self._structure = jax.tree.flatten((self.world, self._worn))
        self._leaves = tuple(map(jnp.asarray, leaves))
        self._weights = holding_weights(self.world)
        self._instant: _Instant | None = None
        self.share: HandShare | None = None
        """What the hand exerted at the last tick."""

    @property
    def worn(self) -> GloveHand:
        return self._worn

    @property
    def followed(self) -> Followed:
        wrench = self._weights if self._instant is None else self._instant.wrench
        return Followed(self.state.placed, wrench, np.asarray(self.world.scene.contributions), self.state.time)

    def felt_after(self, passed: float, kept: float, angles: Float[np.ndarray, "channels"], wrist: Pose) -> TickAnswer:
        look, feel = _programs()
        given = jnp.asarray(wrist.origin), jnp.asarray(wrist.rotation)
        before = self._instant
        if before is None:
            frames, contacts = jax.device_get(
                look(self._leaves, angles, given, self.state.placed, structure=self._structure)
            )
            step = self.engine.step(self.state, HandMove(contacts, frames, frames), AT_REST)
            state, wrench = self.state, step.left_to_hand(self._weights)
        elif passed > 0:
            frames = jax.device_get(look(self._leaves, angles, given, None, structure=self._structure)[0])
            step = self.engine.step(before.state, HandMove(before.contacts, before.frames, frames), passed)
            state, wrench = step.state, kept * before.wrench + (1 - kept) * step.left_to_hand(self._weights)
        else:
            state, frames, _, wrench = before
        found = feel(
            self._leaves,
            angles,
            given,
            (state.placed, state.time),
            wrench,
            structure=self._structure,
            law=self.law,
        )
        torques, slope, share = found

        def keep() -> None:
            self.state, self.share = state, share
            self._instant = _Instant(state, frames, jax.device_get(share.touches.contacts), wrench)

        return TickAnswer(torques, slope, keep)

    def warm_up(self, wrist: Pose) -> None:
        super().warm_up(wrist)
        if isinstance(self.engine, QuasiStaticEngine):
            self.engine.warm_up()


@cache
def _programs() -> tuple[Any, Any]:
    """What the hand touches, and what it feels; made as fast as they can be, since a person waits for them."""
    options = compile_options()
    return (
        jax.jit(_look, static_argnames="structure", compiler_options=options),
        jax.jit(_feel, static_argnames=("structure", "law"), compiler_options=options),
    )


def _look(
    leaves: tuple[Array, ...], angles: Array, wrist: tuple[Array, Array], placed: Pose | None, *, structure: Any
) -> tuple[HandFrames, Contacts | None]:
    """The hand's frames and, where objects are given, what it touches of them."""
    world, worn = jax.tree.unflatten(structure, leaves)
    posture = worn.posture(angles, Pose(*wrist))
    contacts = None if placed is None else touched_things(world, posture, placed).contacts
    return pose_hand(world.scene.hand, posture), contacts


def _feel(
    leaves: tuple[Array, ...],
    angles: Array,
    wrist: tuple[Array, Array],
    there: tuple[Pose, Array],
    wrench: Array,
    *,
    structure: Any,
    law: Law,
) -> tuple[Array, Array, HandShare]:
    """Torques against flexion, their slope, and what the hand exerts, with all objects where they are.

    Where no allowed forces hold an object, by the optimum those count that come closest, as forces that stay.
    """
    world, worn = jax.tree.unflatten(structure, leaves)
    placed, time = there
    world, wrist_pose = world.at_time(time), Pose(*wrist)

    def both(angles: Array) -> tuple[Array, tuple[Array, HandShare]]:
        posture = worn.posture(angles, wrist_pose)
        share = cut_share(world, posture, placed, touched_things(world, posture, placed), wrench, law=law)
        torques = worn.resisting(share.torques)
        return torques, (torques, share)

    slope, (torques, share) = jax.jacfwd(both, has_aux=True)(angles)
    if law == "closed-form":
        return torques, slope, share

    def closest() -> tuple[Array, Array, HandShare]:
        found = closest_share(world, worn.posture(angles, wrist_pose), placed, share)

        def torques_at(angles: Array) -> Array:
            posture = worn.posture(angles, wrist_pose)
            pressed = pressing_torques(world, posture, share.touches, found.exerted)
            return worn.resisting(pressed + hand_torques(world.scene, posture))

        return *with_slope(torques_at, angles), found

    slips = jnp.any(share.assessment.hold == Hold.SLIPPING)
    return lax.cond(slips, closest, lambda: (torques, slope, share))
