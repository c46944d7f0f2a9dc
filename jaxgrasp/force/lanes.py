"""Problems as the kernels see them: batch-last, cleaned, centred, scaled, and turned where it matters.

The public arrays are batch-first, ``(B, n, 3)``. Kernels work on components of shape ``(n, B)`` for what
belongs to contacts and ``(1, B)`` for what belongs to problems, so that the compiler vectorises over
problems. A grasp that many wrenches share has B = 1 and broadcasts.

Coordinates: about the weighted centroid of the contacts, G W G^T falls into a scalar and a 3x3 inertia
matrix, and nothing is lost when the frame lies far away. Lengths are then divided by the weighted radius,
weights by their sum, forces by the load, so that everything is of order one whatever the units.
"""

from functools import reduce
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jax import Array

from jaxgrasp.force.cones import Cone
from jaxgrasp.force.fours import Four
from jaxgrasp.force.tolerances import tolerances
from jaxgrasp.model.arrays import Float
from jaxgrasp.numerics import doubled, symmetric, vec
from jaxgrasp.numerics.vec import Vec


class Problem(eqx.Module):
    """A flat batch of problems; the grasp's leading axis may be 1 when all wrenches share it."""

    points: Float[Array, "#B n 3"]
    normals: Float[Array, "#B n 3"]
    friction: Float[Array, "#B n"]
    squeeze: Float[Array, "#B n"]
    present: Float[Array, "#B n"] | None
    weights: Float[Array, "#B n"]
    """Sharing weights k."""
    wrench: Float[Array, "B 6"]
    free: Float[Array, "#B 6 k"] | None = None
    """Twists along which a guide lets the object move; None for an object that no guide holds."""
    start: Float[Array, "B 6"] | None = None
    """A multiplier to climb the dual from; None for the closed form's."""
    torsion: Float[Array, "#B n"] | None = None
    """Torsional friction; None where all contacts are hard fingers."""
    normal_min: Float[Array, "#B n"] | None = None
    normal_max: Float[Array, "#B n"] | None = None
    torque_map: Float[Array, "#B n c j"] | None = None
    torque_max: Float[Array, "#B j"] | None = None

    @property
    def size(self) -> int:
        return self.wrench.shape[0]


class Lanes(NamedTuple):
    """One problem in each lane of the last axis."""

    arms: Vec
    normals: Vec
    friction: Array
    squeeze: Array
    weights: Array
    force: Vec
    torque: Vec
    toll: Array | None = None
    """What a unit of normal force costs, in questions of how little is enough; None where it costs nothing."""
    lever: Array | None = None
    """Of soft fingers: moment for each unit of ``Four.spin``; 0 for hard ones, None where all are hard."""
    least: Array | None = None
    """Of the normal force; None where none is bounded, and so for ``most``."""
    most: Array | None = None

    @property
    def cone(self) -> Cone:
        """What each contact may exert."""
        return Cone(self.normals, self.friction, self.least, self.most)


class Frame(NamedTuple):
    """How a lane's coordinates came about, to bring results back."""

    centre: Vec
    length: Array
    weight: Array
    """Sum of the sharing weights; 0 where no contact can carry a force."""
    load: Array
    sound: Array
    """Whether lengths, loads and weights are numbers whose squares keep their digits."""
    axes: tuple[Vec, Vec, Vec] | None = None


def squeezing(lanes: Lanes) -> Four:
    """The squeezing forces s a."""
    return Four(vec.scale(lanes.squeeze, lanes.normals), None if lanes.lever is None else 0 * lanes.lever)


