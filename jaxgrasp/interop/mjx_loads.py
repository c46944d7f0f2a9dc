"""Names of loads on an object in states of MJX that are not in its wrench; traced states have no known loads."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxgrasp.interop.mujoco_loads import (
    ACTUATORS,
    APPLIED,
    CONSTRAINTS,
    LOADED,
    NEGLIGIBLE,
    PASSIVE,
    STANDARD_GRAVITY,
    equality_names,
)
from jaxgrasp.interop.mujoco_selection import ModelTree

if TYPE_CHECKING:
    from mujoco import mjx

ROUNDING = 10
"""Units in the last place of the weight below which a load is rounding."""


def loads_left_out_of_states(
    mujoco: Any, model: mjx.Model, data: mjx.Data, tree: ModelTree, root: int, inside: np.ndarray
) -> list[str]:
    """Return a sentence for each kind of load on a free object that is neither gravity, ``xfrc_applied`` nor a contact.

    Args:
        mujoco: the library.
        model: in MJX.
        data: its state, or many with the same leading axes everywhere.
        tree: bodies of the model.
        root: id of the object's topmost body, of six coordinates.
        inside: ``(nbody,)`` booleans: bodies of the object.

    Returns:
        Sentences on the loads of any of the states; none where model or data are traced.
    """
    if any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves((model, data))):
        return []
    first = int(model.body_dofadr[root])
    loads = _loads(mujoco, data, slice(first, first + 6))
    weight = float(np.asarray(model.body_mass)[inside].sum()) * STANDARD_GRAVITY
    precision = float(jnp.finfo(data.qpos.dtype).eps)
    largest = jax.device_get({source: jnp.abs(load).max(initial=0) for source, load in loads.items()})
    sources = [source for source, size in largest.items() if size > max(NEGLIGIBLE, ROUNDING * precision) * weight]
    equalities = equality_names(mujoco, model, _is_active(data), inside, tree.name_of) if CONSTRAINTS in sources else ""
    return [
        LOADED.format(repr(tree.body_name(root)), source + equalities if source == CONSTRAINTS else source)
        for source in sources
    ]


def _loads(mujoco: Any, data: mjx.Data, dofs: slice) -> dict[str, Array]:
    """Return the loads ``(..., 6)`` along the coordinates of the object's root, by source.

    These see all loads from outside and none between the object's parts.
    """
    impl: Any = data._impl
    kinds = mujoco.mjtConstraint
    contacts = [
        int(kinds.mjCNSTR_CONTACT_FRICTIONLESS),
        int(kinds.mjCNSTR_CONTACT_PYRAMIDAL),
        int(kinds.mjCNSTR_CONTACT_ELLIPTIC),
    ]
    # Rows J of constraints that are not contacts exert J^T f.
    force = jnp.where(jnp.isin(impl.efc_type, jnp.array(contacts)), 0, impl.efc_force)
    return {
        PASSIVE: data.qfrc_passive[..., dofs] - data.qfrc_gravcomp[..., dofs],
        ACTUATORS: data.qfrc_actuator[..., dofs],
        APPLIED: data.qfrc_applied[..., dofs],
        CONSTRAINTS: jnp.einsum("...e,...ed->...d", force, impl.efc_J[..., dofs]),
    }


def _is_active(data: mjx.Data) -> np.ndarray:
    """Return ``(neq,)`` booleans: equality constraints that are active in any of the states."""
    active = np.asarray(data.eq_active, bool)
    return np.asarray(active.any(tuple(range(active.ndim - 1))))
