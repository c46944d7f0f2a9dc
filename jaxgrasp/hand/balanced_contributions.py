"""Contributions by which a grip's squeezing forces balance: Table I is of a hand whose palm and thumb it leaves out."""

import jax
import jax.numpy as jnp
from jax import Array

from jaxgrasp.hand.detection import Contacts
from jaxgrasp.model.arrays import AnyArray, Float
from jaxgrasp.numerics.nonnegative_qp import minimise_nonnegative
from jaxgrasp.validation.checked import checked

FAITHFUL = 0.1
"""Cost of leaving a contribution, in units of the unbalanced force that this saves."""


@checked
def balanced_contributions(
    contacts: Contacts, contributions: Float[AnyArray, "L"], centre: Float[AnyArray, "3"]
) -> Float[Array, "L"]:
    """Compute the contributions nearest to the given ones with which the squeezing forces (eq. 6) balance.

    Squeezing forces that leave much of themselves unbalanced are what takes method B out of the friction cones: it
    spreads what balances them over all contacts, by their weights. Links that do not touch keep their contribution,
    and those that do share the same total of squeezing as before.

    Args:
        contacts: of the closed hand, one posture's.
        contributions: of each link, such as [`jaxgrasp.grip.contributions_of`][] gives.
        centre: of the object, in the world [m].

    Returns:
        ``(L,)``, none negative. The squeezing forces by them balance as far as forces along the normals can.
    """
    depths = jnp.maximum(contacts.depths, 0) * contacts.present
    return _balanced(depths, contacts.points, contacts.normals, jnp.asarray(contributions, depths.dtype), centre)


@jax.jit
def _balanced(depths: Array, points: Array, normals: Array, contributions: Array, centre: Array) -> Array:
    touches = depths > 0
    arms = jnp.where(touches[:, None], points - centre, 0)
    length = jnp.sqrt(jnp.sum(arms**2) / jnp.maximum(jnp.sum(touches), 1))
    length = jnp.where(length > 0, length, 1)
    # Each contact's wrench for a unit of its contribution, lengths in those of the grip, depths in their mean.
    relative_depths = depths / jnp.where(jnp.any(touches), jnp.sum(depths) / jnp.maximum(jnp.sum(touches), 1), 1)
    wrenches = jnp.concatenate([normals, jnp.cross(arms, normals) / length], -1) * relative_depths[:, None]
    closeness = jnp.diag((FAITHFUL * relative_depths) ** 2)
    # minimise |W' c|^2 + |D (c - c_0)|^2 over c >= 0, with D = FAITHFUL x relative depth
    balanced = minimise_nonnegative(wrenches @ wrenches.T + closeness, -closeness @ contributions)
    total_before, total_after = depths @ contributions, depths @ balanced
    scale = jnp.where(total_after > 0, total_before / jnp.where(total_after > 0, total_after, 1), 1)
    return jnp.where(touches, scale * balanced, contributions)
