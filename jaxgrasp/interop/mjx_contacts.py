"""Contacts out of MJX, MuJoCo in JAX: of one state or of thousands, inside ``jit`` and ``vmap``, and loads left out."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxgrasp.interop.mujoco_contacts import ANISOTROPIC, FINGERTIP_STIFFNESS, ROLLING, check_unused, import_mujoco
from jaxgrasp.interop.mujoco_loads import (
    ACTUATORS,
    APPLIED,
    CONSTRAINTS,
    LOADED,
    NEGLIGIBLE,
    PASSIVE,
    STANDARD_GRAVITY,
    equality_names,
    guiding_joints,
)
from jaxgrasp.interop.mujoco_selection import (
    ContactSelection,
    Element,
    Exclude,
    ModelTree,
    listed,
    select_contacts,
    tree_of_mjx,
)
from jaxgrasp.model.arrays import Float, Int
from jaxgrasp.model.grasp import Grasp
from jaxgrasp.validation.checked import checked

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


class MjxGrasp(eqx.Module):
    """All contacts that may touch an object, and the engine's own forces, in world axes from its centre of mass.

    The n contacts are all that MJX looks for, whatever they are between; those that do not count are absent.
    """

    grasp: Grasp
    """With a mask ``present``; what is absent is zero but for a unit normal. ``torsion`` is None where none of the n
    contacts has ``condim`` 4 or 6."""
    wrench: Float[Array, "*batch 6"]
    """Force [N] and torque [N.m] that hold the object still against gravity and ``xfrc_applied``."""
    depths: Float[Array, "*batch n"]
    """Penetration [m] past the distance where MuJoCo starts to press."""
    forces: Float[Array, "*batch n 3"]
    """MJX's contact forces on the object [N]."""
    bodies: Int[Array, "*batch n"]
    """Id of the body that touches; -1 where none does."""
    dropped: Int[Array, "*batch"]
    """Contacts that count and were left out beyond ``max_contacts``."""
    moments: Float[Array, "*batch n 3"]
    """MJX's torsional and rolling moments on the object at the contacts [N.m]."""
    other_wrench: Float[Array, "*batch 6"]
    """Force and torque that contacts left out by ``hand=`` and ``exclude=`` exert on the object now.

    ``wrench`` is for a hand that bears all loads alone; ``wrench - other_wrench`` is its share beside a table.
    """


@checked
def from_mjx(
    model: mjx.Model,
    data: mjx.Data,
    body: str | int,
    *,
    hand: Element | Sequence[Element] | None = None,
    exclude: Exclude = (),
    squeeze: Literal["stiffness", "normal_force"] = "normal_force",
    stiffness: float | None = None,
    max_contacts: int | None = None,
) -> MjxGrasp:
    """Read the contacts between an object and a hand, as [`jaxgrasp.interop.from_mujoco`][] does, from MJX.

    Contacts are those of the last ``mjx.forward`` or ``mjx.step``. A state's number of contacts is fixed in MJX: absent
    ones are masked. The object is ``body`` with all that is welded to it and all bodies below it in joints.

    Args:
        model: from ``mjx.put_model``.
        data: of one state, or of many with the same leading axes everywhere, as ``jax.vmap`` makes them.
        body: name or id of the held body, not traced.
        hand: elements whose contacts count: names of bodies or geoms, or ids of bodies, not traced; a body stands for
            its whole subtree, ``"world"`` for the world's own geoms. Contacts with everything but the object count
            where not given: a table too.
        exclude: elements whose contacts do not count, or pairs of elements, as for ``from_mujoco``.
        squeeze: ``"normal_force"`` is the engine's own normal force; ``"stiffness"`` is eq. 6, K depth.
        stiffness: K of eq. 6 [N/m], 1,000 where not given; only with ``squeeze="stiffness"``.
        max_contacts: keep no more than that many, the deepest; all where not given.

    Raises:
        ImportError: without MuJoCo's MJX.
        ValueError: for an unknown or immovable body, a name or id in ``hand`` or ``exclude`` that the model lacks or
            that cannot be meant, a stiffness that is negative, not finite or given without ``squeeze="stiffness"``,
            fewer than one contact to keep, or data of another implementation than MJX's own in JAX.

    Warns:
        UserWarning: by name of what the model may have and the answer lacks: rolling friction (``condim`` 6) of geoms
            that can touch the object, the larger of two sliding coefficients of a pair (of a model not traced), and
            joints that tie the object to other bodies. Where model and data are not traced, also loads of equality
            constraints, actuators, fluids, springs and ``qfrc_applied`` in any of the states, which are waited for;
            inside ``jit`` and ``vmap`` these are left out without a warning. Inertial loads always are.
    """
    mujoco = import_mujoco("from_mjx")
    if squeeze not in ("stiffness", "normal_force"):
        raise ValueError(f"squeeze is {squeeze!r}: expected 'stiffness' or 'normal_force'")
    check_unused(squeeze, stiffness=stiffness)
    if stiffness is None:
        stiffness = FINGERTIP_STIFFNESS
    if not (np.isfinite(stiffness) and stiffness >= 0):
        raise ValueError(f"stiffness is {stiffness!r}: expected a finite number, zero or more")
    if max_contacts is not None and max_contacts < 1:
        raise ValueError(f"max_contacts is {max_contacts}: expected 1 or more")
    impl: Any = getattr(data, "_impl", None)
    if not (hasattr(impl, "contact") and hasattr(impl, "efc_force")):
        class_name = type(data if impl is None else impl).__name__
        raise ValueError(f"data is a {class_name}: expected mjx.Data of MJX's own implementation in JAX")
    tree = tree_of_mjx(mujoco, model)
    root = tree.object_root(body)
    inside = tree.subtree(root)
    selection = select_contacts(tree, body, tree.shapes_of(inside), hand, exclude)
    left_out = _left_out(model, tree, selection, np.asarray(impl.contact.dim))
    if (guide := guiding_joints(tree, root, model)) is not None:
        left_out.append(guide)
    else:
        left_out += loads_left_out_of_states(mujoco, model, data, tree, root, inside)
    for sentence in left_out:
        warnings.warn(sentence, stacklevel=3)
    reading = _Reading(mujoco, model, inside, selection, squeeze, stiffness, max_contacts)
    read = reading.read
    for _ in range(jnp.ndim(data.time)):
        read = jax.vmap(read)
    return read(data)


