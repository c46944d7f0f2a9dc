"""A world by our own engine: one cone program a step, over all contacts of all objects with hand, table and each other.

It is for what rests, is held, or moves slowly. Contacts bounce nothing; those of the hand and of obstacles are springs,
those among objects and with the table are rigid; what slides hovers by its friction times its way in a step. Of solids
the convex hull touches the others, and the places at which it does so are those at the beginning of a step, so that
what is faster than its own size in a step passes through another.
"""

import jax
import jax.numpy as jnp
import numpy as np

from jaxgrasp.grip.motion import Motion, moved
from jaxgrasp.grip.scene import Obstacle, obstacles_now
from jaxgrasp.model.arrays import Float
from jaxgrasp.model.hand import Pose
from jaxgrasp.world.contact_list import ContactList, hand_contact_list, together, world_contact_list
from jaxgrasp.world.impulse_program import (
    ContactRows,
    Impulses,
    compile_programs,
    jacobian,
    least_constraint,
    loads_of,
    mobilities_of,
)
from jaxgrasp.world.led_bodies import Motions, led, link_motion
from jaxgrasp.world.many_bodies import World, WorldState, masses
from jaxgrasp.world.physics import HandMove, Step
from jaxgrasp.world.solids import solid_of
from jaxgrasp.world.touching_solids import MANY

AHEAD = 2e-3
"""How far apart solids are that count as meeting in a step, besides their way in it [m]."""
SLACK = 1e-5
"""How deep rigid solids may be in one another before they are pushed out [m]."""
PUSHED_OUT = 0.2
"""What of it is undone in a step."""


class QuasiStaticEngine:
    """Our own answer to how a world goes on: without memory, and without any extra."""

    def __init__(self, world: World, state: WorldState):
        """Remember what stays the same.

        Args:
            world: what that is.
            state: where its objects are at first.

        Raises:
            ValueError: for shapes that no object has.
        """
        self.world = world
        self._masses = masses(world.things)
        world_contact_list(world, state.placed, 0.0)

    def step(self, state: WorldState, hand: HandMove, dt: float) -> Step:
        """The world a step later; see [`jaxgrasp.world.Engine`][]."""
        world, placed = self.world, state.placed
        links, motion = link_motion(hand.now, hand.later, dt)
        fast = np.linalg.norm(state.motion.linear, axis=1).max() + dt * np.linalg.norm(world.scene.gravity)
        obstacles = obstacles_now(world.scene, state.time)
        fast += max(map(_speed, obstacles), default=0.0)
        contacts = together(
            world_contact_list(world, placed, AHEAD + 2 * fast * dt, obstacles),
            hand_contact_list(world, hand.contacts, links, motion),
        )
        mobilities = mobilities_of(world, self._masses, placed)
        alone = self._alone(state, mobilities, dt)
        seen = jacobian(contacts, placed.origin)
        impulses = _impulses(contacts, seen, alone, mobilities, dt)
        velocity = alone + np.einsum("nij,nj->ni", mobilities, impulses.on_things)
        new = Motions(velocity[:, :3], velocity[:, 3:])
        after = WorldState(self._moved(placed, new, dt), new, state.time + dt)
        gained = (self._masses.momentum(after) - self._masses.momentum(state)) / dt
        loads = loads_of(contacts, seen, placed, impulses.along / dt)
        return Step(after, loads, gained, impulses.solved)

    def warm_up(self) -> None:
        """Compile whatever a step may need, which otherwise is done when it first does."""
        world = self.world
        things, links, obstacles = len(world.things), len(world.scene.hand.links), len(world.scene.obstacles)
        patches = things * (things - 1) // 2 + things * (1 + obstacles)
        compile_programs(things, things * links + MANY * patches, world.is_soft)

    def _alone(self, state: WorldState, mobilities: np.ndarray, dt: float) -> Float[np.ndarray, "N 6"]:
        """How objects would move after a step if nothing touched them: they keep their momentum, but for gravity."""
        weights = self._masses
        momentum = weights.momentum(state)
        momentum[:, :3] += dt * weights.mass[:, None] * np.asarray(self.world.scene.gravity)
        turned = led(state.placed, state.motion, dt).rotation
        alone = np.concatenate(
            [
                momentum[:, :3] / weights.mass[:, None],
                np.linalg.solve(weights.turned(turned), momentum[:, 3:, None])[..., 0],
            ],
            1,
        )
        if self.world.scene.guide is not None:
            alone[0] = mobilities[0] @ momentum[0]
        return alone

    def _moved(self, placed: Pose, motion: Motions, dt: float) -> Pose:
        after = led(placed, motion, dt)
        guide = self.world.scene.guide
        if guide is not None:
            first = Motion(jnp.asarray(motion.linear[0]), jnp.asarray(motion.angular[0]))
            there = jax.device_get(_led_along(Pose(placed.origin[0], placed.rotation[0]), first, dt, guide))
            after.origin[0], after.rotation[0] = there.origin, there.rotation
        return after


_led_along = jax.jit(moved)


def _speed(obstacle: Obstacle) -> float:
    """How fast any part of an obstacle moves at most [m/s]."""
    if obstacle.motion is None:
        return 0.0
    turning = np.linalg.norm(obstacle.motion.angular) * solid_of(obstacle.shape, obstacle.placed).extent()
    return float(np.linalg.norm(obstacle.motion.linear) + turning)


def _impulses(
    contacts: ContactList, seen: ContactRows, alone: np.ndarray, mobilities: np.ndarray, dt: float
) -> Impulses:
    approach = np.einsum("minj,nj->mi", seen.rows, alone) - seen.seen(contacts.carried, contacts.turning)
    spring = np.isfinite(contacts.stiffness)
    # A spring's push is that of its end; what is rigid closes its gap at most, and is pushed out slowly.
    rigid = np.where(contacts.gaps > 0, contacts.gaps, PUSHED_OUT * np.minimum(contacts.gaps + SLACK, 0))
    approach[:, 0] += np.where(spring, contacts.gaps, rigid) / dt
    giving = np.where(spring, 1 / (contacts.stiffness * dt**2), 0)
    return least_constraint(seen.rows, contacts.friction, mobilities, approach, giving)
