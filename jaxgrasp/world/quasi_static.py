"""Quasi-static engine: the contact engine of held objects (``grip/contact_step.py``) for all objects of a world at
once, which meet hand, table, obstacles and each other.

Contacts do not bounce; those of the hand and of obstacles are springs, those among objects and with the table are
rigid. Contacts are those of convex hulls at the beginning of a step, each corner with its own gap; a body that moves by
more than its own size in a step passes through another.
"""

from functools import cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxgrasp.grip.contact_step import RIGID, ContactLaw, solve_law
from jaxgrasp.grip.motion import Motion, moved
from jaxgrasp.grip.scene import Obstacle, obstacles_at_time
from jaxgrasp.model.arrays import Float
from jaxgrasp.model.hand import Pose
from jaxgrasp.numerics.compiled_code import COMPILED_FOR_TICKS, jit_here, padded_size
from jaxgrasp.world.contact_list import (
    SIZES,
    ContactJacobian,
    ContactList,
    hand_contact_list,
    jacobian,
    loads_of,
    mobilities_of,
    mobility_roots,
    together,
    world_contact_list,
)
from jaxgrasp.world.many_bodies import (
    HandMove,
    Motions,
    Step,
    World,
    WorldState,
    integrate_poses,
    link_motion,
    masses,
)
from jaxgrasp.world.solids import MAX_POINTS, solid_of

AHEAD = 2e-3
"""Largest gap of solids that count as meeting in a step, beyond their travel in it [m]."""
PUSHED_OUT = 0.2
"""Share of the penetration of rigid solids that is corrected in a step."""
PUSHED_OUT_FULLY = 1e-6
"""Penetration that is corrected in one step [m]: objects at rest do not creep into one another."""
MAX_TURNS, TURNED = 20, 1e-12
"""Largest number of iterations for the rotation of a free body, and the change of its angle that ends them [rad]."""
ROUNDING = 1e-3
"""Share of the whole mass below which an object's motion is not solved more exactly: rounding hides it."""


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
        origin = Pose(np.zeros(3), np.eye(3))
        self._extents = np.array([solid_of(member.body.shape, origin).extent() for member in world.bodies])
        world_contact_list(world, state.placed, 0.0)

    def step(self, state: WorldState, hand: HandMove, dt: float) -> Step:
        """Move the world by one step; see [`jaxgrasp.world.Engine`][]."""
        world, placed = self.world, state.placed
        links, motion = link_motion(hand.current, hand.later, dt)
        linear, angular = (np.linalg.norm(speeds, axis=1) for speeds in state.motion)
        top_speed = (linear + self._extents * angular).max() + dt * np.linalg.norm(world.scene.gravity)
        obstacles = obstacles_at_time(world.scene, state.time)
        top_speed += max(map(_speed, obstacles), default=0.0)
        contacts = together(
            world_contact_list(world, placed, AHEAD + 2 * top_speed * dt, obstacles),
            hand_contact_list(world, hand.contacts, links, motion),
        )
        mobilities = mobilities_of(world, self._masses, placed)
        free_motion = self._free_motion(state, mobilities, dt)
        contact_jacobian = jacobian(contacts, placed.origin)
        forces, solved = self._solve(contacts, contact_jacobian, mobilities, free_motion, state.motion, dt)
        on_bodies = np.einsum("minj,mi->nj", contact_jacobian.rows, forces)
        velocity = free_motion + dt * np.einsum("nij,nj->ni", mobilities, on_bodies)
        motion_after = Motions(velocity[:, :3], velocity[:, 3:])
        after = WorldState(self._moved(placed, motion_after, dt), motion_after, state.time + dt)
        gained = (self._masses.momentum(after) - self._masses.momentum(state)) / dt
        loads = loads_of(contacts, contact_jacobian, placed, forces)
        return Step(after, loads, gained, solved)

    def warm_up(self) -> None:
        """Compile all programs that a step may need, before its first call."""
        world = self.world
        n_bodies, n_links, n_obstacles = len(world.bodies), len(world.scene.hand.links), len(world.scene.obstacles)
        n_manifolds = n_bodies * (n_bodies - 1) // 2 + n_bodies * (1 + n_obstacles)
        largest = padded_size(n_bodies * n_links + (MAX_POINTS + 1) * n_manifolds, SIZES)
        for size in sorted({size for size in (*SIZES, largest) if size <= largest}):
            no_rows = np.zeros((size, 4, 6 * n_bodies))
            _program()(no_rows, no_rows[..., 0], np.zeros((3, size)), np.ones(3), no_rows[0, 0])

    def _solve(
        self,
        contacts: ContactList,
        contact_jacobian: ContactJacobian,
        mobilities: Float[np.ndarray, "N 6 6"],
        free_motion: Float[np.ndarray, "N 6"],
        guess: Motions,
        dt: float,
    ) -> tuple[Float[np.ndarray, "m d"], bool]:
        """Solve for the forces of the contacts in a step.

        Args:
            contacts: contacts of the objects.
            contact_jacobian: Jacobian of these contacts.
            mobilities: velocity by impulse of each object, M^-1.
            free_motion: velocities at the end of the step without contacts.
            guess: velocities from which the search starts.
            dt: length of the step [s].

        Returns:
            The forces in the rows of the Jacobian [N], and True if the contacts' law is satisfied to its tolerance.
        """
        count, d, n, _ = contact_jacobian.rows.shape
        springs = np.isfinite(contacts.stiffness)
        relative = _relative_velocity(contacts, contact_jacobian, free_motion, springs, dt)
        if np.all(relative[:, 0] >= 0):
            return np.zeros((count, d)), True
        mass = self._masses.mass.sum()
        rigid = RIGID * mass / dt
        normal_resistance = np.where(springs, contacts.stiffness * dt, rigid)
        # Motions are v = v_free + B y, B B^T = M^-1, in whose coordinates y the inertia is the unit matrix.
        roots = mobility_roots(mobilities)
        coordinates = np.linalg.pinv(roots)
        start = np.einsum("nij,nj->ni", coordinates, np.concatenate(guess, 1) - free_motion)
        free_coordinates = np.einsum("nij,nj->ni", coordinates, free_motion)
        size = padded_size(count, SIZES)
        law_rows, law_start, columns = np.zeros((size, 4, 6 * n)), np.zeros((size, 4)), np.zeros((3, size))
        law_rows[:count, :d] = contact_jacobian.in_units_of(roots)
        law_start[:count, :d] = relative
        columns[:, :count] = contacts.friction, normal_resistance, np.full(count, rigid)
        # The motion of the lightest object is as exact as that of the heaviest.
        energy = (np.sum(free_coordinates**2) + dt * dt * mass) * max(self._masses.mass.min() / mass, ROUNDING)
        scalars = np.array([dt, mass / dt, energy])
        forces, solved = jax.device_get(_program()(law_rows, law_start, columns, scalars, start.ravel()))
        return forces[:count, :d], bool(solved)

    def _free_motion(self, state: WorldState, mobilities: np.ndarray, dt: float) -> Float[np.ndarray, "N 6"]:
        """Compute the velocities after a step without contacts: v = M^-1 (p + m g dt), with M at the pose to which they
        lead. So angular momentum is exact, and tumbling gains no energy."""
        inertias = self._masses
        momentum = inertias.momentum(state)
        momentum[:, :3] += dt * inertias.mass[:, None] * np.asarray(self.world.scene.gravity)
        linear, angular = momentum[:, :3] / inertias.mass[:, None], state.motion.angular
        for _ in range(MAX_TURNS):
            rotations = integrate_poses(state.placed, Motions(linear, angular), dt).rotation
            before = angular
            angular = np.linalg.solve(inertias.world_inertia(rotations), momentum[:, 3:, None])[..., 0]
            if np.abs(angular - before).max() * dt < TURNED:
                break
        velocities = np.concatenate([linear, angular], 1)
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