def _left_out(model: mjx.Model, tree: ModelTree, selection: ContactSelection, dims: np.ndarray) -> list[str]:
    """Return a sentence for each property of the model that an MjxGrasp lacks; of contacts only ``dims`` is known."""
    pairs = np.stack([np.ravel(model.pair_geom1), np.ravel(model.pair_geom2)])
    pair_dims = np.ravel(model.pair_dim)
    cases = []
    if (dims == 6).any():
        rolling = _pairs_of_condim(model, tree, selection, 6)
        cases.append((ROLLING, np.concatenate([rolling, pairs[:, pair_dims == 6]], 1)))
    if not isinstance(model.pair_friction, jax.core.Tracer):
        coefficients = np.asarray(model.pair_friction).reshape(-1, 5)
        differ = (pair_dims > 1) & (coefficients[:, 0] != coefficients[:, 1])
        cases.append((ANISOTROPIC, pairs[:, differ]))
    sentences = []
    for text, (first, second) in cases:
        is_selected = selection.is_selected(first, second)
        outside = np.where(selection.is_object[first], second, first)[is_selected]
        if len(outside):
            sentences.append(text.format(listed([tree.link_name(shape) for shape in np.sort(outside).tolist()])))
    return sentences


def _pairs_of_condim(model: mjx.Model, tree: ModelTree, selection: ContactSelection, condim: int) -> np.ndarray:
    """Return ``(2, m)`` ids of geoms of the object and of others that MuJoCo may pair with a dimension."""
    first, second = (
        grid.ravel() for grid in np.meshgrid(np.flatnonzero(selection.is_object), np.arange(tree.n_shapes))
    )
    types, affinities = model.geom_contype, model.geom_conaffinity
    may_touch = ((types[first] & affinities[second]) | (types[second] & affinities[first])) != 0
    # The geom of the higher priority decides; of two alike the larger dimension does.
    dims, priority = model.geom_condim, model.geom_priority
    combined = np.maximum(dims[first], dims[second])
    combined = np.where(priority[first] > priority[second], dims[first], combined)
    combined = np.where(priority[first] < priority[second], dims[second], combined)
    # Explicit pairs replace those that MuJoCo makes; a body pair is excluded by (first << 16) + second, either way.
    explicit = {frozenset(pair) for pair in zip(np.ravel(model.pair_geom1), np.ravel(model.pair_geom2), strict=True)}
    bodies = tree.geom_bodies[first].astype(int), tree.geom_bodies[second].astype(int)
    low, high = np.minimum(*bodies), np.maximum(*bodies)
    signatures = np.ravel(model.exclude_signature)
    excluded = np.isin((low << 16) + high, signatures) | np.isin((high << 16) + low, signatures)
    mask = may_touch & (combined == condim) & ~excluded
    mask &= np.array([frozenset(pair) not in explicit for pair in zip(first, second, strict=True)], bool)
    return np.stack([first, second])[:, mask]


