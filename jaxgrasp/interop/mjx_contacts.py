"""Contacts out of MJX, MuJoCo in JAX: of one state or of thousands, inside ``jit`` and ``vmap``."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxgrasp.interop.mujoco_contacts import FINGERTIP_STIFFNESS, import_mujoco
from jaxgrasp.model.arrays import Float, Int
from jaxgrasp.model.grasp import Grasp
from jaxgrasp.validation.checked import checked

if TYPE_CHECKING:
    from mujoco import mjx


class MjxGrasp(eqx.Module):
    """What may touch a body, and the engine's own answer, in world axes from the body's centre of mass.

    The n contacts are all that MJX looks for, whatever they are between; those that do not touch the body are absent.
    """

    grasp: Grasp
    """With a mask ``present``; what is absent is zero but for a unit normal."""
    wrench: Float[Array, "*batch 6"]
    """Force [N] and torque [N.m] that hold the body still against gravity and ``xfrc_applied``."""
    depths: Float[Array, "*batch n"]
    """Penetration [m] past the distance where MuJoCo starts to press."""
    forces: Float[Array, "*batch n 3"]
    """MJX's contact forces on the body [N]."""
    bodies: Int[Array, "*batch n"]
    """Id of the body that touches; -1 where none does."""
    dropped: Int[Array, "*batch"]
    """Contacts with the body that were left out beyond ``max_contacts``."""


@checked
def from_mjx(
    model: mjx.Model,
    data: mjx.Data,
    body: str | int,
    *,
    squeeze: Literal["stiffness", "normal_force"] = "stiffness",
    stiffness: float = FINGERTIP_STIFFNESS,
    max_contacts: int | None = None,
) -> MjxGrasp:
    """The contacts between a free body and everything else, as [`jaxgrasp.interop.from_mujoco`][] reads them.

    Contacts are those of the last ``mjx.forward`` or ``mjx.step``. A state's number of contacts is fixed in MJX: absent
    ones are masked. Torsional and rolling moments (``condim`` 4 and 6) are left out, here without a warning.

    Args:
        model: from ``mjx.put_model``.
        data: of one state, or of many with the same leading axes everywhere, as ``jax.vmap`` makes them.
        body: name or id of the held body, not traced; bodies welded to it count as part of it.
        squeeze: ``"stiffness"`` is eq. 6, K depth; ``"normal_force"`` is the engine's own normal force.
        stiffness: K of eq. 6 [N/m].
        max_contacts: keep no more than that many, the deepest; all where not given.

    Raises:
        ImportError: without MuJoCo's MJX.
        ValueError: for an unknown or immovable body, a stiffness that is negative or not finite, fewer than one contact
            to keep, or data of another implementation than MJX's own in JAX.
    """
    mujoco = import_mujoco("from_mjx")
    if squeeze not in ("stiffness", "normal_force"):
        raise ValueError(f"squeeze is {squeeze!r}: expected 'stiffness' or 'normal_force'")
    if not (np.isfinite(stiffness) and stiffness >= 0):
        raise ValueError(f"stiffness is {stiffness!r}: expected a finite number, zero or more")
    if max_contacts is not None and max_contacts < 1:
        raise ValueError(f"max_contacts is {max_contacts}: expected one at least")
    impl = getattr(data, "_impl", None)
    if not (hasattr(impl, "contact") and hasattr(impl, "efc_force")):
        kind = type(data if impl is None else impl).__name__
        raise ValueError(f"data is a {kind}: expected mjx.Data of MJX's own implementation in JAX")
    parts = _parts(mujoco, model, body)

    def read(data: mjx.Data) -> MjxGrasp:
        return _read(mujoco, model, data, parts, squeeze, stiffness, max_contacts)

    for _ in range(jnp.ndim(data.time)):
        read = jax.vmap(read)
    return read(data)


def _parts(mujoco: Any, model: mjx.Model, body: str | int) -> np.ndarray:
    """``(nbody,)`` booleans: the body and all that is welded to it."""
    if isinstance(body, str):
        from mujoco import mjx

        index = mjx.name2id(model, mujoco.mjtObj.mjOBJ_BODY, body)
        if index < 0:
            raise ValueError(f"body is {body!r}: the model has no body of that name")
    else:
        index = int(body)
        if not 0 <= index < model.nbody:
            raise ValueError(f"body is {body!r}: expected an id from 0 to {model.nbody - 1}")
    weld = np.asarray(model.body_weldid)
    if weld[index] == 0:
        raise ValueError(f"body is {body!r}, which cannot move: expected a body that contacts hold")
    return weld == weld[index]


