"""Contacts out of MuJoCo Warp: all worlds of a state at once, without a copy through the host."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxgrasp.interop.contact_arrays import as_jax, from_contact_arrays, places
from jaxgrasp.interop.mjx_contacts import MjxGrasp
from jaxgrasp.interop.mujoco_contacts import ANISOTROPIC, ROLLING, import_mujoco
from jaxgrasp.interop.mujoco_selection import (
    ContactSelection,
    Element,
    Exclude,
    ModelTree,
    listed,
    select_contacts,
    tree_of_mujoco,
)
from jaxgrasp.validation.checked import checked

if TYPE_CHECKING:
    import mujoco

PYRAMID_EDGES = 10
"""Constraint rows of a contact of ``condim`` 6 with a pyramidal cone."""
CONSTRAINT = 1
"""Bit of a contact's type by which the solver takes it, not a sensor."""
CONTACT_FIELDS = ("pos", "frame", "dist", "includemargin", "friction", "dim", "geom", "efc_address", "worldid", "type")


class _State(NamedTuple):
    """Arrays of a state: contacts of all worlds in a list, and quantities of each world."""

    contact: dict[str, Array]
    nacon: Array
    rows: Array
    """``(nworld, njmax)``: forces of the constraints."""
    xipos: Array
    xfrc_applied: Array


@checked
def from_mujoco_warp(
    model: mujoco.MjModel,
    data: Any,
    body: str | int,
    *,
    hand: Element | Sequence[Element] | None = None,
    exclude: Exclude = (),
    max_contacts: int = 32,
    body_mass: Any = None,
) -> MjxGrasp:
    """Read the contacts between an object and a hand in all worlds of MuJoCo Warp, as ``from_mujoco`` does in one.

    Contacts are those of the last ``mujoco_warp.forward`` or ``step``, or of MJX with ``impl="warp"``. Arrays of Warp
    are read where they are, by DLPack; the answer is waited for, since the next step overwrites them. Inside ``jit``
    and over all worlds at once it takes ``mjx.Data``, whose arrays are JAX's; the list of contacts of all worlds cannot
    be mapped by ``vmap``. The object is ``body`` with all that is welded to it and all bodies below it in joints.

    Args:
        model: the compiled model of MuJoCo, from which the one in Warp was made.
        data: a ``mujoco_warp.Data``, or ``mjx.Data`` of MJX's implementation in Warp, of W worlds.
        body: name or id of the held body.
        hand: elements whose contacts count, and ``exclude``, those whose contacts do not, as for
            [`jaxgrasp.interop.from_mujoco`][].
        max_contacts: places n for the contacts of a world; those of the largest normal force stay.
        body_mass: of the bodies ``(W, nbody)`` [kg], where worlds differ; the model's where not given.

    Returns:
        An MjxGrasp with the leading axis W, its squeezing forces the engine's own normal forces.

    Raises:
        ImportError: without MuJoCo.
        ValueError: for an unknown or immovable body, a name or id in ``hand`` or ``exclude`` that the model lacks or
            that cannot be meant, fewer than one place, or data of another simulator.

    Warns:
        UserWarning: by name of what the model may have and the answer lacks: rolling friction (``condim`` 6), and two
            sliding coefficients of a pair that differ. Loads other than gravity and ``xfrc_applied`` are left out
            without a warning: constraints, actuators, springs, fluids, and inertia.
    """
    mujoco = import_mujoco("from_mujoco_warp")
    if max_contacts < 1:
        raise ValueError(f"max_contacts is {max_contacts}: expected 1 or more")
    tree = tree_of_mujoco(mujoco, model)
    root = tree.object_root(body)
    inside = tree.subtree(root)
    selection = select_contacts(tree, body, tree.shapes_of(inside), hand, exclude)
    for sentence in _left_out(model, tree, selection):
        warnings.warn(sentence, stacklevel=3)
    state = _state(data)
    precision = state.xipos.dtype
    masses = as_jax("body_mass", model.body_mass if body_mass is None else body_mass).astype(precision)
    is_off = bool(int(model.opt.disableflags) & int(mujoco.mjtDisableBit.mjDSBL_GRAVITY))
    constants = {
        "is_object": jnp.asarray(selection.is_object),
        "inside": jnp.asarray(inside),
        "geom_bodies": jnp.asarray(tree.geom_bodies),
        "gravity": jnp.asarray(np.zeros(3) if is_off else model.opt.gravity, precision),
        "gravcomp": jnp.asarray(model.body_gravcomp, precision),
    }
    dims = np.concatenate([model.geom_condim, model.pair_dim])
    contact = state.contact
    selected = selection.is_selected(contact["geom"][:, 0], contact["geom"][:, 1], jnp)
    result = _read(
        state,
        constants,
        masses,
        selected,
        is_elliptic=int(model.opt.cone) == int(mujoco.mjtCone.mjCONE_ELLIPTIC),
        has_torsion=bool((dims > 3).any()),
        max_contacts=max_contacts,
    )
    return result if isinstance(result.wrench, jax.core.Tracer) else jax.block_until_ready(result)