@dataclass(frozen=True)
class _Reading:
    """Options of one call, and the reading of one state."""

    mujoco: Any
    model: mjx.Model
    inside: np.ndarray
    """``(nbody,)`` booleans: bodies of the object."""
    selection: ContactSelection
    squeeze: str
    stiffness: float
    max_contacts: int | None

    def read(self, data: mjx.Data) -> MjxGrasp:
        """Return the grasp of one state."""
        contact, is_object = data._impl.contact, jnp.asarray(self.selection.is_object)
        first, second = contact.geom[:, 0], contact.geom[:, 1]
        depths = contact.includemargin - contact.dist
        # An address below zero is of a contact that MuJoCo leaves out; -1 is also a geom that is none.
        is_active = (depths > 0) & (contact.efc_address >= 0) & (contact.geom >= 0).all(-1)
        present = is_active & self.selection.is_selected(first, second, jnp)
        sign = jnp.where(is_object[first], -1.0, 1.0)
        normals = sign[:, None] * contact.frame[:, 0]
        local = _contact_forces(self.mujoco, self.model, data)
        forces, moments = (
            sign[:, None] * jnp.einsum("na,nab->nb", local_vectors, contact.frame)
            for local_vectors in (local[:, :3], local[:, 3:])
        )
        weights = jnp.where(self.inside, self.model.body_mass, 0)
        center = weights @ data.xipos / weights.sum()
        points = contact.pos - center

        def masked(values: Array, otherwise: Array | float = 0.0) -> Array:
            return jnp.where(present.reshape(-1, *[1] * (values.ndim - 1)), values, otherwise)

        others = jnp.concatenate([forces, jnp.cross(points, forces) + moments], -1)
        is_other = is_active & self.selection.is_touching(first, second, jnp) & ~present
        pressing = jnp.maximum(jnp.sum(forces * normals, -1), 0)
        dims = np.asarray(contact.dim)
        grasp = Grasp(
            masked(points),
            masked(normals, jnp.eye(3, dtype=normals.dtype)[2]),
            masked(jnp.where(dims > 1, contact.friction[:, :2].min(-1), 0)),
            masked(self.stiffness * depths if self.squeeze == "stiffness" else pressing),
            present=present.astype(normals.dtype),
            torsion=masked(jnp.where(dims > 3, contact.friction[:, 2], 0)) if (dims > 3).any() else None,
        )
        bodies = jnp.asarray(self.model.geom_bodyid)[contact.geom]
        result = MjxGrasp(
            grasp=grasp,
            wrench=_wrench_against_loads(self.mujoco, self.model, data, self.inside, center),
            depths=masked(depths),
            forces=masked(forces),
            bodies=jnp.where(present, jnp.where(is_object[first], bodies[:, 1], bodies[:, 0]), -1),
            dropped=jnp.zeros((), int),
            moments=masked(moments),
            other_wrench=jnp.where(is_other[:, None], others, 0).sum(0),
        )
        max_contacts = self.max_contacts
        return (
            result if max_contacts is None or max_contacts >= len(depths) else _deepest(result, present, max_contacts)
        )


def _deepest(result: MjxGrasp, present: Array, max_contacts: int) -> MjxGrasp:
    """Return the deepest contacts, in the order that they had."""
    _, order = jax.lax.top_k(jnp.where(present, result.depths, -1), max_contacts)
    chosen = jnp.sort(order)
    by_contact = (result.grasp, result.depths, result.forces, result.bodies, result.moments)
    grasp, depths, forces, bodies, moments = jax.tree.map(lambda x: x[chosen], by_contact)
    dropped = jnp.sum(present) - jnp.sum(present[chosen])
    return MjxGrasp(grasp, result.wrench, depths, forces, bodies, dropped, moments, result.other_wrench)


def _contact_forces(mujoco: Any, model: mjx.Model, data: mjx.Data) -> Array:
    """Return ``(n, 6)`` forces and moments along the axes of the contacts' frames, out of the constraints' forces."""
    contact, rows = data._impl.contact, jnp.append(data._impl.efc_force, 0.0)
    address, dims = np.asarray(contact.efc_address), np.asarray(contact.dim)
    nothing = rows.shape[0] - 1

    def row(offset: int, used: np.ndarray) -> Array:
        # A contact without such a row takes the zero at the end.
        return rows[np.where(used & (address >= 0), address + offset, nothing)]

    if int(model.opt.cone) == int(mujoco.mjtCone.mjCONE_ELLIPTIC):
        return jnp.stack([row(i, i < dims) for i in range(6)], -1)
    # A pyramid has two edges for each axis beside the normal: their sum presses, their difference acts along the axis.
    edges = [row(i, (i == 0) | (i < 2 * (dims - 1))) for i in range(10)]
    differences = [contact.friction[:, i] * (edges[2 * i] - edges[2 * i + 1]) for i in range(5)]
    along = [jnp.where(dims > i + 1, difference, 0) for i, difference in enumerate(differences)]
    return jnp.stack([sum(edges), *along], -1)


def _wrench_against_loads(mujoco: Any, model: mjx.Model, data: mjx.Data, parts: np.ndarray, center: Array) -> Array:
    """Return minus gravity's wrench and that of ``xfrc_applied``, about ``center``."""
    off = bool(int(model.opt.disableflags) & int(mujoco.mjtDisableBit.mjDSBL_GRAVITY))
    gravity = jnp.zeros(3) if off else model.opt.gravity
    falling = model.body_mass * (1 - model.body_gravcomp)
    is_part = jnp.asarray(parts)[:, None]
    # Loads of body b about c: f = m g (1 - gravcomp) + f_ext, tau = (x - c) x f + tau_ext; the hand exerts minus all.
    forces = jnp.where(is_part, falling[:, None] * gravity + data.xfrc_applied[:, :3], 0)
    torques = jnp.where(is_part, jnp.cross(data.xipos - center, forces) + data.xfrc_applied[:, 3:], 0)
    return -jnp.concatenate([forces.sum(0), torques.sum(0)])
