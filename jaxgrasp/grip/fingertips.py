"""How far a posed hand is from holding an object by its fingertips: every demand of such a grip, as a number."""

from collections.abc import Sequence
from itertools import combinations
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxgrasp.hand.closing_way import ClosingWay
from jaxgrasp.hand.kinematics import ancestry, pose_hand
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
    way: ClosingWay
    """In which the hand closes."""
    pulps: AnyArray
    """``(n, 3)`` Straight out of each fingertip's palmar side, in its link's frame."""
    sides: AnyArray
    """``(n, 3)`` Sideways out of each fingertip, likewise."""
    fingers: tuple[str, ...] = eqx.field(static=True)
    """The thumb first."""
    tips: tuple[int, ...] = eqx.field(static=True)
    """Their links."""
    joints: tuple[int, ...] = eqx.field(static=True)
    """Those that carry the fingertips."""
    flexions: tuple[tuple[int, ...], ...] = eqx.field(static=True)
    """The joints that close each finger, from the palm outwards."""

    @property
    def wrist(self) -> Pose:
        """At the world's origin, palm down."""
        return Pose(jnp.zeros(3), jnp.asarray(self.way.frame).T)

    @property
    def abductions(self) -> list[int]:
        """The fingers' other joints."""
        flexing = {joint for chain in self.flexions for joint in chain}
        thumb = set(np.flatnonzero(ancestry(self.hand)[self.tips[0]]).tolist())
        return [joint for joint in self.joints if joint not in flexing | thumb]

    def bent(self, angles: AnyArray, joints: Sequence[int]) -> AnyArray:
        """How far joints are on their way from open to closed [rad]."""
        at = np.array(joints)
        ways = jnp.asarray(self.way.closed)[at] - jnp.asarray(self.way.open)[at]
        return jnp.sign(ways) * (angles[..., at] - jnp.asarray(self.way.open)[at])


def fingertip_task(hand: Hand, shape: Shape, depth: float, fingers: tuple[str, ...], way: ClosingWay) -> FingertipTask:
    """The task of a hand's fingertips, the thumb's first.

    Raises:
        ValueError: for a hand that lacks one of these fingertips, or joints that bend it.
    """
    names, moves = [(link.finger, link.phalanx) for link in hand.links], ancestry(hand)
    lacking = [finger for finger in fingers if (finger, "distal") not in names]
    if lacking:
        raise ValueError(f"hand has no link {lacking[0]} distal: expected links named as name_fingers does")
    tips = [names.index((finger, "distal")) for finger in fingers]
    closing = np.asarray(way.closed) != np.asarray(way.open)
    flexions = tuple(tuple(np.flatnonzero(moves[tip] & closing).tolist()) for tip in tips)
    for finger, chain in zip(fingers, flexions, strict=True):
        if len(chain) < 2:
            raise ValueError(f"{finger} has {len(chain)} joints that close it: expected two at least")
    still = Posture(Pose(jnp.zeros(3), jnp.eye(3)), jnp.asarray(way.open))
    frames = jax.device_get(pose_hand(hand, still))
    last = np.array([chain[-1] for chain in flexions])
    turned, axes = frames.links.rotation[tips], frames.axes[last]
    ends = frames.links.origin[tips] + np.einsum("tij,tj->ti", turned, tip_ends(hand, tips))
    signs = np.sign(np.asarray(way.closed) - np.asarray(way.open))[last]
    towards = signs[:, None] * np.cross(axes, ends - frames.joints.origin[last])
    towards /= np.linalg.norm(towards, axis=-1, keepdims=True)
    own = [np.einsum("tij,ti->tj", turned, each) for each in (towards, axes)]
    joints = tuple(np.flatnonzero(moves[tips].any(0)).tolist())
    return FingertipTask(hand, shape, depth, way, own[0], own[1], fingers, tuple(tips), joints, flexions)


def tip_ends(hand: Hand, tips: list[int]) -> np.ndarray:
    """``(n, 3)`` Centres of the spheres at the ends of links, in their frames."""
    centers, radii = np.asarray(hand.skin.centers)[tips], np.asarray(hand.skin.radii)[tips]
    ends = np.argmax(np.where(radii > 0, np.linalg.norm(centers, axis=-1), -1), -1)
    return centers[np.arange(len(tips)), ends]


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
    """Abduction of the fingers [rad]: of every joint of theirs that does not close them."""


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
    """What is missing, where the wrist stands at the world's origin, palm down.

    A fingertip that does not touch counts by its sphere that is nearest to the object; one that does by the mean
    of its overlaps, as [`jaxgrasp.hand.find_contacts`][] takes it.
    """
    hand, tips = task.hand, np.array(task.tips)
    others = np.setdiff1d(np.arange(len(hand.links)), tips)
    links = pose_hand(hand, Posture(task.wrist, angles)).links
    centers = jnp.einsum("lij,lmj->lmi", links.rotation, hand.skin.centers) + links.origin[:, None]
    own = (centers - placed.origin) @ placed.rotation
    distances, out = signed_distance(task.shape, own)
    depths = hand.skin.radii - distances
    weights = _weights(depths[tips])
    points = jnp.einsum("tm,tmi->ti", weights, (own - distances[..., None] * out)[tips]) @ placed.rotation.T
    normals = -_unit(jnp.einsum("tm,tmi->ti", weights, out[tips])) @ placed.rotation.T
    along = _unit(jnp.mean(points[1:], 0) - points[0])
    turned = links.rotation[tips]
    before, ends = zip(*(chain[-2:] for chain in task.flexions[1:]), strict=True)
    return Misses(
        depth=jnp.sum(weights * depths[tips], -1) - task.depth,
        facing=jnp.stack([normals[0] - along, _unit(jnp.mean(normals[1:], 0)) + along]),
        opposing=jnp.maximum(OPPOSED + normals[1:] @ along, 0),
        intrusion=jnp.maximum(jnp.max(depths[others], -1) + CLEARANCE, 0),
        overlap=jnp.maximum(APART - _gaps(centers[tips], hand.skin.radii[tips]), 0),
        pulp=jnp.maximum(PULP - jnp.einsum("tij,tj,ti->t", turned, task.pulps, normals), 0),
        side=jnp.einsum("tij,tj,ti->t", turned, task.sides, normals),
        coupling=task.bent(angles, ends) - COUPLING * task.bent(angles, before),
        spread=(angles - jnp.asarray(task.way.open))[np.array(task.abductions, int)],
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