def _state(data: Any) -> _State:
    """Return the arrays of a state of MuJoCo Warp, or of MJX's implementation in it."""
    impl = getattr(data, "_impl", None)
    if impl is not None and hasattr(impl, "contact__worldid"):
        contact = {name: getattr(impl, f"contact__{name}") for name in CONTACT_FIELDS}
        nacon, rows = impl.nacon, impl.efc__force
    elif hasattr(data, "nacon") and hasattr(getattr(data, "contact", None), "worldid"):
        contact = {name: as_jax(name, getattr(data.contact, name)) for name in CONTACT_FIELDS}
        nacon, rows = as_jax("nacon", data.nacon), as_jax("efc.force", data.efc.force)
    else:
        class_name = type(data if impl is None else impl).__name__
        raise ValueError(
            f"data is a {class_name}: expected a mujoco_warp.Data, or mjx.Data of the implementation in Warp"
        )
    xipos, applied = as_jax("xipos", data.xipos), as_jax("xfrc_applied", data.xfrc_applied)
    if xipos.ndim != 3:
        raise ValueError(f"data.xipos has shape {xipos.shape}: expected (worlds, bodies, 3), all worlds at once")
    return _State(contact, nacon, rows, xipos, applied.reshape(*xipos.shape[:2], 6))


def _left_out(model: mujoco.MjModel, tree: ModelTree, selection: ContactSelection) -> list[str]:
    """Return a sentence for each kind of friction that the model's shapes may have and an MjxGrasp lacks."""
    shapes = np.flatnonzero(selection.hand[: model.ngeom] & ~selection.is_object[: model.ngeom])
    rolling = shapes[model.geom_condim[shapes] == 6]
    pairs = np.stack([model.pair_geom1, model.pair_geom2])
    is_selected = selection.is_selected(*pairs)
    differ = is_selected & (model.pair_friction[:, 0] != model.pair_friction[:, 1]) & (model.pair_dim > 1)
    outside = np.where(selection.is_object[pairs[0]], pairs[1], pairs[0])
    cases = ((ROLLING, rolling), (ANISOTROPIC, outside[differ]))
    return [text.format(listed([tree.link_name(int(i)) for i in chosen])) for text, chosen in cases if len(chosen)]


