"""Worlds of a few objects for tests, with a hand far away or one that pushes."""

import jax
import jax.numpy as jnp
import numpy as np
from scipy.spatial.transform import Rotation

from jaxgrasp.grip import Body, Scene
from jaxgrasp.hand import Box, Hand, Link, Pose, Posture, parallel_jaw, pose_hand
from jaxgrasp.hand.shapes import Shape
from jaxgrasp.model.hand import padded
from jaxgrasp.world import HandMove, MujocoEngine, QuasiStaticEngine, RigidBody, World, WorldState, at_rest
from jaxgrasp.world.hand_share import find_touches

G = 9.81
BLOCK = Box(0.06, 0.05, 0.04)
ENGINES = {"quasi-static": QuasiStaticEngine, "mujoco": MujocoEngine}
GROUND = Pose(np.zeros(3), np.eye(3))


def world_with(
    shapes: list[Shape],
    centers: np.ndarray,
    masses: list[float],
    *,
    rubbing: float = 0.5,
    gravity: tuple[float, ...] = (0.0, 0.0, -G),
    turns: np.ndarray | None = None,
    hand: Hand | None = None,
    frame: np.ndarray | None = None,
    stiffness: float = 2000.0,
    skin: float = 0.8,
    **scene: object,
) -> tuple[World, WorldState]:
    """Return objects on a table in a turned frame; without a hand given, the hand is far away."""
    frame = np.eye(3) if frame is None else frame
    hand = parallel_jaw() if hand is None else hand
    rigid_bodies = [RigidBody(Body(s, m), skin, stiffness, rubbing) for s, m in zip(shapes, masses, strict=True)]
    made = Scene(
        hand,
        rigid_bodies[0].body,
        Pose(np.zeros(3), frame),
        skin,
        stiffness,
        np.ones(len(hand.links)),
        frame @ np.array(gravity),
        table_friction=rubbing,
        **scene,
    )
    turn_matrices = np.broadcast_to(np.eye(3), (len(shapes), 3, 3)) if turns is None else turns
    placed = Pose(np.array(centers, float) @ frame.T, frame @ turn_matrices)
    return World(made, tuple(rigid_bodies[1:])), at_rest(placed)


def tower(masses: list[float], overhang: float = 0.0, **kwargs: object) -> tuple[World, WorldState]:
    """Return blocks on one another; those from the second on stand out by a share of the first one's length."""
    out = [0.0 if k == 0 else overhang * BLOCK.length for k in range(len(masses))]
    centers = [[x, 0.0, BLOCK.height * (k + 0.5)] for k, x in enumerate(out)]
    return world_with([BLOCK] * len(masses), np.array(centers), masses, **kwargs)


def left_alone(world: World, engine: object, state: WorldState, seconds: float, dt: float = 0.01) -> list:
    """Return the steps of a world whose hand is far away."""
    hand = world.scene.hand
    posture = Posture(Pose(jnp.full(3, 9.0), jnp.eye(3)), jnp.zeros(len(hand.joints)))
    frames = jax.device_get(pose_hand(hand, posture))
    move = HandMove(jax.device_get(find_touches(world, posture, state.placed).contacts), frames, frames)
    steps = []
    for _ in range(round(seconds / dt)):
        steps.append(engine.step(state, move, dt))
        state = steps[-1].state
    return steps


def pusher(radius: float = 0.008) -> Hand:
    """Return a ball that slides along x."""
    return Hand(
        origins=jnp.zeros((1, 3)),
        rests=jnp.eye(3)[None],
        axes=jnp.array([[1.0, 0.0, 0.0]]),
        lower=jnp.array([-1.0]),
        upper=jnp.array([1.0]),
        skin=padded([(np.zeros((1, 3)), np.array([radius]))]),
        parents=(-1,),
        joints=("way",),
        links=(Link("index", "distal", 0),),
        sliding=("way",),
    )


def some_turn(seed: int) -> np.ndarray:
    return Rotation.random(random_state=seed).as_matrix()
