"""Contributions of links that follow the grip that the hand makes (section II-E), without a jump in what is felt.

A grip is taken for another only once it has been that for a while, since a fingertip that comes and goes is no new one;
then the contributions go over to its own within a few tenths of a second.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxgrasp.hand.detection import Contacts
from jaxgrasp.hand.grip_type import GripType, contributions_of, grip_type
from jaxgrasp.model.arrays import Float, Int
from jaxgrasp.model.hand import Hand, Posture

STEADY = 0.15
"""How long a grip must have been another one [s]."""
BLEND = 0.1
"""Time constant with which contributions go over to those of another grip [s]."""


class FollowedGrip(NamedTuple):
    """Which grip counts, and what the links contribute."""

    kind: Int[Array, ""]
    """Code of the grip whose contributions count."""
    seen: Int[Array, ""]
    """Kind of the grip that was seen last."""
    since: Float[Array, ""]
    """How long it has been seen [s]."""
    contributions: Float[Array, "L"]


def grip_tables(hand: Hand) -> Float[np.ndarray, "kinds L"]:
    """Contributions of the links to each kind of grip, by its code."""
    return np.stack([contributions_of(hand, kind) for kind in GripType])


def first_grip(contributions: Float[Array, "L"]) -> FollowedGrip:
    """Before anything was seen: the scene's own contributions, until a grip is recognised."""
    none = jnp.asarray(GripType.NONE, jnp.int32)
    return FollowedGrip(none, none, jnp.zeros(()), jnp.asarray(contributions))


def next_grip(
    before: FollowedGrip, tables: Array, hand: Hand, posture: Posture, contacts: Contacts, passed: Array
) -> FollowedGrip:
    """What counts after so long, by what touches now; where nothing does, or nothing known, all stays."""
    now = grip_type(hand, posture, contacts)
    known = now > GripType.UNKNOWN
    since = jnp.where(now == before.seen, before.since + passed, 0.0)
    kind = jnp.where(known & (since >= STEADY), now, before.kind)
    target = jnp.where(kind > GripType.UNKNOWN, tables[kind], before.contributions)
    share = 1 - jnp.exp(-passed / BLEND)
    return FollowedGrip(kind, now, since, before.contributions + share * (target - before.contributions))