@partial(jax.jit, static_argnames=("is_elliptic", "has_torsion", "max_contacts"))
def _read(
    state: _State,
    constants: dict[str, Array],
    masses: Array,
    selected: Array,
    *,
    is_elliptic: bool,
    has_torsion: bool,
    max_contacts: int,
) -> MjxGrasp:
    contact, n_worlds = state.contact, state.xipos.shape[0]
    geom, world = contact["geom"], contact["worldid"]
    is_listed = jnp.arange(world.shape[0]) < state.nacon.reshape(-1)[0]
    is_solved = (contact["type"] & CONSTRAINT) != 0
    depths = contact["includemargin"] - contact["dist"]
    # As in MJX: an address below zero is of a contact that exerts nothing, a geom of -1 is none.
    is_active = is_listed & is_solved & (depths > 0) & (contact["efc_address"][:, 0] >= 0) & (geom >= 0).all(-1)
    is_object = constants["is_object"][geom]
    sign = jnp.where(is_object[:, 0], -1.0, 1.0)
    frame = contact["frame"].reshape(-1, 3, 3)
    local = _contact_forces(contact, state.rows, is_elliptic)
    forces, moments = (
        sign[:, None] * jnp.einsum("na,nab->nb", part, frame, precision=jax.lax.Precision.HIGHEST)
        for part in (local[:, :3], local[:, 3:])
    )
    weights = jnp.where(constants["inside"], masses, 0)
    center = jnp.sum(weights[..., None] * state.xipos, 1) / jnp.sum(weights, -1, keepdims=True)
    present = is_active & selected
    bodies = constants["geom_bodies"][geom]
    place, dropped = places(world, present, jnp.abs(local[:, 0]), n_worlds, max_contacts)

    def placed(values: Array) -> Array:
        flat = jnp.zeros((n_worlds * max_contacts, *values.shape[1:]), values.dtype).at[place].set(values, mode="drop")
        return flat.reshape(n_worlds, max_contacts, *values.shape[1:])

    contacts = from_contact_arrays(
        placed(contact["pos"]),
        placed(sign[:, None] * frame[:, 0]),
        placed(jnp.where(contact["dim"] > 1, contact["friction"][:, :2].min(-1), 0)),
        placed(forces),
        placed(jnp.where(is_object[:, 0], bodies[:, 1], bodies[:, 0])),
        present=placed(present),
        torsion=placed(jnp.where(contact["dim"] > 3, contact["friction"][:, 2], 0)) if has_torsion else None,
        center=center,
    )
    touching = is_active & (is_object[:, 0] != is_object[:, 1]) & ~selected
    arms = contact["pos"] - center[jnp.clip(world, 0, n_worlds - 1)]
    others = jnp.concatenate([forces, jnp.cross(arms, forces) + moments], -1)
    other_wrench = (
        jnp.zeros((n_worlds, 6), others.dtype)
        .at[jnp.where(touching, world, n_worlds)]
        .add(jnp.where(touching[:, None], others, 0), mode="drop")
    )
    return MjxGrasp(
        grasp=contacts.grasp,
        wrench=_wrench_against_loads(state, constants, masses, center),
        depths=placed(depths),
        forces=contacts.forces,
        bodies=contacts.bodies,
        dropped=dropped,
        moments=placed(moments),
        other_wrench=other_wrench,
    )


def _contact_forces(contact: dict[str, Array], rows: Array, is_elliptic: bool) -> Array:
    """Return ``(N, 6)`` forces and moments along the axes of the contacts' frames, out of the constraints' forces."""
    address, dims = contact["efc_address"], contact["dim"]
    n_worlds, n_rows = rows.shape
    flat = rows.reshape(-1)

    def row(offset: int, is_used: Array) -> Array:
        if is_elliptic and offset >= address.shape[1]:
            return jnp.zeros(dims.shape, rows.dtype)
        at = address[:, offset] if is_elliptic else address[:, 0] + offset
        is_used = is_used & (at >= 0) & (at < n_rows) & (contact["worldid"] >= 0) & (contact["worldid"] < n_worlds)
        return jnp.where(is_used, flat[jnp.where(is_used, contact["worldid"] * n_rows + at, 0)], 0)

    if is_elliptic:
        return jnp.stack([row(i, i < dims) for i in range(6)], -1)
    # A pyramid has two edges for each axis beside the normal: their sum presses, their difference acts along the axis.
    edges = [row(i, (i < 2 * (dims - 1)) | (i == 0)) for i in range(PYRAMID_EDGES)]
    differences = [contact["friction"][:, i] * (edges[2 * i] - edges[2 * i + 1]) for i in range(5)]
    along = [jnp.where(dims > i + 1, difference, 0) for i, difference in enumerate(differences)]
    return jnp.stack([sum(edges), *along], -1)


def _wrench_against_loads(state: _State, constants: dict[str, Array], masses: Array, center: Array) -> Array:
    """Return minus the wrench of gravity and of ``xfrc_applied`` about the centres of mass ``(W, 6)``."""
    falling = masses * (1 - constants["gravcomp"])
    is_part = constants["inside"][:, None]
    # Loads of body b about c: f = m g (1 - gravcomp) + f_ext, tau = (x - c) x f + tau_ext; the hand exerts minus all.
    forces = jnp.where(is_part, falling[..., None] * constants["gravity"] + state.xfrc_applied[..., :3], 0)
    torques = jnp.cross(state.xipos - center[:, None], forces) + jnp.where(is_part, state.xfrc_applied[..., 3:], 0)
    return -jnp.concatenate([forces.sum(1), torques.sum(1)], -1)
