"""A fixed number of contacts: the deepest, and how many others were dropped."""

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array, lax

from jaxgrasp.hand.detection import Contacts
from jaxgrasp.validation.checked import checked


class DeepestContacts(NamedTuple):
    """The contacts that were kept, deepest first, any leading axes."""

    contacts: Contacts
    links: Array
    """``(..., size)``: the link of each."""
    dropped: Array
    """``(...)``: present contacts for which there was no place."""


@checked
def keep_deepest(contacts: Contacts, size: int) -> DeepestContacts:
    """Keep the ``size`` deepest contacts of each pose, and count the others.

    Args:
        contacts: ``(..., L)``.
        size: of the last axis of what is kept; more than ``L`` is as ``L``.

    Raises:
        ValueError: for a size below 1.
    """
    if size < 1:
        raise ValueError(f"size is {size}: expected at least one contact")
    links = contacts.depths.shape[-1]
    # A NaN sorts before all else: bad data must not be dropped unseen.
    order = jnp.where(jnp.isnan(contacts.present), jnp.inf, jnp.where(contacts.present > 0, contacts.depths, -1.0))
    _, chosen = lax.top_k(order, min(size, links))

    def select(array: Array) -> Array:
        index = chosen if array.ndim == chosen.ndim else chosen[..., None]
        return jnp.take_along_axis(array, index, chosen.ndim - 1)

    selected = {name: select(getattr(contacts, name)) for name in ("points", "normals", "depths", "present")}
    n_present = jnp.sum(contacts.present > 0, -1)
    dropped = n_present - jnp.sum(selected["present"] > 0, -1)
    return DeepestContacts(Contacts(**selected, tests=contacts.tests), chosen, dropped)
