"""What one contact may exert: projection on it, the projection's derivative, and its support.

A force f is allowed when |f - (f.a) a| <= mu f.a (eqs. 2 and 3), where of soft fingers the moment about the normal
counts as one more tangential component; and, where normal forces are bounded, when f.a lies within its bounds.
Everything is written with the vectors themselves, so that no tangent basis has to be chosen. A richer contact joins
the solver by giving the same functions.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from jaxgrasp.numerics import vec3
from jaxgrasp.numerics.vec3 import Vec3
from jaxgrasp.problem import contact_vec
from jaxgrasp.problem.contact_vec import ContactVec


class Cone(NamedTuple):
    """Coulomb's cone of each contact, perhaps cut off below and above."""

    normal: Vec3
    friction: Array
    normal_min: Array | None = None
    """Least normal force; None where none is bounded, and so for ``normal_max``."""
    normal_max: Array | None = None


class NormalBound(NamedTuple):
    """Mask of the active bounds on the normal force, and the normal force of the projection there."""

    active: Array
    normal_force: Array
    """Normal component of the projection, where a bound is active."""


class ConeDecomposition(NamedTuple):
    """A vector's normal and tangential parts, and whether it lies inside the cone or in its polar."""

    along: Array
    """Component along the normal."""
    tangent: ContactVec
    """Unit tangential direction; zero where there is none."""
    size: Array
    """Length of the tangential part."""
    inside: Array
    polar: Array
    """Whether the vector lies in the polar cone, whose projection is the apex."""
    bound: NormalBound | None = None
    """None where no normal force is bounded."""


def decompose(u: ContactVec, cone: Cone) -> ConeDecomposition:
    along, across = _along_and_across(u, cone)
    square = contact_vec.dot(across, across)
    size = vec3.safe_sqrt(square)
    tangent = contact_vec.of_components([vec3.safe_divide(c, size) for c in contact_vec.components(across)])
    is_bounded = cone.normal_min is not None or cone.normal_max is not None
    if is_bounded:
        # Beside a squeeze far beyond a bound, rounding leaves a normal part that would move forces past the bound.
        _, tangent = _along_and_across(tangent, cone)
    # The polar cone first: without friction a pull straight along the normal would pass for inside.
    polar = cone.friction * size < -along
    # Without friction the cone is a ray, which has no inside: what lies on it may move along it alone.
    limit = cone.friction * along
    inside = (along >= 0) & (square <= limit * limit) & (cone.friction > 0)
    split = ConeDecomposition(along, tangent, size, inside, polar)
    if not is_bounded:
        return split
    free = jnp.where(inside, along, jnp.where(polar, 0, _edge_normal_force(cone, split)))
    normal_force = _clip(free, cone)
    active = normal_force != free
    # What a bound moves is neither in the cone nor in its polar: it lies on a disc.
    return split._replace(inside=inside & ~active, polar=polar & ~active, bound=NormalBound(active, normal_force))


def _along_and_across(u: ContactVec, cone: Cone) -> tuple[Array, ContactVec]:
    """Split a force into its component along the normal and the rest."""
    along = vec3.dot(u.linear, cone.normal)
    return along, ContactVec(vec3.sub(u.linear, vec3.scale(along, cone.normal)), u.spin)


def _edge_normal_force(cone: Cone, split: ConeDecomposition) -> Array:
    """Return the normal component of the projection on the cone's edge."""
    # (u_a + mu |u_t|) / (1 + mu^2)
    rise = split.along + cone.friction * split.size
    # Beside the polar cone the compiler may round this below zero, and the force would pull.
    return jnp.where(rise < 0, 0, rise) / (1 + cone.friction**2)


def _clip(normal_force: Array, cone: Cone) -> Array:
    normal_force = normal_force if cone.normal_min is None else jnp.maximum(normal_force, cone.normal_min)
    return normal_force if cone.normal_max is None else jnp.minimum(normal_force, cone.normal_max)


def contains(u: ContactVec, cone: Cone) -> Array:
    """Return a mask of the forces ``u`` that are allowed, rounding aside."""
    along, across = _along_and_across(u, cone)
    slack = 8 * jnp.finfo(along.dtype).eps
    limit = cone.friction * along + slack * (1 + cone.friction) * jnp.abs(along)
    allowed = (along >= 0) & (contact_vec.dot(across, across) <= limit * limit)
    if cone.normal_min is not None:
        allowed = allowed & (along >= (1 - slack) * cone.normal_min)
    return allowed if cone.normal_max is None else allowed & (along <= (1 + slack) * cone.normal_max)


