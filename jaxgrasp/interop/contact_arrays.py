"""Grasps from the contact arrays of any simulator: one world or thousands, without a copy through the host."""

from functools import partial
from typing import Any, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxgrasp.model.arrays import Float, Int
from jaxgrasp.model.grasp import Grasp
from jaxgrasp.validation.checked import checked

Direction = Literal["inward", "outward", "by_force"]
PLAIN = (jax.Array, np.ndarray, np.generic)


class ContactGrasps(eqx.Module):
    """Contacts of one world ``(n,)`` or of many ``(*worlds, n)``; absent ones are zero but for a unit normal."""

    grasp: Grasp
    """With a mask ``present``, about ``center``."""
    forces: Float[Array, "*batch n 3"]
    """The simulator's forces on the object [N]: of normal forces those along the normals; zero where not given."""
    bodies: Int[Array, "*batch n"]
    """``body`` of each contact; -1 where absent, or where not given."""
    dropped: Int[Array, "*batch"]
    """Contacts of each world that were left out beyond ``max_contacts``."""


@checked
def from_contact_arrays(
    points: Any,
    normals: Any,
    friction: Any,
    forces: Any = None,
    body: Any = None,
    *,
    direction: Direction = "inward",
    world: Any = None,
    n_worlds: int | None = None,
    max_contacts: int | None = None,
    present: Any = None,
    squeeze: Any = None,
    torsion: Any = None,
    center: Any = None,
) -> ContactGrasps:
    """Build a padded batch of grasps from plain arrays of contacts.

    Arrays are NumPy's, JAX's, or any with ``__dlpack__`` (PyTorch, Warp, CuPy), which are read where they are. Either
    they are padded, ``(*worlds, n, ...)`` with a mask ``present``; or a list of all worlds' contacts, ``(N, ...)`` with
    the index of the ``world`` of each, as simulators on a GPU keep them. Works under ``jit`` where ``n_worlds`` and
    ``max_contacts`` are given.

    Args:
        points: of the contacts, all in one frame of their world ``(..., n, 3)`` [m].
        normals: of the surface, of any length but zero ``(..., n, 3)``.
        friction: Coulomb coefficients, one for all or ``(..., n)``. Simulators combine those of two surfaces: give the
            result.
        forces: what the simulator exerts on the object at each contact, ``(..., n, 3)`` [N], or normal forces alone
            ``(..., n)``; they are the intended normal forces where ``squeeze`` is not given.
        body: number of what touches, of each contact ``(..., n)``, for the caller's use.
        direction: of the normals: ``"inward"``, into the object, ``"outward"``, out of it, or ``"by_force"``: either
            way, turned so that the forces ``(..., n, 3)`` press.
        world: index of each contact's world ``(N,)``; contacts of other indices than 0 to ``n_worlds - 1`` are absent.
        n_worlds: how many there are; by default one more than the largest index.
        max_contacts: places of each world in a list; the contacts of largest normal force stay, in their order. By
            default as many as the fullest world has.
        present: 1 or True where a contact exists ``(..., n)``; all do where not given.
        squeeze: intended normal forces, one for all or ``(..., n)`` [N].
        torsion: torsional friction of soft fingers, one for all or ``(..., n)`` [m].
        center: where the object's wrench is taken about, such as its centre of mass, ``(..., 3)`` or ``(n_worlds, 3)``
            [m]; the origin of the frame where not given.

    Raises:
        ValueError: for arrays of other shapes, neither forces nor squeeze, ``"by_force"`` without forces of three
            components, ``world`` inside ``jit`` without ``n_worlds`` and ``max_contacts``, or these without ``world``.

    Example:
        Three contacts of two worlds, in a list; normals as they are out of the first body of each pair:

        >>> import numpy as np
        >>> from jaxgrasp.interop import from_contact_arrays
        >>> points = np.array([[-0.1, 0, 0], [0.1, 0, 0], [-0.1, 0, 0]], np.float32)
        >>> outward = np.array([[-1, 0, 0], [1, 0, 0], [-1, 0, 0]], np.float32)
        >>> contacts = from_contact_arrays(
        ...     points, outward, 0.5, np.full(3, 4, np.float32), direction="outward", world=np.array([1, 1, 0])
        ... )
        >>> contacts.grasp.present.tolist(), contacts.grasp.normals[1, :, 0].tolist()
        ([[1.0, 0.0], [1.0, 1.0]], [1.0, -1.0])
    """
    points, normals = as_jax("points", points), as_jax("normals", normals)
    if points.ndim < 2 or points.shape[-1] != 3:
        raise ValueError(f"points has shape {points.shape}: expected (..., n, 3)")
    if normals.shape != points.shape:
        raise ValueError(f"normals has shape {normals.shape}: expected that of points, {points.shape}")
    shape, dtype = points.shape[:-1], jnp.result_type(points, normals)
    if world is not None and len(shape) != 1:
        raise ValueError(f"points has shape {points.shape}: expected (N, 3), a list of contacts, with world")
    if world is None and not (n_worlds is None and max_contacts is None):
        raise ValueError("n_worlds and max_contacts belong to a list of contacts: give world, or leave them out")
    forces, is_vector = _forces(forces, shape)
    if direction == "by_force" and not is_vector:
        raise ValueError("direction is 'by_force', but forces are no vectors: expected forces (..., n, 3)")
    if forces is None and squeeze is None:
        raise ValueError("forces and squeeze are both None: give either, since a grasp needs normal forces")
    columns = {
        "points": points.astype(dtype),
        "normals": normals.astype(dtype),
        "friction": _per_contact("friction", friction, shape, dtype),
        "forces": jnp.zeros(shape, dtype) if forces is None else forces.astype(dtype),
        "bodies": jnp.full(shape, -1) if body is None else _per_contact("body", body, shape, None),
        "present": jnp.ones(shape, bool) if present is None else _per_contact("present", present, shape, None) > 0.5,
        "squeeze": None if squeeze is None else _per_contact("squeeze", squeeze, shape, dtype),
        "torsion": None if torsion is None else _per_contact("torsion", torsion, shape, dtype),
    }
    center = None if center is None else as_jax("center", center).astype(dtype)
    if world is None:
        return _padded(columns, center, None, direction)
    index = _per_contact("world", world, shape, None)
    n_worlds, max_contacts = _sizes(index, columns["present"], n_worlds, max_contacts)
    return _gathered(columns, center, index, direction=direction, n_worlds=n_worlds, max_contacts=max_contacts)


