"""Quasi-static engine: one cone program a step, over all contacts of all objects with hand, table and each other.

It is made for objects that rest, are held, or move slowly. Contacts do not bounce; those of the hand and of obstacles
are springs, those among objects and with the table are rigid; a sliding body hovers by its friction times its travel in
a step. Contacts are those of convex hulls at the beginning of a step, so that a body that moves by more than its own
size in a step passes through another.
"""

import jax
import jax.numpy as jnp
import numpy as np

from jaxgrasp.grip.motion import Motion, moved
from jaxgrasp.grip.scene import Obstacle, obstacles_at_time
from jaxgrasp.model.arrays import Float
from jaxgrasp.model.hand import Pose
from jaxgrasp.world.impulse_program import (
    ContactList,
    ContactRows,
    Impulses,
    compile_programs,
    hand_contact_list,
    jacobian,
    least_constraint,
    loads_of,
    mobilities_of,
    together,
    world_contact_list,
)
from jaxgrasp.world.many_bodies import HandMove, Motions, Step, World, WorldState, integrate_poses, link_motion, masses
from jaxgrasp.world.solids import MAX_POINTS, solid_of

AHEAD = 2e-3
"""Largest gap of solids that count as meeting in a step, beyond their travel in it [m]."""
SLACK = 1e-5
"""Depth of penetration that rigid solids keep, without correction [m]."""
PUSHED_OUT = 0.2
"""Share of the deeper penetration that is corrected in a step."""


class QuasiStaticEngine:
    """The package's own engine, without internal state and without any extra."""

    def __init__(self, world: World, state: WorldState):
        """Store the world, and check that its shapes are supported.

        Args:
            world: world to move.
            state: state of its objects at the start.

        Raises:
            ValueError: for shapes that are unbounded or not supported.
        """
        self.world = world
        self._masses = masses(world.bodies)
        world_contact_list(world, state.placed, 0.0)

    def step(self, state: WorldState, hand: HandMove, dt: float) -> Step:
        """Move the world by one step; see [`jaxgrasp.world.Engine`][]."""
        world, placed = self.world, state.placed
        links, motion = link_motion(hand.current, hand.later, dt)
        top_speed = np.linalg.norm(state.motion.linear, axis=1).max() + dt * np.linalg.norm(world.scene.gravity)
        obstacles = obstacles_at_time(world.scene, state.time)
        top_speed += max(map(_speed, obstacles), default=0.0)
        contacts = together(
            world_contact_list(world, placed, AHEAD + 2 * top_speed * dt, obstacles),
            hand_contact_list(world, hand.contacts, links, motion),
        )
        mobilities = mobilities_of(world, self._masses, placed)
        free_motion = self._free_motion(state, mobilities, dt)
        contact_rows = jacobian(contacts, placed.origin)
        impulses = _impulses(contacts, contact_rows, free_motion, mobilities, dt)
        velocity = free_motion + np.einsum("nij,nj->ni", mobilities, impulses.on_bodies)
        motion_after = Motions(velocity[:, :3], velocity[:, 3:])
        after = WorldState(self._moved(placed, motion_after, dt), motion_after, state.time + dt)
        gained = (self._masses.momentum(after) - self._masses.momentum(state)) / dt
        loads = loads_of(contacts, contact_rows, placed, impulses.along / dt)
        return Step(after, loads, gained, impulses.solved)

    def warm_up(self) -> None:
        """Compile all programs that a step may need, before its first call."""
        world = self.world
        n_bodies, n_links, n_obstacles = len(world.bodies), len(world.scene.hand.links), len(world.scene.obstacles)
        n_manifolds = n_bodies * (n_bodies - 1) // 2 + n_bodies * (1 + n_obstacles)
        compile_programs(n_bodies, n_bodies * n_links + MAX_POINTS * n_manifolds, world.is_soft)

    def _free_motion(self, state: WorldState, mobilities: np.ndarray, dt: float) -> Float[np.ndarray, "N 6"]:
        """Compute the velocities after a step without contacts: momentum plus gravity, v = M^-1 (p + m g dt)."""
        inertias = self._masses
        momentum = inertias.momentum(state)
        momentum[:, :3] += dt * inertias.mass[:, None] * np.asarray(self.world.scene.gravity)
        rotations = integrate_poses(state.placed, state.motion, dt).rotation
        velocities = np.concatenate(
            [
                momentum[:, :3] / inertias.mass[:, None],
                np.linalg.solve(inertias.world_inertia(rotations), momentum[:, 3:, None])[..., 0],
            ],
            1,
        )
        if self.world.scene.guide is not None:
            velocities[0] = mobilities[0] @ momentum[0]
        return velocities

    def _moved(self, placed: Pose, motion: Motions, dt: float) -> Pose:
        poses = integrate_poses(placed, motion, dt)
        guide = self.world.scene.guide
        if guide is not None:
            first = Motion(jnp.asarray(motion.linear[0]), jnp.asarray(motion.angular[0]))
            pose = jax.device_get(_moved_along_guide(Pose(placed.origin[0], placed.rotation[0]), first, dt, guide))
            poses.origin[0], poses.rotation[0] = pose.origin, pose.rotation
        return poses


_moved_along_guide = jax.jit(moved)


def _speed(obstacle: Obstacle) -> float:
    """Bound the speed of any part of an obstacle [m/s]."""
    if obstacle.motion is None:
        return 0.0
    turning = np.linalg.norm(obstacle.motion.angular) * solid_of(obstacle.shape, obstacle.placed).extent()
    return float(np.linalg.norm(obstacle.motion.linear) + turning)


def _impulses(
    contacts: ContactList, contact_rows: ContactRows, free_motion: np.ndarray, mobilities: np.ndarray, dt: float
) -> Impulses:
    # J v - v_carried, to which gap / dt is added along the normal
    approach = np.einsum("minj,nj->mi", contact_rows.rows, free_motion) - contact_rows.project(
        contacts.carried, contacts.turning
    )
    spring = np.isfinite(contacts.stiffness)
    # Springs push by their length at the end of the step. Rigid contacts close their gap at most; penetration is
    # corrected slowly.
    rigid = np.where(contacts.gaps > 0, contacts.gaps, PUSHED_OUT * np.minimum(contacts.gaps + SLACK, 0))
    approach[:, 0] += np.where(spring, contacts.gaps, rigid) / dt
    # R = 1 / (K dt^2)
    compliance = np.where(spring, 1 / (contacts.stiffness * dt**2), 0)
    return least_constraint(contact_rows.rows, contacts.friction, mobilities, approach, compliance)
