"""A hand among the objects of a world over time, as [`jaxgrasp.grip.carry`][] has it for one object."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxgrasp.grip.carry import Instant, check_instants
from jaxgrasp.grip.monitor import Hold, Law
from jaxgrasp.grip.tick import Tick
from jaxgrasp.hand.kinematics import pose_hand
from jaxgrasp.model.arrays import Float
from jaxgrasp.model.hand import Pose, Posture
from jaxgrasp.validation.checked import checked
from jaxgrasp.world.hand_share import HandShare, hand_share, touched_things
from jaxgrasp.world.many_bodies import World, WorldState, holding_weights
from jaxgrasp.world.physics import Engine, HandMove, Loads


class WorldInstant(NamedTuple):
    """An instant of a world that goes on."""

    state: WorldState
    """Where the N objects were, and how they moved."""
    share: HandShare
    """What the hand exerts on each, and what its joints feel of it."""
    loads: Loads
    """What acted on each until the next instant, by the engine."""
    gained: Float[np.ndarray, "N 6"]
    """Rate of each object's momentum until then [N, N.m]."""
    solved: bool
    """Whether the engine solved its own equations as closely as it means to."""

    @property
    def gripped(self) -> Instant:
        """The first object's, as [`jaxgrasp.grip.carry`][] says it; its torques are those of all objects."""
        share, by_world = self.share, jnp.asarray(self.loads.by_world[0])
        touches, assessment = jax.tree.map(lambda part: part[0], (share.touches, share.assessment))
        tick = Tick(
            contacts=touches.contacts,
            grasp=touches.grasp,
            stiffness=touches.stiffness,
            wrench=share.wrench[0] + by_world,
            inertial=jnp.asarray(self.gained[0]),
            assessment=assessment,
            support=by_world,
            rests=jnp.asarray(False),
            exerted=share.exerted[0],
            moments=None if share.moments is None else share.moments[0],
            torques=share.torques,
            blocked=share.blocked,
        )
        placed = Pose(self.state.placed.origin[0], self.state.placed.rotation[0])
        stands = bool(np.any(self.loads.by_world[0]))
        return Instant(placed, tick, Hold(int(assessment.hold)), stands, tick.exerted, share.missed[0], tick.moments)


@checked
def world_carry(
    world: World, engine: Engine, postures: Posture, state: WorldState, dt: float, *, law: Law = "closed-form"
) -> list[WorldInstant]:
    """What becomes of the objects of a world while a hand goes through postures.

    The engine says how everything moves and what table, obstacles and other objects exert on each object; what is left
    for the hand, its motion's wrench less its weight and these, the package's own law spreads over its own contacts.

    Args:
        world: hand, objects, table, guide, obstacles.
        engine: of that world, such as a [`jaxgrasp.world.QuasiStaticEngine`][].
        postures: with a leading axis T of instants; the hand is at rest after the last.
        state: of the objects at first.
        dt: time from one instant to the next [s].
        law: which forces the hand applies, as for [`jaxgrasp.grip.monitor`][].

    Returns:
        A WorldInstant for each posture.

    Raises:
        ValueError: for postures without that axis, a step of time that is not positive, and as
            [`jaxgrasp.grip.carry`][] does.
    """
    check_instants(world.scene, postures, dt)
    frames = jax.device_get(pose_hand(world.scene.hand, postures))
    count = frames.axes.shape[0]
    weights = holding_weights(world)
    instants = []
    for k in range(count):
        now, later = (jax.tree.map(lambda x, i=i: x[i], frames) for i in (k, min(k + 1, count - 1)))
        posture = jax.tree.map(lambda x, k=k: x[k], postures)
        touches = touched_things(world, posture, state.placed)
        step = engine.step(state, HandMove(jax.device_get(touches.contacts), now, later), dt)
        wrench = step.left_to_hand(weights)
        share = hand_share(world.at_time(state.time), posture, state.placed, touches, wrench, law=law)
        instants.append(WorldInstant(state, share, step.loads, step.gained, step.solved))
        state = step.state
    return instants