def as_jax(name: str, array: Any) -> Array:
    """Return an array of JAX that shares the memory of another library's array where that is possible."""
    if isinstance(array, (*PLAIN, int, float, list, tuple)):
        return jnp.asarray(array)
    if not hasattr(array, "__dlpack__"):
        raise ValueError(f"{name} is a {type(array).__name__}: expected an array of NumPy or JAX, or with __dlpack__")
    if getattr(array, "requires_grad", False) and hasattr(array, "detach"):
        array = array.detach()
    return jax.dlpack.from_dlpack(array)


def _per_contact(name: str, values: Any, shape: tuple[int, ...], dtype: Any) -> Array:
    array = as_jax(name, values)
    try:
        return jnp.broadcast_to(array if dtype is None else array.astype(dtype), shape)
    except ValueError:
        raise ValueError(f"{name} has shape {array.shape}: expected one number, or {shape}") from None


def _forces(forces: Any, shape: tuple[int, ...]) -> tuple[Array | None, bool]:
    """Return the forces, and whether they are vectors."""
    if forces is None:
        return None, False
    array = as_jax("forces", forces)
    if array.shape not in (shape, (*shape, 3)):
        raise ValueError(f"forces has shape {array.shape}: expected {(*shape, 3)}, or {shape} for normal forces")
    return array, array.shape == (*shape, 3)


def _sizes(world: Array, present: Array, n_worlds: int | None, max_contacts: int | None) -> tuple[int, int]:
    """Return the numbers of worlds and of places in each, which the data say where the caller does not."""
    if n_worlds is None or max_contacts is None:
        if isinstance(world, jax.core.Tracer) or isinstance(present, jax.core.Tracer):
            raise ValueError("world is traced: give n_worlds and max_contacts, since shapes must be known inside jit")
        used = np.asarray(world)[np.asarray(present)]
        used = used[used >= 0]
        n_worlds = int(used.max(initial=0)) + 1 if n_worlds is None else n_worlds
        if max_contacts is None:
            max_contacts = max(1, int(np.bincount(used[used < n_worlds], minlength=1).max(initial=0)))
    for name, size in (("n_worlds", n_worlds), ("max_contacts", max_contacts)):
        if size < 1:
            raise ValueError(f"{name} is {size}: expected 1 or more")
    return n_worlds, max_contacts


