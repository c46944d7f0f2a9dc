"""How far a posed hand is from holding an object by its fingertips: every demand of such a grip, as a number."""

from itertools import combinations
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxgrasp.hand.kinematics import pose_hand
from jaxgrasp.hand.shapes import Shape, signed_distance
from jaxgrasp.model.arrays import AnyArray
from jaxgrasp.model.hand import Hand, Pose, Posture

CLEARANCE = 2e-3
"""Distance that all but the fingertips keep from the object [m]."""
APART = 1e-3
"""Distance that fingertips keep from each other [m]."""
OPPOSED = 0.5
"""Cosine of the angle between a finger's normal and the line to the thumb, at least."""
PULP = 0.7
"""Cosine of the angle between a contact's normal and straight out of the finger's palmar side, at least."""
COUPLING = 2 / 3
"""Flexion of a finger's last joint by that of the one before, as tendons couple them (Rijpkema and Girard 1991)."""


class FingertipTask(eqx.Module):
    """Which fingertips are to touch what, and how deep."""

    hand: Hand
    shape: Shape
    depth: float | AnyArray
    """[m]"""
    fingers: tuple[str, ...] = eqx.field(static=True)
    """The thumb first."""

    @property
    def tips(self) -> list[int]:
        """Their links."""
        names = [link.name for link in self.hand.links]
        return [names.index(f"{finger} distal") for finger in self.fingers]

    @property
    def joints(self) -> list[int]:
        """Those that carry the fingertips."""
        return [j for j, name in enumerate(self.hand.joints) if name.split()[0] in self.fingers]

    def fingers_joints(self, kind: str) -> list[int]:
        """One kind of joint of all fingers but the thumb."""
        return [self.hand.joints.index(f"{finger} {kind}") for finger in self.fingers[1:]]


class Misses(NamedTuple):
    """What is missing to a precision grip; zero where nothing is."""

    depth: AnyArray
    """``(n,)`` How much too deep each fingertip is [m]."""
    facing: AnyArray
    """``(2, 3)`` The thumb's normal less the direction from the thumb to the fingers, and theirs less its opposite."""
    opposing: AnyArray
    """``(n - 1,)`` How far each finger's cosine is below ``OPPOSED``."""
    intrusion: AnyArray
    """``(L - n,)`` How much nearer than ``CLEARANCE`` the other links come to the object [m]."""
    overlap: AnyArray
    """``(n (n - 1) / 2,)`` How much nearer than ``APART`` two fingertips come [m]."""
    pulp: AnyArray
    """``(n,)`` How far the cosine is below ``PULP``."""
    side: AnyArray
    """``(n,)`` How much of the normals points sideways out of the fingers."""
    coupling: AnyArray
    """``(n - 1,)`` Flexion of the last joints beyond the ``COUPLING`` [rad]."""
    spread: AnyArray
    """``(n - 1,)`` Abduction of the fingers [rad]."""


WEIGHED = {
    "depth": 5e-5,
    "facing": 0.03,
    "opposing": 0.03,
    "intrusion": 2e-4,
    "overlap": 2e-4,
    "pulp": 0.3,
    "side": 3.0,
    "coupling": 3.0,
    "spread": 1.5,
}
"""How much of each counts as much as how much of the others: depths are met, comfort is a wish."""


def misses(task: FingertipTask, angles: Array, placed: Pose) -> Misses:
    """What is missing, where the wrist stands at the world's origin.

    A fingertip that does not touch counts by its sphere that is nearest to the object; one that does by the mean
    of its overlaps, as [`jaxgrasp.hand.find_contacts`][] takes it.
    """
    hand, tips = task.hand, np.array(task.tips)
    others = np.setdiff1d(np.arange(len(hand.links)), tips)
    links = pose_hand(hand, Posture(Pose(jnp.zeros(3), jnp.eye(3)), angles)).links
    centers = jnp.einsum("lij,lmj->lmi", links.rotation, hand.skin.centers) + links.origin[:, None]
    own = (centers - placed.origin) @ placed.rotation
    distances, out = signed_distance(task.shape, own)
    depths = hand.skin.radii - distances
    weights = _weights(depths[tips])
    points = jnp.einsum("tm,tmi->ti", weights, (own - distances[..., None] * out)[tips]) @ placed.rotation.T
    normals = -_unit(jnp.einsum("tm,tmi->ti", weights, out[tips])) @ placed.rotation.T
    along = _unit(jnp.mean(points[1:], 0) - points[0])
    turned = links.rotation[tips]
    return Misses(
        depth=jnp.sum(weights * depths[tips], -1) - task.depth,
        facing=jnp.stack([normals[0] - along, _unit(jnp.mean(normals[1:], 0)) + along]),
        opposing=jnp.maximum(OPPOSED + normals[1:] @ along, 0),
        intrusion=jnp.maximum(jnp.max(depths[others], -1) + CLEARANCE, 0),
        overlap=jnp.maximum(APART - _gaps(centers[tips], hand.skin.radii[tips]), 0),
        pulp=jnp.maximum(PULP + jnp.sum(turned[..., 2] * normals, -1), 0),
        side=jnp.sum(turned[..., 1] * normals, -1),
        coupling=angles[np.array(task.fingers_joints("DIP"))] - COUPLING * angles[np.array(task.fingers_joints("PIP"))],
        spread=angles[np.array(task.fingers_joints("abduction"))],
    )


def weighed(missed: Misses) -> Array:
    """All of it in one vector, in units that count alike."""
    return jnp.concatenate([jnp.ravel(getattr(missed, name)) / unit for name, unit in WEIGHED.items()])


def _weights(depths: Array) -> Array:
    """Weights of a row's spheres in its contact; the nearest sphere alone counts where none touches."""
    square = jnp.maximum(depths, 0) ** 2
    total = jnp.sum(square, -1, keepdims=True)
    nearest = jax.nn.one_hot(jnp.argmax(depths, -1), depths.shape[-1], dtype=depths.dtype)
    return jnp.where(total > 0, square / jnp.where(total > 0, total, 1), nearest)


def _gaps(centers: Array, radii: Array) -> Array:
    """Least distances between the skins of every two rows of spheres ``(n, m, 3)``."""
    one, other = np.array(list(combinations(range(len(centers)), 2))).T
    between = jnp.linalg.norm(centers[one][:, :, None] - centers[other][:, None], axis=-1)
    return jnp.min(between - radii[one][:, :, None] - radii[other][:, None], (1, 2))


def _unit(vectors: Array) -> Array:
    return vectors / jnp.linalg.norm(vectors, axis=-1, keepdims=True)
