"""Frames: a problem's own coordinates, in which everything is of order one, and the way back.

About the weighted centroid of the contacts, G W G^T falls into a scalar and a 3x3 inertia matrix, and nothing is lost
when the frame lies far away. Lengths are then divided by the weighted radius, weights by their sum, forces by the
load, so that everything is of order one whatever the units.
"""

from functools import reduce
from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from jaxgrasp.numerics import compensated, ldl, vec3
from jaxgrasp.numerics.fused_cpu_kernel import fused_cpu_kernel
from jaxgrasp.numerics.vec3 import Vec3
from jaxgrasp.problem.batch_last import ContactData
from jaxgrasp.problem.tolerances import tolerances


class Scaling(NamedTuple):
    """How a lane's coordinates came about, to bring results back."""

    centre: Vec3
    length: Array
    weight: Array
    """Sum of the sharing weights; 0 where no contact can carry a force."""
    load: Array
    sound: Array
    """Whether lengths, loads and weights are numbers whose squares keep their digits."""
    axes: tuple[Vec3, Vec3, Vec3] | None = None


class Placement(NamedTuple):
    """Where the contacts are, which says all of a frame but its load."""

    first: Vec3
    rest: Vec3
    """The centre is their sum: the first mean is off by rounding of the frame's distance, a second one mends that."""
    length: Array
    blur: Array
    """Distances that are rounding, of points so far away."""
    reach: Array
    """Mean distance of the contacts from the centre."""
    weight: Array

    @property
    def centre(self) -> Vec3:
        return vec3.add(self.first, self.rest)


def place_contacts(lanes: ContactData) -> tuple[ContactData, Placement]:
    """Arms about the weighted centroid, lengths and weights of order one; forces and torque as they are."""
    (weight,) = vec3.totals(lanes.weights)
    k = lanes.weights / jnp.where(weight > 0, weight, 1)
    first = Vec3(*vec3.totals(*vec3.scale(k, lanes.arms)))
    rough = vec3.sub(lanes.arms, first)
    rest = Vec3(*vec3.totals(*vec3.scale(k, rough)))
    arms = vec3.sub(rough, rest)
    centre = vec3.add(first, rest)
    size2, size = vec3.dot(arms, arms), vec3.taxicab(arms)
    if lanes.lever is not None:
        size2, size = size2 + lanes.lever**2, size + lanes.lever
    square, reach = vec3.totals(k * size2, k * size)
    length = vec3.safe_sqrt(square)
    # Contacts that coincide but for rounding have no length of their own.
    blur = tolerances(length.dtype).rank * jnp.sqrt(vec3.dot(centre, centre))
    length = jnp.where(length > blur, length, jnp.where(blur > 0, jnp.sqrt(vec3.dot(centre, centre)), 1))
    lever = None if lanes.lever is None else lanes.lever / length
    placed = lanes._replace(arms=vec3.scale(1 / length, arms), weights=k, lever=lever)
    return placed, Placement(first, rest, length, blur, reach, weight)


def torque_about(place: Placement, lanes: ContactData, carefully: bool) -> Vec3:
    """The torque about the centre.

    Moving it from a frame far away leaves little of its digits: in single arithmetic, contacts 1e-7 off a line ten
    metres away would have an objective wrong by 1e-7. ``carefully`` keeps them all.
    """
    if carefully:
        moved = compensated.minus_cross(lanes.torque, place.first, lanes.force)
    else:
        moved = vec3.sub(lanes.torque, vec3.cross(place.first, lanes.force))
    return vec3.sub(moved, vec3.cross(place.rest, lanes.force))


def scale_by_load(
    place: Placement, lanes: ContactData, axes: tuple[Vec3, Vec3, Vec3] | None = None
) -> tuple[ContactData, Scaling]:
    """Placed lanes whose forces are of order one too, and the whole frame; ``axes`` are those they were turned into."""
    (squeeze,) = vec3.totals(lanes.squeeze)
    load = squeeze + vec3.norm(lanes.force) + vec3.norm(lanes.torque) / place.length
    smallest = tolerances(load.dtype).smallest
    sound = reduce(jnp.logical_and, ((size == 0) | (size >= smallest) for size in (place.weight, load)))
    sound = sound & ((place.reach <= place.blur) | (place.reach >= smallest))
    load = jnp.where(load > 0, load, 1)
    frame = Scaling(place.centre, place.length, place.weight, load, sound, axes)
    return _divide_by_load(lanes, frame), frame


def _divide_by_load(lanes: ContactData, frame: Scaling) -> ContactData:
    """Forces in units of the load, the torque in those of the length too."""
    return lanes._replace(
        squeeze=lanes.squeeze / frame.load,
        force=vec3.scale(1 / frame.load, lanes.force),
        torque=vec3.scale(1 / (frame.load * frame.length), lanes.torque),
        least=None if lanes.least is None else lanes.least / frame.load,
        most=None if lanes.most is None else lanes.most / frame.load,
    )


def normalise(lanes: ContactData, carefully: bool = False) -> tuple[ContactData, Scaling]:
    """Coordinates of order one about the weighted centroid; ``carefully``, so that the torque keeps its digits."""
    placed, where = place_contacts(lanes)
    return scale_by_load(where, placed._replace(torque=torque_about(where, lanes, carefully)))