@partial(jax.jit, static_argnames=("direction", "n_worlds", "max_contacts"))
def _gathered(
    columns: dict[str, Any],
    center: Array | None,
    world: Array,
    *,
    direction: str,
    n_worlds: int,
    max_contacts: int,
) -> ContactGrasps:
    """Give each contact of a list a place in its world."""
    place, dropped = places(world, columns["present"], _pressing(columns), n_worlds, max_contacts)

    def placed(column: Array | None) -> Array | None:
        if column is None:
            return None
        flat = jnp.zeros((n_worlds * max_contacts, *column.shape[1:]), column.dtype).at[place].set(column, mode="drop")
        return flat.reshape(n_worlds, max_contacts, *column.shape[1:])

    return _padded({name: placed(column) for name, column in columns.items()}, center, dropped, direction)


def places(world: Array, present: Array, pressing: Array, n_worlds: int, max_contacts: int) -> tuple[Array, Array]:
    """Return the place of each contact in the flat batch of ``n_worlds * max_contacts``, and how many find none.

    Those that press most have a place, in the order of the list. Others, and absent ones, are placed past the end.
    """
    is_valid = present & (world >= 0) & (world < n_worlds)
    count = jnp.zeros(n_worlds + 1, int).at[jnp.where(is_valid, world, n_worlds)].add(1)[:n_worlds]

    def rank(is_ranked: Array, *keys: Array) -> Array:
        """Return the rank of each contact in its world, in ascending order of the keys, then of the list."""
        row = jnp.where(is_ranked, world, n_worlds)
        counts = jnp.zeros(n_worlds + 1, int).at[row].add(1)
        order = jnp.lexsort((*keys, row)) if keys else jnp.argsort(row, stable=True)
        position = jnp.zeros_like(order).at[order].set(jnp.arange(order.shape[0], dtype=order.dtype))
        return position - (jnp.cumsum(counts) - counts)[row]

    # Sorting by force takes most of the time, and most often all contacts have a place.
    is_kept = jax.lax.cond(
        jnp.any(count > max_contacts),
        lambda: is_valid & (rank(is_valid, -pressing) < max_contacts),
        lambda: is_valid,
    )
    place = jnp.where(is_kept, world * max_contacts + rank(is_kept), n_worlds * max_contacts)
    return place, jnp.maximum(count - max_contacts, 0)


def _pressing(columns: dict[str, Any]) -> Array:
    """Return the normal force of each contact without regard to its sign."""
    forces, normals, squeeze = columns["forces"], columns["normals"], columns["squeeze"]
    if forces.ndim == normals.ndim:
        return jnp.abs(jnp.sum(forces * normals, -1)) / jnp.linalg.norm(normals, axis=-1)
    return jnp.abs(forces) if squeeze is None else squeeze


def _padded(columns: dict[str, Any], center: Array | None, dropped: Array | None, direction: str) -> ContactGrasps:
    present, normals, forces = columns["present"], columns["normals"], columns["forces"]
    is_vector = forces.ndim == normals.ndim
    normals = jnp.where(present[..., None], normals, jnp.eye(3, dtype=normals.dtype)[2])
    normals = normals / jnp.linalg.norm(normals, axis=-1, keepdims=True)
    forces = jnp.where(present[..., None] if is_vector else present, forces, 0)
    if direction == "outward":
        normals = jnp.where(present[..., None], -normals, normals)
    elif direction == "by_force":
        normals = jnp.where(jnp.sum(forces * normals, -1, keepdims=True) < 0, -normals, normals)
    along = jnp.sum(forces * normals, -1) if is_vector else forces
    points = columns["points"] if center is None else columns["points"] - center[..., None, :]

    def masked(values: Array) -> Array:
        return jnp.where(present.reshape(*present.shape, *[1] * (values.ndim - present.ndim)), values, 0)

    grasp = Grasp(
        masked(points),
        normals,
        masked(columns["friction"]),
        masked(jnp.maximum(along, 0) if columns["squeeze"] is None else columns["squeeze"]),
        present=present.astype(normals.dtype),
        torsion=None if columns["torsion"] is None else masked(columns["torsion"]),
    )
    return ContactGrasps(
        grasp=grasp,
        forces=forces if is_vector else forces[..., None] * normals,
        bodies=jnp.where(present, columns["bodies"], -1),
        dropped=jnp.zeros(present.shape[:-1], int) if dropped is None else dropped,
    )