def _relative_velocity(
    contacts: ContactList, contact_jacobian: ContactJacobian, free_motion: np.ndarray, springs: np.ndarray, dt: float
) -> Float[np.ndarray, "m d"]:
    """Compute the relative velocities without contact forces, less those at which the contacts exert none."""
    relative = np.einsum("minj,nj->mi", contact_jacobian.rows, free_motion)
    relative -= contact_jacobian.project(contacts.carried, contacts.turning)
    # Springs push by their length at the end of the step, K (-gap - dt u) = - K dt (u + gap / dt). Rigid contacts close
    # their gap at most; deep penetration is corrected slowly.
    gaps = contacts.gaps
    rigid_gaps = np.where(gaps > 0, gaps, np.minimum(PUSHED_OUT * gaps, np.maximum(gaps, -PUSHED_OUT_FULLY)))
    relative[:, 0] += np.where(springs, contacts.gaps, rigid_gaps) / dt
    return relative


@cache
def _program() -> Any:
    return jit_here(_solve_contacts, COMPILED_FOR_TICKS)


def _solve_contacts(rows: Array, start: Array, columns: Array, scalars: Array, guess: Array) -> tuple[Array, Array]:
    """Return the forces of contacts that exert none where the objects move with them, and whether they are solved.

    Args:
        rows: as in ``ContactLaw``.
        start: as in ``ContactLaw``.
        columns: friction, and the normal and tangential resistance of each contact ``(3, m)``.
        scalars: length of the step, mass in a step and energy, as in ``ContactLaw``.
        guess: motion from which the search starts.
    """
    friction, normal_resistance, tangential_resistance = columns
    dt, mass_in_step, energy = scalars
    no_forces = jnp.zeros_like(start)
    law = ContactLaw(
        rows=rows,
        start=start,
        at_reference=no_forces,
        friction=friction,
        floor=no_forces[:, 0],
        normal_resistance=normal_resistance,
        tangential_resistance=tangential_resistance,
        mass=jnp.eye(rows.shape[-1]),
        dt=dt,
        mass_in_step=mass_in_step,
        energy=energy,
    )
    step = solve_law(law, guess)
    return step.forces, step.solved
