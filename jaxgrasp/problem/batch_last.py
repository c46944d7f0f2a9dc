"""Batch-last, cleaned data of many problems; ``scaling.py`` centres, scales and turns them.

The public arrays are batch-first, ``(B, n, 3)``. Kernels work on components of shape ``(n, B)`` for what
belongs to contacts and ``(1, B)`` for what belongs to problems, so that the compiler vectorises over
problems. A grasp that many wrenches share has B = 1 and broadcasts.
"""

from typing import TYPE_CHECKING, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jax import Array, lax

from jaxgrasp.model.arrays import AnyArray, Float, Int
from jaxgrasp.numerics import vec3
from jaxgrasp.numerics.fused_cpu_kernel import fused_cpu_kernel
from jaxgrasp.numerics.vec3 import Vec3
from jaxgrasp.problem.contact_vec import ContactVec
from jaxgrasp.problem.friction_cone import Cone
from jaxgrasp.problem.tolerances import tolerances

if TYPE_CHECKING:
    InBatch = Array
else:
    # Kernels are given JAX's arrays; on the way there, before a batch is cut into pieces, they may be NumPy's.
    InBatch = AnyArray


class TorqueBounds(eqx.Module):
    """Bounds of the joint torques of a flat batch."""

    torque_map: Float[InBatch, "#B n c j"]
    """Torques for each unit of a contact's force, and moment where c = 4, in the user's axes [m, 1]."""
    torque_max: Float[InBatch, "#B j"]
    """Largest torques [N.m]; infinite where a joint has none."""


class ProblemBatch(eqx.Module):
    """A flat batch of problems; the grasp's leading axis may be 1 when all wrenches share it."""

    points: Float[InBatch, "#B n 3"]
    normals: Float[InBatch, "#B n 3"]
    friction: Float[InBatch, "#B n"]
    squeeze: Float[InBatch, "#B n"]
    present: Float[InBatch, "#B n"] | None
    weights: Float[InBatch, "#B n"]
    """Sharing weights k."""
    wrench: Float[InBatch, "B 6"]
    free: Float[InBatch, "#B 6 k"] | None = None
    """Twists along which a guide lets the object move; None for an object that no guide holds."""
    start: Float[InBatch, "B 6"] | None = None
    """A multiplier from which Newton's method starts; None for the closed form's."""
    torsion: Float[InBatch, "#B n"] | None = None
    """Torsional friction; None where all contacts are hard fingers."""
    normal_min: Float[InBatch, "#B n"] | None = None
    normal_max: Float[InBatch, "#B n"] | None = None
    torque_bounds: TorqueBounds | None = None
    count: Int[InBatch, ""] | None = None
    """How many problems there are, the first of those that the arrays hold; None for as many."""

    @property
    def size(self) -> int:
        return self.wrench.shape[0]


class ContactData(NamedTuple):
    """Contacts ``(n, B)`` and the required force and torque ``(1, B)``, one problem in each place of the last axis."""

    points: Vec3
    normals: Vec3
    friction: Array
    squeeze: Array
    weights: Array
    force: Vec3
    torque: Vec3
    normal_cost: Array | None = None
    """What a unit of normal force costs, in questions of how little is enough; None where it costs nothing."""
    spin_radius: Array | None = None
    """gamma / mu of soft fingers [m]: the moment for each unit of ``ContactVec.spin``; 0 for hard ones, None where all
    are hard."""
    normal_min: Array | None = None
    """Least normal force; None where none is bounded, and so for ``normal_max``."""
    normal_max: Array | None = None

    @property
    def cone(self) -> Cone:
        """The friction cones, with bounds of the normal forces."""
        return Cone(self.normals, self.friction, self.normal_min, self.normal_max)


def squeezing_forces(data: ContactData) -> ContactVec:
    """Return the squeezing forces s a."""
    return ContactVec(
        vec3.scale(data.squeeze, data.normals), None if data.spin_radius is None else 0 * data.spin_radius
    )


