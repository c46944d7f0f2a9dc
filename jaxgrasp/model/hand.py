"""The Hand: links that turn or slide, the spheres that they are made of for contact, and where it all stands.

- Angles are in rad. Of a human hand's joints flexion bends towards the palm and counts positive; abduction
  counts positive towards the thumb, but for ring and little finger away from it, and the thumb's own away from
  the palm.
- A joint that slides has a way [m] in place of an angle, and feels a force in place of a torque.
- A frame is an origin and a rotation; the rotation's columns are the frame's axes.
"""

from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxgrasp.model.arrays import AnyArray, Float


class Link(NamedTuple):
    """A rigid part of a hand, which touches an object at one contact at most."""

    finger: str
    """thumb, index, middle, ring or little; of a hand of another make, its body's own name."""
    phalanx: str
    """palm (a finger's metacarpal), metacarpal (the thumb's), proximal, middle or distal; or empty."""
    joint: int
    """The joint that carries it; -1 for the wrist."""

    @property
    def name(self) -> str:
        return f"{self.finger} {self.phalanx}".rstrip()


class Spheres(eqx.Module):
    """Spheres whose union is the skin: ``m`` to a link, those that a link does without of radius 0."""

    centers: Float[AnyArray, "L m 3"]
    """Centres in their link's frame [m]."""
    radii: Float[AnyArray, "L m"]
    """[m]"""


def padded(rows: Sequence[tuple[np.ndarray, np.ndarray]]) -> Spheres:
    """Links of different numbers of spheres, centres and radii of each, in one array."""
    most = max((len(radii) for _, radii in rows), default=0)
    centers, sizes = np.zeros((len(rows), most, 3)), np.zeros((len(rows), most))
    for i, (points, radii) in enumerate(rows):
        centers[i, : len(radii)], sizes[i, : len(radii)] = points, radii
    return Spheres(jnp.asarray(centers), jnp.asarray(sizes))


class Coupling(eqx.Module):
    """Linear law by which all joints follow some of them: angles = matrix @ independent angles + offset.

    By virtual work the torque that acts along an independent joint, with all that follow it, is the transposed matrix
    times the joints' torques.
    """

    matrix: Float[AnyArray, "J I"]
    offset: Float[AnyArray, "J"]
    """[rad], or [m] of joints that slide."""
    independent: tuple[int, ...] = eqx.field(static=True)
    """Joints that follow no other, in order; each is its own column of the matrix."""

    def angles(self, angles: Float[AnyArray, "*batch J"]) -> Float[Array, "*batch J"]:
        """Return angles of all joints, of which those that follow others are what the law makes them."""
        return jnp.asarray(angles)[..., list(self.independent)] @ jnp.asarray(self.matrix).T + self.offset

    def torques(self, torques: Float[AnyArray, "*batch J"]) -> Float[Array, "*batch I"]:
        """Return what torques of all joints are along the independent ones [N.m, or N of those that slide]."""
        return jnp.asarray(torques) @ jnp.asarray(self.matrix)


class Hand(eqx.Module):
    """A tree of joints that grows from the wrist (source: sections II-B and II-G.2); without any, one rigid body.

    A joint's frame stands at ``origins`` in its parent's, turned by ``rests`` where the angle is zero, and turns
    about ``axes``, or slides along them. A link's frame is its joint's. Joints come after their parents.
    """

    origins: Float[AnyArray, "J 3"]
    """[m]"""
    rests: Float[AnyArray, "J 3 3"]
    axes: Float[AnyArray, "J 3"]
    """Unit vectors along the joints' axes, each in its joint's own frame."""
    lower: Float[AnyArray, "J"]
    """Least angles [rad]."""
    upper: Float[AnyArray, "J"]
    """Largest angles [rad]."""
    skin: Spheres
    parents: tuple[int, ...] = eqx.field(static=True)
    """The joint that carries each joint; -1 for the wrist."""
    joints: tuple[str, ...] = eqx.field(static=True)
    """Names of the joints, such as ``index MP``."""
    links: tuple[Link, ...] = eqx.field(static=True)
    sliding: tuple[str, ...] = eqx.field(static=True, default=())
    """Names of those joints that slide; the others are hinges."""
    torque_max: Float[AnyArray, "J"] | None = None
    """Largest torque of each joint, in either direction [N.m, or N of those that slide]; inf of those of which it is
    not known, and None where it is of none. Of a joint that others follow it is what the motors of all of them can do
    along it; of a joint that follows others it is inf."""
    coupling: Coupling | None = None
    """Law of the joints that follow others; None where each moves by itself."""

    @property
    def slides(self) -> np.ndarray:
        """``(J,)`` booleans: which joints slide."""
        return np.array([name in self.sliding for name in self.joints], bool)


class Pose(eqx.Module):
    """Pose of a body's frame in the world."""

    origin: Float[AnyArray, "*batch 3"]
    """[m]"""
    rotation: Float[AnyArray, "*batch 3 3"]
    """The body's axes in the world, as columns."""


class Posture(eqx.Module):
    """Pose of the wrist, and every joint's angle."""

    wrist: Pose
    angles: Float[AnyArray, "*batch J"]
    """[rad]; [m] of joints that slide."""


class HandFrames(eqx.Module):
    """Frames of the parts of a posed hand in the world."""

    joints: Pose
    """Frames of the joints ``(..., J)``, turned or moved by their angles."""
    axes: Float[AnyArray, "*batch J 3"]
    """Axes about which the joints turn, or along which they slide."""
    links: Pose
    """Frames of the links ``(..., L)``."""