def _read(
    mujoco: Any,
    model: mjx.Model,
    data: mjx.Data,
    parts: np.ndarray,
    squeeze: str,
    stiffness: float,
    most: int | None,
) -> MjxGrasp:
    """The grasp of one state."""
    contact = data._impl.contact
    bodies = jnp.asarray(model.geom_bodyid)[contact.geom]
    own = jnp.asarray(parts)[bodies]
    depths = contact.includemargin - contact.dist
    # An address below zero is of a contact that MuJoCo leaves out; -1 is also a geom that is none.
    there = (own[:, 0] != own[:, 1]) & (depths > 0) & (contact.efc_address >= 0) & (contact.geom >= 0).all(-1)
    sign = jnp.where(own[:, 0], -1.0, 1.0)
    normals = sign[:, None] * contact.frame[:, 0]
    forces = sign[:, None] * jnp.einsum("na,nab->nb", _contact_forces(mujoco, model, data), contact.frame)
    weights = jnp.where(parts, model.body_mass, 0)
    center = weights @ data.xipos / weights.sum()

    def kept(values: Array, otherwise: Array | float = 0.0) -> Array:
        return jnp.where(there.reshape(-1, *[1] * (values.ndim - 1)), values, otherwise)

    pressing = jnp.maximum(jnp.sum(forces * normals, -1), 0)
    sliding = jnp.where(contact.dim > 1, contact.friction[:, 0], 0)
    grasp = Grasp(
        kept(contact.pos - center),
        kept(normals, jnp.eye(3, dtype=normals.dtype)[2]),
        kept(sliding),
        kept(stiffness * depths if squeeze == "stiffness" else pressing),
        present=there.astype(normals.dtype),
    )
    found = MjxGrasp(
        grasp=grasp,
        wrench=_wrench_against_loads(mujoco, model, data, parts, center),
        depths=kept(depths),
        forces=kept(forces),
        bodies=jnp.where(there, jnp.where(own[:, 0], bodies[:, 1], bodies[:, 0]), -1),
        dropped=jnp.zeros((), int),
    )
    return found if most is None or most >= len(depths) else _deepest(found, there, most)


def _deepest(found: MjxGrasp, there: Array, most: int) -> MjxGrasp:
    """The deepest contacts, in the order that they had."""
    _, order = jax.lax.top_k(jnp.where(there, found.depths, -1), most)
    chosen = jnp.sort(order)
    grasp, depths, forces, bodies = jax.tree.map(
        lambda x: x[chosen], (found.grasp, found.depths, found.forces, found.bodies)
    )
    return MjxGrasp(grasp, found.wrench, depths, forces, bodies, jnp.sum(there) - jnp.sum(there[chosen]))


def _contact_forces(mujoco: Any, model: mjx.Model, data: mjx.Data) -> Array:
    """``(n, 3)`` Normal and tangential forces in the contacts' own frames, out of the forces of the constraints."""
    contact, rows = data._impl.contact, jnp.append(data._impl.efc_force, 0.0)
    address, dims = np.asarray(contact.efc_address), np.asarray(contact.dim)
    nothing = rows.shape[0] - 1

    def row(offset: int, used: np.ndarray) -> Array:
        # Where a contact has no such row, the zero at the end.
        return rows[np.where(used & (address >= 0), address + offset, nothing)]

    if int(model.opt.cone) == int(mujoco.mjtCone.mjCONE_ELLIPTIC):
        return jnp.stack([row(0, dims > 0), row(1, dims > 1), row(2, dims > 1)], -1)
    edges = [row(i, (i == 0) | (i < 2 * (dims - 1))) for i in range(10)]
    tangents = [contact.friction[:, i] * (edges[2 * i] - edges[2 * i + 1]) for i in range(2)]
    flat = jnp.asarray(dims > 1)
    return jnp.stack([sum(edges), *(jnp.where(flat, tangent, 0) for tangent in tangents)], -1)


def _wrench_against_loads(mujoco: Any, model: mjx.Model, data: mjx.Data, parts: np.ndarray, center: Array) -> Array:
    """Minus gravity's wrench and that of ``xfrc_applied``, about ``center``."""
    off = bool(int(model.opt.disableflags) & int(mujoco.mjtDisableBit.mjDSBL_GRAVITY))
    gravity = jnp.zeros(3) if off else model.opt.gravity
    falling = model.body_mass * (1 - model.body_gravcomp)
    own = jnp.asarray(parts)[:, None]
    forces = jnp.where(own, falling[:, None] * gravity + data.xfrc_applied[:, :3], 0)
    torques = jnp.where(own, jnp.cross(data.xipos - center, forces) + data.xfrc_applied[:, 3:], 0)
    return -jnp.concatenate([forces.sum(0), torques.sum(0)])
