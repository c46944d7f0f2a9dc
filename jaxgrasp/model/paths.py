"""Paths along which a hand leads an object: its pose over time, by the numbers that a person would vary.

A path is anything that makes a pose of a time; it must have two derivatives, since what leads an object along it feels
its inertia.
"""

import equinox as eqx
import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

from jaxgrasp.model.arrays import AnyArray, Float
from jaxgrasp.model.hand import Pose
from jaxgrasp.numerics.rotation import rotation_about, unit


class Turn(eqx.Module):
    """Rotation about an axis through the origin, at a steady speed, there and, where it reverses, back again.

    At the instants where it reverses the speed jumps; the blow that this would take is left out.

    Args:
        axis: direction of the axis of rotation ``(3,)``, of any length.
        speed: angular speed [rad/s].
        reversal: time that it goes in one direction before it goes in the other [s]; ``None``: it never reverses.
    """

    axis: Float[AnyArray, "3"]
    """Direction of the axis of rotation, of any length."""
    speed: Float[AnyArray, ""] | float
    """[rad/s]"""
    reversal: Float[AnyArray, ""] | float | None = None
    """How long it goes one way before it goes the other [s]; ``None`` for ever on."""

    def __call__(self, time: Float[AnyArray, ""] | float) -> Pose:
        """Return the pose at a time [s]."""
        along: ArrayLike = time
        if self.reversal is not None:
            phase_time = jnp.mod(time, 2 * self.reversal)
            along = jnp.minimum(phase_time, 2 * self.reversal - phase_time)
        return Pose(jnp.zeros(3), rotation_about(self.axis, self.speed * along))


class Lift(eqx.Module):
    """Straight along a direction, from rest to rest, smoothly.

    Args:
        direction: direction of the lift ``(3,)``, of any length.
        height: distance [m].
        duration: time from rest to rest [s].
    """

    direction: Float[AnyArray, "3"]
    """Direction of the lift, of any length."""
    height: Float[AnyArray, ""] | float
    """How far [m]."""
    duration: Float[AnyArray, ""] | float
    """[s]"""

    def __call__(self, time: Float[AnyArray, ""] | float) -> Pose:
        """Return the pose at a time [s]."""
        height = self.height * smooth_step(jnp.asarray(time) / self.duration)
        return Pose(height * unit(self.direction), jnp.eye(3))


class Shake(eqx.Module):
    """To and fro along a direction, as a sine.

    Args:
        direction: direction of the shaking ``(3,)``, of any length.
        amplitude: largest distance from the middle [m].
        frequency: periods in a second [Hz].
    """

    direction: Float[AnyArray, "3"]
    """Direction of the shaking, of any length."""
    amplitude: Float[AnyArray, ""] | float
    """[m]"""
    frequency: Float[AnyArray, ""] | float
    """[Hz]"""

    def __call__(self, time: Float[AnyArray, ""] | float) -> Pose:
        """Return the pose at a time [s]."""
        displacement = self.amplitude * jnp.sin(2 * jnp.pi * self.frequency * jnp.asarray(time))
        return Pose(displacement * unit(self.direction), jnp.eye(3))


def smooth_step(progress: Array) -> Array:
    """From 0 to 1 without a jump in speed or acceleration."""
    s = jnp.clip(progress, 0, 1)
    return s**3 * (10 - 15 * s + 6 * s**2)