def to_batch_last_unfused(problem: ProblemBatch) -> tuple[ContactData, Array]:
    """Return the data batch-last, and a mask of the problems whose data can be used.

    Absent contacts and unusable problems are replaced by contacts that carry nothing, so that no NaN enters
    the arithmetic, in values or in derivatives. Normals are brought to unit length.
    """
    points, normals = _components(problem.points), _components(problem.normals)
    friction, squeeze, weights = problem.friction.T, problem.squeeze.T, problem.weights.T
    wrench = problem.wrench.T
    size2 = vec3.dot(normals, normals)
    largest = tolerances(points.x.dtype).largest
    # One sum meets a NaN, or what is too large to be squared, in any of its terms.
    size = vec3.taxicab(points) + size2 + jnp.abs(friction) + jnp.abs(squeeze) + jnp.abs(weights)
    # The square of a normal keeps its digits only above this.
    info = jnp.finfo(size2.dtype)
    is_usable = (
        (size2 >= info.tiny / info.eps) & (friction >= 0) & (squeeze >= 0) & (weights >= 0) & ~_is_subnormal(weights)
    )
    torsion, normal_min, normal_max = (
        None if x is None else x.T for x in (problem.torsion, problem.normal_min, problem.normal_max)
    )
    if torsion is not None:
        # The spin radius torsion / friction is squared too; a processor may take a subnormal friction for zero.
        is_finite_radius = ((friction == 0) | (torsion <= largest * friction)) & ~_is_subnormal(friction)
        size, is_usable = size + jnp.abs(torsion), is_usable & (torsion >= 0) & is_finite_radius
    if normal_min is not None:
        size, is_usable = size + jnp.abs(normal_min), is_usable & (normal_min >= 0)
    if normal_max is not None:
        is_usable = is_usable & (normal_max >= (0 if normal_min is None else normal_min))
    is_usable = is_usable & (size <= largest)
    is_present = None
    if problem.present is not None:
        present = problem.present.T
        is_present = present > 0.5
        is_usable = (is_usable | ~is_present) & ~jnp.isnan(present)
    all_usable = vec3.all_contacts(is_usable)
    valid = all_usable & (sum(jnp.abs(wrench[i : i + 1]) for i in range(6)) <= largest)
    if problem.free is not None:
        valid = valid & (jnp.sum(jnp.abs(problem.free), (1, 2))[None] <= largest)
    use = jnp.broadcast_to(all_usable, is_usable.shape) if is_present is None else is_present & all_usable

    def keep(array: Array) -> Array:
        return jnp.where(use, array, 0)

    kept_normals = Vec3(*map(keep, normals))
    # From what was kept, so that no derivative meets what was not.
    inverse = 1 / jnp.sqrt(jnp.where(use, vec3.dot(kept_normals, kept_normals), 1))
    normal_min = None if normal_min is None else keep(normal_min)
    normal_max = None if normal_max is None else jnp.where(use, normal_max, jnp.inf)
    data = ContactData(
        points=Vec3(*map(keep, points)),
        normals=vec3.scale(inverse, kept_normals),
        friction=keep(friction),
        squeeze=_allowed(keep(squeeze), keep(weights), normal_min, normal_max),
        weights=keep(weights),
        force=Vec3(*(jnp.where(valid, wrench[i : i + 1], 0) for i in range(3))),
        torque=Vec3(*(jnp.where(valid, wrench[i : i + 1], 0) for i in range(3, 6))),
        spin_radius=None if torsion is None else vec3.safe_divide(keep(torsion), keep(friction)),
        normal_min=normal_min,
        normal_max=normal_max,
    )
    return data, valid


to_batch_last = fused_cpu_kernel(to_batch_last_unfused)
"""As one fused kernel; callers must use every result, since XLA aborts where one is unused."""


def without_squeeze(data: ContactData, chosen: Array) -> ContactData:
    """Give each contact that can move a weight of one and no squeeze, where the scalar ``chosen`` is true.

    The allowed forces stay the same.
    """
    changed = chosen & (data.weights > 0)
    cost = data.normal_cost
    return data._replace(
        squeeze=jnp.where(changed, 0, data.squeeze),
        weights=jnp.where(changed, 1, data.weights),
        normal_cost=None if cost is None else jnp.where(changed, 0, cost),
    )


def _is_subnormal(array: Array) -> Array:
    """Return a mask of subnormal numbers, which a processor may take for zero; read from their bits for that reason.

    A weight of zero is a contact that cannot move, which is another problem than one of the smallest weight.
    """
    info = jnp.finfo(array.dtype)
    bits = lax.bitcast_convert_type(array, jnp.dtype(f"uint{info.bits}"))
    return (bits > 0) & (bits < 1 << info.nmant)


def _allowed(squeeze: Array, weights: Array, normal_min: Array | None, normal_max: Array | None) -> Array:
    """Bring the squeeze of contacts that cannot move, and so hold it, within the bounds of the normal force."""
    for bound, cut in ((normal_min, jnp.maximum), (normal_max, jnp.minimum)):
        if bound is not None:
            squeeze = jnp.where(weights > 0, squeeze, cut(squeeze, bound))
    return squeeze


def _components(array: Array) -> Vec3:
    return Vec3(*jnp.transpose(array, (2, 1, 0)))