def project(u: ContactVec, cone: Cone, split: ConeDecomposition) -> ContactVec:
    """Return the closest allowed force."""
    zero = contact_vec.scale(jnp.zeros_like(split.along), u)
    # p (a + mu u_t / |u_t|)
    on_edge = contact_vec.scale(_edge_normal_force(cone, split), edge_force(cone, split))
    on_cone = contact_vec.where(split.inside, u, contact_vec.where(split.polar, zero, on_edge))
    if split.bound is None:
        return on_cone
    # Where the cone's closest force is beyond a bound, the closest of all lies on that, a disc.
    active, normal_force = split.bound
    reach = jnp.minimum(split.size, cone.friction * normal_force)
    on_disc = contact_vec.add(contact_vec.along(normal_force, cone.normal, u), contact_vec.scale(reach, split.tangent))
    return contact_vec.where(active, on_disc, on_cone)


def edge_force(cone: Cone, split: ConeDecomposition) -> ContactVec:
    """Return the closest force of unit normal component on the cone's edge."""
    normal = contact_vec.along(jnp.ones_like(split.along), cone.normal, split.tangent)
    return contact_vec.add(normal, contact_vec.scale(cone.friction, split.tangent))


def derivative(cone: Cone, split: ConeDecomposition) -> list[list[Array]]:
    """Return the projection's derivative by ``u``, a symmetric matrix as lower triangle: 3x3, for soft fingers 4x4.

    On the cone's surface, at its apex and at its bounds, where the projection has kinks, it is the limit from one side:
    an element of the generalised Jacobian (Clarke).
    """
    on_edge = jnp.logical_not(split.inside | split.polar)
    # The curvature of the cone: moving u across it turns the edge that carries the projection.
    turning = jnp.where(on_edge, vec3.safe_divide(cone.friction * _edge_normal_force(cone, split), split.size), 0)
    along_edge = jnp.where(on_edge, 1 / (1 + cone.friction**2), 0)
    isotropic = jnp.where(split.inside, 1, turning)
    t = contact_vec.components(split.tangent)
    a = _as_long(cone.normal, t)
    # On the edge e e^T / (1 + mu^2) + (mu p / |u_t|) (I - a a^T - t t^T), with e = a + mu t.
    edge = contact_vec.components(edge_force(cone, split))
    matrix = []
    for i in range(len(t)):
        row = [along_edge * edge[i] * edge[j] - turning * (a[i] * a[j] + t[i] * t[j]) for j in range(i + 1)]
        row[i] = row[i] + isotropic
        matrix.append(row)
    if split.bound is None:
        return matrix
    held = _disc_derivative(cone, split, split.bound.normal_force)
    return [[jnp.where(split.bound.active, p, q) for p, q in zip(*rows, strict=True)] for rows in zip(held, matrix)]


def _disc_derivative(cone: Cone, split: ConeDecomposition, normal_force: Array) -> list[list[Array]]:
    """Return the derivative of the projection on a disc across the cone: tangential, or turning along its rim."""
    flat = split.size <= cone.friction * normal_force
    turning = jnp.where(flat, 0, vec3.safe_divide(cone.friction * normal_force, split.size))
    isotropic = jnp.where(flat, 1, turning)
    t = contact_vec.components(split.tangent)
    a = _as_long(cone.normal, t)
    rows = []
    for i in range(len(t)):
        # I - a a^T inside the disc, (mu p / |u_t|) (I - a a^T - t t^T) at its rim.
        row = [-isotropic * a[i] * a[j] - turning * t[i] * t[j] for j in range(i + 1)]
        row[i] = row[i] + isotropic
        rows.append(row)
    return rows


def _as_long(normal: Vec3, like: tuple[Array, ...]) -> tuple[Array, ...]:
    """Return the normal's components, with a zero for the moment about it where forces have one."""
    return (*normal, *[jnp.zeros_like(c) for c in like[3:]])


def work_per_normal_force(direction: ContactVec, cone: Cone) -> Array:
    """Work along ``direction`` of the force that does most, of those of unit normal component."""
    along, across = _along_and_across(direction, cone)
    # v_a + mu |v_t|
    return along + cone.friction * contact_vec.norm(across)


def support_function(push: Array, cone: Cone) -> tuple[Array, Array]:
    """Return the largest work that each contact does along a direction, from its ``work_per_normal_force``.

    The first result is the work for each unit of normal force, where that is not bounded; the second the whole work,
    where it is. Each is 0 where the other holds.
    """
    if cone.normal_min is None and cone.normal_max is None:
        return push, jnp.zeros_like(push)
    normal_min = 0 if cone.normal_min is None else cone.normal_min
    if cone.normal_max is None:
        return push, jnp.where(push > 0, 0, push * normal_min)
    ends = jnp.isfinite(cone.normal_max)
    bounded = jnp.where(push > 0, jnp.where(ends, push * jnp.where(ends, cone.normal_max, 0), 0), push * normal_min)
    return jnp.where(ends, 0, push), bounded


def largest_bound(cone: Cone) -> Array:
    """Return the finite bound of each contact's normal force by which its work is bounded; 0 where there is none."""
    normal_min = jnp.zeros_like(cone.friction) if cone.normal_min is None else cone.normal_min
    if cone.normal_max is None:
        return normal_min
    return jnp.where(jnp.isfinite(cone.normal_max), cone.normal_max, normal_min)
