"""Simulation of a hand among the objects of a world over time, as [`jaxgrasp.grip.simulate`][] does for one object."""

from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxgrasp.grip.monitor import Hold, Law
from jaxgrasp.grip.simulation import Record, check_instants
from jaxgrasp.grip.tick import StepResult
from jaxgrasp.hand.kinematics import pose_hand
from jaxgrasp.model.arrays import Float
from jaxgrasp.model.hand import Pose, Posture
from jaxgrasp.validation.checked import checked
from jaxgrasp.world.hand_share import HandShare, find_touches, hand_share
from jaxgrasp.world.many_bodies import Engine, HandMove, Loads, World, WorldState, holding_weights
from jaxgrasp.world.mujoco_engine import MujocoEngine
from jaxgrasp.world.quasi_static import QuasiStaticEngine

EngineName = Literal["quasi-static", "mujoco"]


class WorldRecord(NamedTuple):
    """State of a simulated world at one instant, with forces and loads."""

    state: WorldState
    """Poses and velocities of the N objects."""
    share: HandShare
    """Forces of the hand on each object, and the joint torques from them."""
    loads: Loads
    """Loads on each object until the next instant, by the engine."""
    gained: Float[np.ndarray, "N 6"]
    """Rate of each object's momentum until the next instant [N, N.m]."""
    solved: bool
    """True if the engine solved its own equations to its tolerance."""

    @property
    def gripped(self) -> Record:
        """Return the record of the gripped object, as from [`jaxgrasp.grip.simulate`][]; its torques are those from all
        objects."""
        share, by_world = self.share, jnp.asarray(self.loads.by_world[0])
        touches, assessment = jax.tree.map(lambda part: part[0], (share.touches, share.assessment))
        tick = StepResult(
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
            table_points=jnp.zeros((0, 3)),
            table_pressed=jnp.zeros(0),
        )
        placed = Pose(self.state.placed.origin[0], self.state.placed.rotation[0])
        is_supported = bool(np.any(self.loads.by_world[0]))
        return Record(
            placed, tick, Hold(int(assessment.hold)), is_supported, tick.exerted, share.wrench_residual[0], tick.moments
        )


@checked
def simulate_world(
    world: World, engine: Engine, postures: Posture, state: WorldState, dt: float, *, law: Law = "closed-form"
) -> list[WorldRecord]:
    """Simulate the objects of a world while a hand goes through postures.

    The engine computes all motions and the loads by table, obstacles and other objects. The remaining wrench of each
    object, rate of momentum less weight and these loads, is the hand's: the package's own force law distributes it over
    its contacts.

    Args:
        world: hand, objects, table, guide, obstacles.
        engine: engine of that world, such as a [`jaxgrasp.world.QuasiStaticEngine`][].
        postures: postures with a leading axis T of instants; the hand is at rest after the last.
        state: state of the objects at the start.
        dt: time from one instant to the next [s].
        law: force law of the hand, as for [`jaxgrasp.grip.monitor`][].

    Returns:
        A WorldRecord for each posture.

    Raises:
        ValueError: for postures without that axis, a step of time that is not positive, and as
            [`jaxgrasp.grip.simulate`][] does.
    """
    check_instants(world.scene, postures, dt)
    frames = jax.device_get(pose_hand(world.scene.hand, postures))
    count = frames.axes.shape[0]
    weights = holding_weights(world)
    records = []
    for k in range(count):
        current, later = (jax.tree.map(lambda x, i=i: x[i], frames) for i in (k, min(k + 1, count - 1)))
        posture = jax.tree.map(lambda x, k=k: x[k], postures)
        touches = find_touches(world, posture, state.placed)
        step = engine.step(state, HandMove(jax.device_get(touches.contacts), current, later), dt)
        wrench = step.left_to_hand(weights)
        share = hand_share(world.at_time(state.time), posture, state.placed, touches, wrench, law=law)
        records.append(WorldRecord(state, share, step.loads, step.gained, step.solved))
        state = step.state
    return records


def engine_of(name: EngineName, world: World, state: WorldState) -> Engine:
    """Build the engine of that name for a world and the state of its objects at the start.

    Raises:
        ImportError: for MuJoCo's engine if MuJoCo is not installed.
        ValueError: for shapes or a guide that the engine does not support.
    """
    return MujocoEngine(world, state) if name == "mujoco" else QuasiStaticEngine(world, state)