def with_scaling(lanes: ContactData, frame: Scaling, arms: Vec3, weights: Array, torque: Vec3) -> ContactData:
    """The lanes in a frame's units, with these arms, weights and torque about its centre."""
    lever = None if lanes.lever is None else lanes.lever / frame.length
    placed = lanes._replace(arms=vec3.scale(1 / frame.length, arms), weights=weights, torque=torque, lever=lever)
    return _divide_by_load(placed, frame)


def rounding_growth(frame: Scaling | Placement) -> Array:
    """By how much the frame's distance multiplies the rounding of points: 1 where it is near."""
    return 1 + jnp.sqrt(vec3.dot(frame.centre, frame.centre)) / frame.length


def inertia(lanes: ContactData) -> list[list[Array]]:
    """Sum of k (|r|^2 I - r r^T), of soft fingers + k l^2 a a^T, over the contacts: the torque block of G W G^T."""
    xx, yy, zz, xy, xz, yz = _moments(lanes.arms, lanes.weights)
    matrix = [[yy + zz], [-xy, xx + zz], [-xz, -yz, xx + yy]]
    if lanes.lever is None:
        return matrix
    xx, yy, zz, xy, xz, yz = _moments(lanes.normals, lanes.weights * lanes.lever**2)
    spins = [[xx], [xy, yy], [xz, yz, zz]]
    return [[p + q for p, q in zip(*rows, strict=True)] for rows in zip(matrix, spins, strict=True)]


def _moments(a: Vec3, weights: Array) -> list[Array]:
    """Sums of weights a a^T."""
    b = vec3.scale(weights, a)
    return vec3.totals(b.x * a.x, b.y * a.y, b.z * a.z, b.x * a.y, b.x * a.z, b.y * a.z)


def rotate(lanes: ContactData, axes: tuple[Vec3, Vec3, Vec3]) -> ContactData:
    """The lanes written along ``axes``."""
    return lanes._replace(
        arms=vec3.rotate(axes, lanes.arms),
        normals=vec3.rotate(axes, lanes.normals),
        force=vec3.rotate(axes, lanes.force),
        torque=vec3.rotate(axes, lanes.torque),
    )


@fused_cpu_kernel
def scale_in_principal_axes(lanes: ContactData, turned: bool | Array = True) -> tuple[ContactData, Scaling]:
    """Coordinates of order one, carefully, along the principal axes of inertia; along the user's if not ``turned``.

    Arms that are tiny in one direction then keep their own digits, and the inertia matrix is
    ill-conditioned by its scales alone, which costs nothing. Forming it in other axes squares the
    condition number: at a relative spread of 1e-7 the forces would be wrong in the third digit.
    """
    lanes, frame = normalise(lanes, carefully=True)
    axes = ldl.principal_axes(inertia(lanes), turned)
    return rotate(lanes, axes), frame._replace(axes=axes)


def forces_from_scaled(forces: Vec3, frame: Scaling) -> Vec3:
    """Forces in the user's axes and units."""
    turned = forces if frame.axes is None else vec3.rotate_back(frame.axes, forces)
    return vec3.scale(frame.load, turned)


def moments_from_scaled(lanes: ContactData, spin: Array | None, frame: Scaling) -> Array | None:
    """Moments about the normals in the user's units; None where all contacts are hard."""
    return None if spin is None or lanes.lever is None else frame.load * frame.length * lanes.lever * spin


def multiplier_from_scaled(linear: Vec3, angular: Vec3, frame: Scaling) -> tuple[Vec3, Vec3]:
    """A multiplier about the user's origin, in the user's units."""
    if frame.axes is not None:
        linear, angular = vec3.rotate_back(frame.axes, linear), vec3.rotate_back(frame.axes, angular)
    unit = vec3.safe_divide(frame.load, frame.weight)
    linear, angular = vec3.scale(unit, linear), vec3.scale(unit / frame.length, angular)
    return vec3.sub(linear, vec3.cross(angular, frame.centre)), angular


def multiplier_to_scaled(multiplier: Array, frame: Scaling) -> tuple[Vec3, Vec3]:
    """The inverse of ``multiplier_out``, from ``(B, 6)``."""
    columns = multiplier.T
    linear, angular = Vec3(*(columns[i : i + 1] for i in range(3))), Vec3(*(columns[i : i + 1] for i in range(3, 6)))
    linear, angular = twist_to_scaled(linear, angular, frame)
    unit = frame.weight / frame.load
    return vec3.scale(unit, linear), vec3.scale(unit * frame.length, angular)


def twist_to_scaled(linear: Vec3, angular: Vec3, frame: Scaling) -> tuple[Vec3, Vec3]:
    """A twist about the user's origin as one about the lane's centre, along its axes; in the user's units."""
    linear = vec3.add(linear, vec3.cross(angular, frame.centre))
    if frame.axes is not None:
        linear, angular = vec3.rotate(frame.axes, linear), vec3.rotate(frame.axes, angular)
    return linear, angular


def certificate_from_scaled(linear: Vec3, angular: Vec3, frame: Scaling) -> tuple[Vec3, Vec3]:
    """A direction of wrench space as a twist about the user's origin, of unit size in the lane's coordinates."""
    if frame.axes is not None:
        linear, angular = vec3.rotate_back(frame.axes, linear), vec3.rotate_back(frame.axes, angular)
    angular = vec3.scale(1 / frame.length, angular)
    return vec3.sub(linear, vec3.cross(angular, frame.centre)), angular