def read(problem: Problem) -> tuple[Lanes, Array]:
    """Batch-last copies, and which lanes hold usable data.

    Absent contacts and unusable lanes are replaced by contacts that carry nothing, so that no NaN enters
    the arithmetic, in values or in derivatives. Normals are brought to unit length.
    """
    points, normals = _components(problem.points), _components(problem.normals)
    friction, squeeze, weights = problem.friction.T, problem.squeeze.T, problem.weights.T
    wrench = problem.wrench.T
    size2 = vec.dot(normals, normals)
    largest = tolerances(points.x.dtype).largest
    # One sum meets a NaN, or what is too large to be squared, in any of its terms.
    size = vec.taxicab(points) + size2 + jnp.abs(friction) + jnp.abs(squeeze) + jnp.abs(weights)
    good = (size2 > 0) & (friction >= 0) & (squeeze >= 0) & (weights >= 0)
    torsion, least, most = (
        None if x is None else x.T for x in (problem.torsion, problem.normal_min, problem.normal_max)
    )
    if torsion is not None:
        size, good = size + jnp.abs(torsion), good & (torsion >= 0)
    if least is not None:
        size, good = size + jnp.abs(least), good & (least >= 0)
    if most is not None:
        good = good & (most >= (0 if least is None else least))
    good = good & (size <= largest)
    there = None
    if problem.present is not None:
        present = problem.present.T
        there = present > 0.5
        good = (good | ~there) & ~jnp.isnan(present)
    lane_good = jnp.all(good, 0, keepdims=True)
    valid = lane_good & (sum(jnp.abs(wrench[i : i + 1]) for i in range(6)) <= largest)
    if problem.free is not None:
        valid = valid & (jnp.sum(jnp.abs(problem.free), (1, 2))[None] <= largest)
    if problem.torque_map is not None and problem.torque_max is not None:
        asked = largest >= jnp.sum(jnp.abs(problem.torque_map), (2, 3)).T
        valid = valid & jnp.all(asked if there is None else asked | ~there, 0) & jnp.all(problem.torque_max >= 0, 1)
    use = jnp.broadcast_to(lane_good, good.shape) if there is None else there & lane_good

    def keep(array: Array) -> Array:
        return jnp.where(use, array, 0)

    kept = Vec(*map(keep, normals))
    # From what was kept, so that no derivative meets what was not.
    inverse = 1 / jnp.sqrt(jnp.where(use, vec.dot(kept, kept), 1))
    least = None if least is None else keep(least)
    most = None if most is None else jnp.where(use, most, jnp.inf)
    lanes = Lanes(
        arms=Vec(*map(keep, points)),
        normals=vec.scale(inverse, kept),
        friction=keep(friction),
        squeeze=_allowed(keep(squeeze), keep(weights), least, most),
        weights=keep(weights),
        force=Vec(*(jnp.where(valid, wrench[i : i + 1], 0) for i in range(3))),
        torque=Vec(*(jnp.where(valid, wrench[i : i + 1], 0) for i in range(3, 6))),
        lever=None if torsion is None else vec.safe_divide(keep(torsion), keep(friction)),
        least=least,
        most=most,
    )
    return lanes, valid


def _allowed(squeeze: Array, weights: Array, least: Array | None, most: Array | None) -> Array:
    """The squeeze; of contacts that cannot move, which hold theirs, within the bounds of the normal force."""
    for bound, cut in ((least, jnp.maximum), (most, jnp.minimum)):
        if bound is not None:
            squeeze = jnp.where(weights > 0, squeeze, cut(squeeze, bound))
    return squeeze


def _components(array: Array) -> Vec:
    return Vec(*jnp.transpose(array, (2, 1, 0)))


def normalise(lanes: Lanes, carefully: bool = False) -> tuple[Lanes, Frame]:
    """Coordinates of order one about the weighted centroid.

    Moving the torque from a frame far away leaves little of its digits: in single arithmetic, contacts 1e-7 off a
    line ten metres away would have an objective wrong by 1e-7. ``carefully`` keeps them all.
    """
    weight, squeeze = vec.totals(lanes.weights, lanes.squeeze)
    k = lanes.weights / jnp.where(weight > 0, weight, 1)
    first = Vec(*vec.totals(*vec.scale(k, lanes.arms)))
    rough = vec.sub(lanes.arms, first)
    # The first mean is off by rounding of the frame's distance; a second one mends that.
    rest = Vec(*vec.totals(*vec.scale(k, rough)))
    arms = vec.sub(rough, rest)
    if carefully:
        moved = doubled.minus_cross(lanes.torque, first, lanes.force)
    else:
        moved = vec.sub(lanes.torque, vec.cross(first, lanes.force))
    torque = vec.sub(moved, vec.cross(rest, lanes.force))
    centre = vec.add(first, rest)
    size2, size = vec.dot(arms, arms), vec.taxicab(arms)
    if lanes.lever is not None:
        size2, size = size2 + lanes.lever**2, size + lanes.lever
    square, reach = vec.totals(k * size2, k * size)
    length = vec.safe_sqrt(square)
    # Contacts that coincide but for rounding have no length of their own.
    blur = tolerances(length.dtype).rank * jnp.sqrt(vec.dot(centre, centre))
    length = jnp.where(length > blur, length, jnp.where(blur > 0, jnp.sqrt(vec.dot(centre, centre)), 1))
    pull = vec.norm(lanes.force) + vec.norm(torque) / length
    load = squeeze + pull
    smallest = tolerances(length.dtype).smallest
    sound = reduce(jnp.logical_and, ((size == 0) | (size >= smallest) for size in (weight, load)))
    sound = sound & ((reach <= blur) | (reach >= smallest))
    load = jnp.where(load > 0, load, 1)
    frame = Frame(centre, length, weight, load, sound)
    return scaled(lanes, frame, arms, k, torque), frame


def scaled(lanes: Lanes, frame: Frame, arms: Vec, weights: Array, torque: Vec) -> Lanes:
    """The lanes in a frame's units, with these arms, weights and torque about its centre."""
    return Lanes(
        arms=vec.scale(1 / frame.length, arms),
        normals=lanes.normals,
        friction=lanes.friction,
        squeeze=lanes.squeeze / frame.load,
        weights=weights,
        force=vec.scale(1 / frame.load, lanes.force),
        torque=vec.scale(1 / (frame.load * frame.length), torque),
        lever=None if lanes.lever is None else lanes.lever / frame.length,
        least=None if lanes.least is None else lanes.least / frame.load,
        most=None if lanes.most is None else lanes.most / frame.load,
    )


