"""How an object goes on that nothing touches: by its momentum, by gravity, and along its guide; it gains no energy."""

import jax
import jax.numpy as jnp
from jax import Array, lax

from jaxgrasp.grip.motion import Body, Motion, mobility, moved, spatial_inertia
from jaxgrasp.grip.scene import Scene
from jaxgrasp.model.arrays import AnyArray
from jaxgrasp.model.hand import Pose

NEWTON_STEPS = 4
"""Newton steps for an implicit step in time, which begins close to its solution."""
MIDPOINT_STEPS = 3
"""Iterations in search of the twist whose momentum is right halfway: each multiplies the error by about the angle
turned in half a step."""
HALVINGS = 40
"""Bisections in search of the largest motion that gains no energy."""


def fallen(scene: Scene, dt: float | AnyArray, placed: Pose, going: Motion) -> Motion:
    """The motion of an object after an instant of gravity, which without it would go on so."""
    if scene.guide is None:
        spin = spun(scene.body, placed.rotation, going.angular, dt)
        return Motion(going.linear + dt * jnp.asarray(scene.gravity), spin)
    pull = jnp.append(scene.body.mass * jnp.asarray(scene.gravity), jnp.zeros(3))
    gained = mobility(scene.body, placed, scene.guide) @ pull * dt
    return Motion(going.linear + gained[:3], going.angular + gained[3:])


def gone_on(scene: Scene, dt: float | AnyArray, before: Pose, own: Motion, placed: Pose) -> Motion:
    """The motion that an object has further on, if nothing but its guide acts on it.

    The momentum that works along the guide stays, since the guide's twists are the world's own and its forces do no
    work along them; and so does the kinetic energy.

    Args:
        scene: its body and guide.
        dt: for how long it has moved [s].
        before: from where.
        own: how.
        placed: where it is now.
    """
    if scene.guide is None:
        return own
    middle, motion = _halfway(scene, dt, before, jnp.concatenate(own))
    momentum = spatial_inertia(scene.body, middle.rotation) @ motion
    new = mobility(scene.body, placed, scene.guide) @ _about(momentum, middle, placed)
    energy, kept = motion @ momentum, new @ spatial_inertia(scene.body, placed.rotation) @ new
    new = new * jnp.sqrt(jnp.where(kept > 0, energy / jnp.where(kept > 0, kept, 1), 1))
    return Motion(new[:3], new[3:])


def led_on(scene: Scene, dt: float | AnyArray, placed: Pose, going: Motion, motion: Motion) -> Motion:
    """The steady twist along a guide that has a motion's momentum halfway, or as much of it as the energy allows: that
    of ``going``, and what gravity gives on the way, of which a guide that bends makes a little more or less."""
    momentum = spatial_inertia(scene.body, placed.rotation) @ jnp.concatenate(motion)
    twist = jnp.concatenate(motion)
    for _ in range(MIDPOINT_STEPS):
        middle, _ = _halfway(scene, dt, placed, twist)
        there = mobility(scene.body, middle, scene.guide) @ _about(momentum, placed, middle)
        twist = _seen_from(there, middle, placed)
    had = jnp.concatenate(going) @ spatial_inertia(scene.body, placed.rotation) @ jnp.concatenate(going) / 2

    def gains(share: Array) -> Array:
        middle, there = _halfway(scene, dt, placed, share * twist)
        way = moved(placed, Motion(share * twist[:3], share * twist[3:]), dt, scene.guide).origin - placed.origin
        work = scene.body.mass * jnp.asarray(scene.gravity) @ way
        return there @ spatial_inertia(scene.body, middle.rotation) @ there / 2 > had + work

    def halve(_, bounds: tuple[Array, Array]) -> tuple[Array, Array]:
        low, high = bounds
        share = (low + high) / 2
        too_much = gains(share)
        return jnp.where(too_much, low, share), jnp.where(too_much, share, high)

    one = jnp.ones_like(had)
    share = jnp.where(gains(one), lax.fori_loop(0, HALVINGS, halve, (0 * one, one))[0], 1)
    return Motion(share * twist[:3], share * twist[3:])


def _halfway(scene: Scene, dt: float | AnyArray, placed: Pose, twist: Array) -> tuple[Pose, Array]:
    """Where a steady twist leads in half the time, and the motion of the centre there."""
    middle = moved(placed, Motion(twist[:3], twist[3:]), dt / 2, scene.guide)
    return middle, _seen_from(twist, placed, middle)


def _seen_from(twist: Array, one: Pose, other: Pose) -> Array:
    """A twist about one place's origin as one about another's."""
    arm = jnp.asarray(other.origin) - one.origin
    return jnp.concatenate([twist[:3] + jnp.cross(twist[3:], arm), twist[3:]])


def _about(momentum: Array, one: Pose, other: Pose) -> Array:
    """Momentum about one place's origin as that about another's."""
    arm = jnp.asarray(one.origin) - other.origin
    return jnp.concatenate([momentum[:3], momentum[3:] + jnp.cross(arm, momentum[:3])])


def spun(body: Body, rotation: AnyArray, angular: AnyArray, dt: float | AnyArray) -> Array:
    """The spin of a body that nothing holds after ``dt`` seconds.

    Euler's equations by an implicit step in the body's own axes, where the inertia stays: it gains no energy.
    """
    inertia = body.inertia_matrix() / body.mass
    own = jnp.asarray(rotation).T @ angular

    def rest(spin: Array) -> Array:
        return inertia @ (spin - own) + dt * jnp.cross(spin, inertia @ spin)

    spin = own
    for _ in range(NEWTON_STEPS):
        spin = spin - jnp.linalg.solve(jax.jacfwd(rest)(spin), rest(spin))
    return jnp.asarray(rotation) @ spin
