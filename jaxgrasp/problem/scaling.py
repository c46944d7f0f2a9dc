"""Scaling: into a problem's own frame and units, in which everything is of order one, and back.

About the weighted centroid of the contacts, G W G^T falls into a scalar and a 3x3 inertia matrix, and nothing is lost
when the frame lies far away. Lengths are then divided by the weighted radius, weights by their sum, forces by the
load, so that everything is of order one whatever the units.

Sums of products with an error of one rounding of the result, not of the terms (Dekker 1971, Knuth's two-sum).

A sum or product in floating point comes with its own rounding error, computed exactly; carrying those errors along
doubles the precision. Compilers may contract a product and a sum into one rounding, which would belie the errors:
barriers keep them apart.
"""

from functools import reduce
from typing import NamedTuple

import jax.numpy as jnp
from jax import Array, lax

from jaxgrasp.numerics import ldl, vec3
from jaxgrasp.numerics.fused_cpu_kernel import fused_cpu_kernel
from jaxgrasp.numerics.vec3 import Vec3
from jaxgrasp.problem import spatial
from jaxgrasp.problem.batch_last import ContactData
from jaxgrasp.problem.spatial import SpatialVec
from jaxgrasp.problem.tolerances import tolerances


def minus_cross(t: Vec3, a: Vec3, b: Vec3) -> Vec3:
    """t - a x b, where the difference may be far smaller than its terms."""
    start, left, right = (jnp.stack(jnp.broadcast_arrays(*component)) for component in (t, a, b))
    p, p_error = _product(_rolled(left, 1), _rolled(right, 2))
    m, m_error = _product(_rolled(left, 2), _rolled(right, 1))
    first, first_error = _sum(start, -p)
    second, second_error = _sum(first, m)
    return Vec3(*(second + (first_error + second_error + (m_error - p_error))))


def _rolled(array: Array, steps: int) -> Array:
    """Return the component ``steps`` after each."""
    return jnp.concatenate([array[steps:], array[:steps]])


def _sum(a: Array, b: Array) -> tuple[Array, Array]:
    total = a + b
    of_b = total - a
    return total, (a - (total - of_b)) + (b - of_b)


def _product(a: Array, b: Array) -> tuple[Array, Array]:
    (a_high, a_low), (b_high, b_low) = _halves(a), _halves(b)
    product = lax.optimization_barrier(a * b)
    error = a_high * b_high - product
    return product, ((error + a_high * b_low) + a_low * b_high) + a_low * b_low