def blur(frame: Frame) -> Array:
    """By how much the frame's distance multiplies the rounding of points: 1 where it is near."""
    return 1 + jnp.sqrt(vec.dot(frame.centre, frame.centre)) / frame.length


def inertia(lanes: Lanes) -> list[list[Array]]:
    """Sum of k (|r|^2 I - r r^T), of soft fingers + k l^2 a a^T, over the contacts: the torque block of G W G^T."""
    xx, yy, zz, xy, xz, yz = _moments(lanes.arms, lanes.weights)
    matrix = [[yy + zz], [-xy, xx + zz], [-xz, -yz, xx + yy]]
    if lanes.lever is None:
        return matrix
    xx, yy, zz, xy, xz, yz = _moments(lanes.normals, lanes.weights * lanes.lever**2)
    spins = [[xx], [xy, yy], [xz, yz, zz]]
    return [[p + q for p, q in zip(*rows, strict=True)] for rows in zip(matrix, spins, strict=True)]


def _moments(a: Vec, weights: Array) -> list[Array]:
    """Sums of weights a a^T."""
    b = vec.scale(weights, a)
    return vec.totals(b.x * a.x, b.y * a.y, b.z * a.z, b.x * a.y, b.x * a.z, b.y * a.z)


def turn(lanes: Lanes, axes: tuple[Vec, Vec, Vec]) -> Lanes:
    """The lanes written along ``axes``."""
    return lanes._replace(
        arms=vec.rotate(axes, lanes.arms),
        normals=vec.rotate(axes, lanes.normals),
        force=vec.rotate(axes, lanes.force),
        torque=vec.rotate(axes, lanes.torque),
    )


def principal(lanes: Lanes) -> tuple[Lanes, Frame]:
    """Coordinates of order one, carefully, along the principal axes of inertia.

    Arms that are tiny in one direction then keep their own digits, and the inertia matrix is
    ill-conditioned by its scales alone, which costs nothing. Forming it in other axes squares the
    condition number: at a relative spread of 1e-7 the forces would be wrong in the third digit.
    """
    lanes, frame = normalise(lanes, carefully=True)
    axes = symmetric.principal_axes(inertia(lanes))
    return turn(lanes, axes), frame._replace(axes=axes)


def forces_out(forces: Vec, frame: Frame) -> Vec:
    """Forces in the user's axes and units."""
    turned = forces if frame.axes is None else vec.rotate_back(frame.axes, forces)
    return vec.scale(frame.load, turned)


def moments_out(lanes: Lanes, spin: Array | None, frame: Frame) -> Array | None:
    """Moments about the normals in the user's units; None where all contacts are hard."""
    return None if spin is None or lanes.lever is None else frame.load * frame.length * lanes.lever * spin


def multiplier_out(linear: Vec, angular: Vec, frame: Frame) -> tuple[Vec, Vec]:
    """A multiplier about the user's origin, in the user's units."""
    if frame.axes is not None:
        linear, angular = vec.rotate_back(frame.axes, linear), vec.rotate_back(frame.axes, angular)
    unit = vec.safe_divide(frame.load, frame.weight)
    linear, angular = vec.scale(unit, linear), vec.scale(unit / frame.length, angular)
    return vec.sub(linear, vec.cross(angular, frame.centre)), angular


def multiplier_in(multiplier: Array, frame: Frame) -> tuple[Vec, Vec]:
    """The inverse of ``multiplier_out``, from ``(B, 6)``."""
    columns = multiplier.T
    linear, angular = Vec(*(columns[i : i + 1] for i in range(3))), Vec(*(columns[i : i + 1] for i in range(3, 6)))
    linear, angular = twist_in(linear, angular, frame)
    unit = frame.weight / frame.load
    return vec.scale(unit, linear), vec.scale(unit * frame.length, angular)


def twist_in(linear: Vec, angular: Vec, frame: Frame) -> tuple[Vec, Vec]:
    """A twist about the user's origin as one about the lane's centre, along its axes; in the user's units."""
    linear = vec.add(linear, vec.cross(angular, frame.centre))
    if frame.axes is not None:
        linear, angular = vec.rotate(frame.axes, linear), vec.rotate(frame.axes, angular)
    return linear, angular


def certificate_out(linear: Vec, angular: Vec, frame: Frame) -> tuple[Vec, Vec]:
    """A direction of wrench space as a twist about the user's origin, of unit size in the lane's coordinates."""
    if frame.axes is not None:
        linear, angular = vec.rotate_back(frame.axes, linear), vec.rotate_back(frame.axes, angular)
    angular = vec.scale(1 / frame.length, angular)
    return vec.sub(linear, vec.cross(angular, frame.centre)), angular