def _halves(a: Array) -> tuple[Array, Array]:
    """Split each number into halves of its digits, whose products are exact (Dekker 1971)."""
    digits, bits = jnp.finfo(a.dtype).nmant + 1, jnp.finfo(a.dtype).bits
    integer = jnp.dtype(f"int{bits}")
    low_digits = jnp.array(-(1 << ((digits + 1) // 2)), integer)
    high = lax.bitcast_convert_type(lax.bitcast_convert_type(a, integer) & low_digits, a.dtype)
    return high, a - high


class Scaling(NamedTuple):
    """Centre, units and axes of a scaled problem, which take results back to the user's frame; each ``(1, B)``."""

    centre: Vec3
    length: Array
    """Unit of length [m]: root mean square distance of the contacts from the centre, by weight; of contacts that
    coincide but for rounding, the centre's distance from the frame's origin, or 1 m there."""
    weight_sum: Array
    """Sum of the sharing weights; 0 where no contact can carry a force."""
    force_unit: Array
    """Unit of force [N]: squeezing forces, the wrench's force and its torque over the length, added up."""
    sound: Array
    """Mask of problems whose lengths, loads and weights have squares within the range of the precision."""
    unweighted_radius: Array
    """Root mean square distance of the adjustable contacts, each counted alike, in units of the length; at least 1.

    Weights may be so uneven that the length is next to nothing beside the grasp."""
    axes: tuple[Vec3, Vec3, Vec3] | None = None


class Placement(NamedTuple):
    """Centre, length and weights of the contacts: a scaling without its load."""

    first: Vec3
    correction: Vec3
    """The centre is their sum: the first mean is off by rounding of the frame's distance, a second one mends that."""
    length: Array
    rounding_distance: Array
    """Distance [m] below which points this far from the origin coincide but for rounding."""
    mean_distance: Array
    """Mean distance of the contacts from the centre."""
    unweighted_radius: Array
    """As in ``Scaling``."""
    weight_sum: Array
    subnormal_count: Array
    """Number of contacts with a weight that is positive but subnormal beside the sum: arithmetic may take it for 0."""

    @property
    def centre(self) -> Vec3:
        return vec3.add(self.first, self.correction)


def place_contacts(data: ContactData) -> tuple[ContactData, Placement]:
    """Return points about the weighted centroid, with lengths and weights of order one; forces stay in newtons."""
    (weight_sum,) = vec3.totals(data.weights)
    k = data.weights / jnp.where(weight_sum > 0, weight_sum, 1)
    first = Vec3(*vec3.totals(*vec3.scale(k, data.points)))
    rough = vec3.sub(data.points, first)
    correction = Vec3(*vec3.totals(*vec3.scale(k, rough)))
    points = vec3.sub(rough, correction)
    centre = vec3.add(first, correction)
    size2, size = vec3.dot(points, points), vec3.taxicab(points)
    if data.spin_radius is not None:
        size2, size = size2 + data.spin_radius**2, size + data.spin_radius
    is_adjustable = data.weights > 0
    adjustable, lost = (x.astype(k.dtype) for x in (is_adjustable, is_adjustable & (k < jnp.finfo(k.dtype).tiny)))
    square, mean_distance, plain_square, count, subnormal_count = vec3.totals(
        k * size2, k * size, adjustable * size2, adjustable, lost
    )
    length = vec3.safe_sqrt(square)
    # Contacts that coincide but for rounding have no length of their own.
    distance = vec3.norm(centre)
    rounding_distance = tolerances(length.dtype).rank * distance
    length = jnp.where(length > rounding_distance, length, jnp.where(rounding_distance > 0, distance, 1))
    spin_radius = None if data.spin_radius is None else data.spin_radius / length
    placed = data._replace(points=vec3.scale(1 / length, points), weights=k, spin_radius=spin_radius)
    radius2 = plain_square / (jnp.maximum(count, 1) * length**2)
    return placed, Placement(
        first=first,
        correction=correction,
        length=length,
        rounding_distance=rounding_distance,
        mean_distance=mean_distance,
        unweighted_radius=jnp.sqrt(jnp.maximum(radius2, 1)),
        weight_sum=weight_sum,
        subnormal_count=subnormal_count,
    )


def torque_about(placement: Placement, data: ContactData, compensates: bool) -> Vec3:
    """Move the torque to the centre.

    From a frame far away the subtraction cancels most digits: in single precision, contacts 1e-7 off a line ten metres
    away would have an objective wrong by 1e-7. ``compensates`` keeps them all by compensated products.
    """
    if compensates:
        moved = minus_cross(data.torque, placement.first, data.force)
    else:
        moved = vec3.sub(data.torque, vec3.cross(placement.first, data.force))
    return vec3.sub(moved, vec3.cross(placement.correction, data.force))


def scale_by_load(
    placement: Placement, data: ContactData, axes: tuple[Vec3, Vec3, Vec3] | None = None
) -> tuple[ContactData, Scaling]:
    """Divide placed problems by their load; return them and the whole scaling, with the ``axes`` of the rotation."""
    (squeeze,) = vec3.totals(data.squeeze)
    load = squeeze + vec3.norm(data.force) + vec3.norm(data.torque) / placement.length
    smallest, largest = tolerances(load.dtype).smallest, tolerances(load.dtype).largest_load
    sound = reduce(jnp.logical_and, ((size == 0) | (size >= smallest) for size in (placement.weight_sum, load)))
    # The torque about the centre is a product of the data, and may have overflowed.
    sound = sound & (load <= largest)
    # A wrench whose square vanishes beside the load's would pass for none.
    wrench = vec3.taxicab(data.force) + vec3.taxicab(data.torque) / placement.length
    is_zero = vec3.taxicab(data.force) + vec3.taxicab(data.torque) == 0
    vanishing = 16 * float(jnp.finfo(load.dtype).tiny) ** 0.5
    sound = sound & (is_zero | (wrench >= vanishing * load) & (load > 0))
    sound = sound & ((placement.mean_distance <= placement.rounding_distance) | (placement.mean_distance >= smallest))
    sound = sound & (placement.subnormal_count == 0)
    load = jnp.where(sound & (load > 0), load, 1)
    zero = jnp.zeros_like(load)
    data = data._replace(torque=vec3.where(sound, data.torque, Vec3(zero, zero, zero)))
    scaling = Scaling(
        placement.centre, placement.length, placement.weight_sum, load, sound, placement.unweighted_radius, axes
    )
    return _divide_by_load(data, scaling), scaling


def _divide_by_load(data: ContactData, scaling: Scaling) -> ContactData:
    """Divide forces by the load's unit, and the torque by the length's too."""
    return data._replace(
        squeeze=data.squeeze / scaling.force_unit,
        force=vec3.scale(1 / scaling.force_unit, data.force),
        torque=vec3.scale(1 / (scaling.force_unit * scaling.length), data.torque),
        normal_min=None if data.normal_min is None else data.normal_min / scaling.force_unit,
        normal_max=None if data.normal_max is None else data.normal_max / scaling.force_unit,
    )


def normalise(data: ContactData, compensates: bool = False) -> tuple[ContactData, Scaling]:
    """Return coordinates of order one about the weighted centroid; ``compensates`` as in ``torque_about``."""
    placed, where = place_contacts(data)
    return scale_by_load(where, placed._replace(torque=torque_about(where, data, compensates)))


def with_scaling(data: ContactData, scaling: Scaling, points: Vec3, weights: Array, torque: Vec3) -> ContactData:
    """Return the problems in the units of a scaling, with these points, weights and torque about its centre."""
    spin_radius = None if data.spin_radius is None else data.spin_radius / scaling.length
    placed = data._replace(
        points=vec3.scale(1 / scaling.length, points), weights=weights, torque=torque, spin_radius=spin_radius
    )
    return _divide_by_load(placed, scaling)


def rounding_growth(scaling: Scaling | Placement) -> Array:
    """Return the factor by which the frame's distance multiplies the rounding of points: 1 where it is near."""
    return 1 + jnp.sqrt(vec3.dot(scaling.centre, scaling.centre)) / scaling.length


def inertia(data: ContactData) -> list[list[Array]]:
    """Return the torque block of G W G^T: sum of k (|r|^2 I - r r^T), for soft fingers + k l^2 a a^T."""
    xx, yy, zz, xy, xz, yz = _moments(data.points, data.weights)
    matrix = [[yy + zz], [-xy, xx + zz], [-xz, -yz, xx + yy]]
    if data.spin_radius is None:
        return matrix
    xx, yy, zz, xy, xz, yz = _moments(data.normals, data.weights * data.spin_radius**2)
    spins = [[xx], [xy, yy], [xz, yz, zz]]
    return [[p + q for p, q in zip(*rows, strict=True)] for rows in zip(matrix, spins, strict=True)]


def _moments(a: Vec3, weights: Array) -> list[Array]:
    """Return the entries of the sum of weights a a^T: xx, yy, zz, xy, xz, yz."""
    b = vec3.scale(weights, a)
    return vec3.totals(b.x * a.x, b.y * a.y, b.z * a.z, b.x * a.y, b.x * a.z, b.y * a.z)


def rotate(data: ContactData, axes: tuple[Vec3, Vec3, Vec3]) -> ContactData:
    """Rotate the problems into ``axes``."""
    return data._replace(
        points=vec3.rotate(axes, data.points),
        normals=vec3.rotate(axes, data.normals),
        force=vec3.rotate(axes, data.force),
        torque=vec3.rotate(axes, data.torque),
    )


@fused_cpu_kernel
def scale_in_principal_axes(data: ContactData, turned: bool | Array = True) -> tuple[ContactData, Scaling]:
    """Return coordinates of order one along the principal axes of inertia; along the user's axes if not ``turned``.

    Points that are tiny in one direction then keep their own digits, and the inertia matrix is
    ill-conditioned by its scales alone, which costs nothing. Forming it in other axes squares the
    condition number: at a relative spread of 1e-7 the forces would be wrong in the third digit.
    """
    data, scaling = normalise(data, compensates=True)
    axes = ldl.principal_axes(inertia(data), turned)
    return rotate(data, axes), scaling._replace(axes=axes)


def forces_from_scaled(forces: Vec3, scaling: Scaling) -> Vec3:
    """Return forces in the user's axes and units."""
    turned = forces if scaling.axes is None else vec3.rotate_back(scaling.axes, forces)
    return vec3.scale(scaling.force_unit, turned)


def moments_from_scaled(data: ContactData, spin: Array | None, scaling: Scaling) -> Array | None:
    """Return moments about the normals in the user's units; None where all contacts are hard."""
    return (
        None
        if spin is None or data.spin_radius is None
        else scaling.force_unit * scaling.length * data.spin_radius * spin
    )


def multiplier_from_scaled(linear: Vec3, angular: Vec3, scaling: Scaling) -> tuple[Vec3, Vec3]:
    """Return a multiplier about the user's origin, in the user's units."""
    if scaling.axes is not None:
        linear, angular = vec3.rotate_back(scaling.axes, linear), vec3.rotate_back(scaling.axes, angular)
    unit = vec3.safe_divide(scaling.force_unit, scaling.weight_sum)
    linear, angular = vec3.scale(unit, linear), vec3.scale(unit / scaling.length, angular)
    return vec3.sub(linear, vec3.cross(angular, scaling.centre)), angular


def multiplier_to_scaled(multiplier: Array, scaling: Scaling) -> tuple[Vec3, Vec3]:
    """Invert ``multiplier_from_scaled``, from ``(B, 6)``."""
    columns = multiplier.T
    linear, angular = Vec3(*(columns[i : i + 1] for i in range(3))), Vec3(*(columns[i : i + 1] for i in range(3, 6)))
    linear, angular = twist_to_scaled(linear, angular, scaling)
    unit = scaling.weight_sum / scaling.force_unit
    return vec3.scale(unit, linear), vec3.scale(unit * scaling.length, angular)


def twist_to_scaled(linear: Vec3, angular: Vec3, scaling: Scaling) -> tuple[Vec3, Vec3]:
    """Move a twist about the user's origin to the problem's centre and axes; in the user's units."""
    linear = vec3.add(linear, vec3.cross(angular, scaling.centre))
    if scaling.axes is not None:
        linear, angular = vec3.rotate(scaling.axes, linear), vec3.rotate(scaling.axes, angular)
    return linear, angular


def certificate_from_scaled(linear: Vec3, angular: Vec3, scaling: Scaling) -> tuple[Vec3, Vec3]:
    """Return a direction as a twist about the user's origin, of unit size in the problem's coordinates."""
    if scaling.axes is not None:
        linear, angular = vec3.rotate_back(scaling.axes, linear), vec3.rotate_back(scaling.axes, angular)
    angular = vec3.scale(1 / scaling.length, angular)
    return vec3.sub(linear, vec3.cross(angular, scaling.centre)), angular


def wrench_to_scaled(wrench: SpatialVec, scaling: Scaling) -> SpatialVec:
    """Move a wrench about the user's origin to a problem's centre, axes and lengths; in the user's forces."""
    force, torque = spatial.parts(wrench)
    torque = vec3.scale(1 / scaling.length, vec3.sub(torque, vec3.cross(scaling.centre, force)))
    if scaling.axes is not None:
        force, torque = vec3.rotate(scaling.axes, force), vec3.rotate(scaling.axes, torque)
    return spatial.join(force, torque)


def wrench_from_scaled(wrench: SpatialVec, scaling: Scaling) -> SpatialVec:
    """Invert ``wrench_to_scaled``."""
    force, torque = spatial.parts(wrench)
    if scaling.axes is not None:
        force, torque = vec3.rotate_back(scaling.axes, force), vec3.rotate_back(scaling.axes, torque)
    return spatial.join(force, vec3.add(vec3.scale(scaling.length, torque), vec3.cross(scaling.centre, force)))
