"""Exact shapes: signed distance of a point from the surface, and the direction out.

Each shape stands in a frame of its own. Distances are positive outside and negative inside; normals point outwards.
Inside, near edges and axes, the nearest surface changes and the normal jumps, as it must.
"""

from abc import abstractmethod
from functools import partial, reduce
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxgrasp.model.arrays import AnyArray, Float
from jaxgrasp.model.faults import entries
from jaxgrasp.numerics import vec3
from jaxgrasp.numerics.tiling import shared_or_spread
from jaxgrasp.numerics.vec3 import Vec3
from jaxgrasp.validation.checked import checked

Size = Float[AnyArray, "*batch"] | float


class Proximity(NamedTuple):
    """Distances of spheres' centres from a solid, batch-last: exact where the spheres reach into it."""

    distance: Array
    out: Vec3
    """The way out of the solid."""
    tests: Array
    """``(B,)``: how many distances were computed for it."""


class Shape(eqx.Module):
    """A solid whose sizes are its fields, each with any leading axes [m]."""

    @property
    def _sizes(self) -> dict[str, Size]:
        """Sizes that must be positive, by name."""
        return {name: getattr(self, name) for name in self.__dataclass_fields__}

    @property
    def _batch(self) -> tuple[int, ...]:
        """Leading axes of the sizes."""
        return jnp.broadcast_shapes(*(jnp.shape(size) for size in jax.tree.leaves(self)))

    def _flat(self, batch: tuple[int, ...]) -> "Shape":
        """Flatten the leading axes of the sizes into one, of size 1 where the whole batch shares it."""
        return jax.tree.map(partial(shared_or_spread, batch), self)

    @abstractmethod
    def _distance(self, point: Vec3) -> tuple[Array, Vec3]:
        """Compute the signed distance and the outward unit normal; sizes broadcast with the last axis of components."""

    def _bound(self, point: Vec3) -> Array:
        """Compute a lower bound of the signed distance, at low cost."""
        return self._distance(point)[0]

    def _near(self, centers: Vec3, radii: Array) -> Proximity:
        """Compute the distances of spheres ``(L, m, B)`` from the solid; all poses share the radii ``(L, m, 1)``."""
        distance, out = self._distance(centers)
        return Proximity(distance, out, jnp.full(distance.shape[-1], radii.size, jnp.int32))

    def _support(self, direction: Vec3) -> Array:
        """Compute the extent of the solid from its origin along a direction (support function)."""
        raise NotImplementedError(f"a {type(self).__name__} is unbounded: expected a solid of finite size")

    def _moments(self) -> tuple[Array, Array, Array]:
        """Compute the principal moments of inertia by unit of mass, about the origin, of uniform density [m^2]."""
        raise NotImplementedError(f"a {type(self).__name__} has no moments of inertia: expected a solid of finite size")


class Sphere(Shape):
    """A ball about its frame's origin."""

    radius: Size

    def _distance(self, point: Vec3) -> tuple[Array, Vec3]:
        length = vec3.norm(point)
        return length - self.radius, vec3.unit(point)

    def _support(self, direction: Vec3) -> Array:
        return jnp.asarray(self.radius) * vec3.norm(direction)

    def _moments(self) -> tuple[Array, Array, Array]:
        moment = 2 / 5 * jnp.asarray(self.radius) ** 2
        return moment, moment, moment


class Plane(Shape):
    """The half space z < 0: a table's top, or with its pose turned, a wall."""

    def _distance(self, point: Vec3) -> tuple[Array, Vec3]:
        zero = jnp.zeros_like(point.z)
        return point.z, Vec3(zero, zero, zero + 1)


class Box(Shape):
    """A block about its frame's origin, with these edges along x, y and z."""

    length: Size
    width: Size
    height: Size

    def _distance(self, point: Vec3) -> tuple[Array, Vec3]:
        edges = (self.length, self.width, self.height)
        beyond = [jnp.abs(c) - jnp.asarray(e) / 2 for c, e in zip(point, edges, strict=True)]
        distance, normal = _rounded(beyond)
        return distance, Vec3(*(jnp.where(c < 0, -n, n) for c, n in zip(point, normal, strict=True)))

    def _support(self, direction: Vec3) -> Array:
        edges = Vec3(*map(jnp.asarray, (self.length, self.width, self.height)))
        return vec3.dot(Vec3(*map(jnp.abs, direction)), edges) / 2

    def _moments(self) -> tuple[Array, Array, Array]:
        x, y, z = (jnp.asarray(edge) ** 2 / 12 for edge in (self.length, self.width, self.height))
        return y + z, x + z, x + y


class Cylinder(Shape):
    """A cylinder about its frame's origin, its axis along z."""

    radius: Size
    height: Size

    def _distance(self, point: Vec3) -> tuple[Array, Vec3]:
        across = vec3.safe_sqrt(point.x**2 + point.y**2)
        beyond = [across - self.radius, jnp.abs(point.z) - jnp.asarray(self.height) / 2]
        distance, (radial, axial) = _rounded(beyond)
        # On the axis any way out is as short: x.
        x = jnp.where(across > 0, vec3.safe_divide(point.x, across), 1)
        return distance, Vec3(
            radial * x, radial * vec3.safe_divide(point.y, across), jnp.where(point.z < 0, -axial, axial)
        )

    def _support(self, direction: Vec3) -> Array:
        across = vec3.safe_sqrt(direction.x**2 + direction.y**2)
        return jnp.asarray(self.radius) * across + jnp.asarray(self.height) / 2 * jnp.abs(direction.z)

    def _moments(self) -> tuple[Array, Array, Array]:
        radius2, height2 = jnp.asarray(self.radius) ** 2, jnp.asarray(self.height) ** 2
        across = radius2 / 4 + height2 / 12
        return across, across, radius2 / 2


class Capsule(Shape):
    """A cylinder about z with round ends; ``height`` is that of its straight part."""

    radius: Size
    height: Size

    def _distance(self, point: Vec3) -> tuple[Array, Vec3]:
        half = jnp.asarray(self.height) / 2
        offset = point._replace(z=point.z - jnp.clip(point.z, -half, half))
        length = vec3.norm(offset)
        return length - self.radius, vec3.unit(offset)

    def _support(self, direction: Vec3) -> Array:
        return jnp.asarray(self.radius) * vec3.norm(direction) + jnp.asarray(self.height) / 2 * jnp.abs(direction.z)

    def _moments(self) -> tuple[Array, Array, Array]:
        radius, height = jnp.asarray(self.radius), jnp.asarray(self.height)
        straight, caps = height, 4 / 3 * radius  # volumes, over the round cross-section
        axial = (straight * radius**2 / 2 + caps * 2 / 5 * radius**2) / (straight + caps)
        # Half a ball's centre of mass lies 3/8 of its radius from its flat side.
        offset = (height / 2) ** 2 + 3 / 8 * height * radius
        side = straight * (radius**2 / 4 + height**2 / 12) + caps * (2 / 5 * radius**2 + offset)
        return side / (straight + caps), side / (straight + caps), axial


class Shifted(Shape):
    """A solid beside its frame's origin, such as one whose centre of mass is not its middle."""

    solid: Shape
    x: Size
    """Place of the solid's own origin along x [m]; ``y`` and ``z`` likewise."""
    y: Size
    z: Size

    @property
    def _sizes(self) -> dict[str, Size]:
        return self.solid._sizes

    @property
    def _batch(self) -> tuple[int, ...]:
        return jnp.broadcast_shapes(self.solid._batch, *map(jnp.shape, (self.x, self.y, self.z)))

    def _flat(self, batch: tuple[int, ...]) -> "Shifted":
        return Shifted(self.solid._flat(batch), *(shared_or_spread(batch, part) for part in (self.x, self.y, self.z)))

    def _distance(self, point: Vec3) -> tuple[Array, Vec3]:
        return self.solid._distance(self._to_solid_frame(point))

    def _bound(self, point: Vec3) -> Array:
        return self.solid._bound(self._to_solid_frame(point))

    def _near(self, centers: Vec3, radii: Array) -> Proximity:
        return self.solid._near(self._to_solid_frame(centers), radii)

    def _support(self, direction: Vec3) -> Array:
        return self.solid._support(direction) + vec3.dot(Vec3(*map(jnp.asarray, (self.x, self.y, self.z))), direction)

    def _to_solid_frame(self, point: Vec3) -> Vec3:
        return vec3.sub(point, Vec3(*map(jnp.asarray, (self.x, self.y, self.z))))


def _rounded(face_distances: list[Array]) -> tuple[Array, list[Array]]:
    """Compute the distance and normal of the solid that lies below zero in each of these distances."""
    outside = [jnp.maximum(b, 0) for b in face_distances]
    length = vec3.safe_sqrt(reduce(jnp.add, [o * o for o in outside]))
    largest = reduce(jnp.maximum, face_distances)
    inward = largest <= 0
    normal, assigned = [], jnp.zeros_like(inward)
    for b, o in zip(face_distances, outside, strict=True):
        # Of equally near faces the first alone: their sum would be no unit vector.
        nearest = (b == largest) & ~assigned
        assigned = assigned | nearest
        normal.append(jnp.where(inward, nearest.astype(b.dtype), vec3.safe_divide(o, length)))
    return jnp.where(inward, largest, length), normal


@checked
def signed_distance(
    shape: Shape, points: Float[AnyArray, "*#batch 3"]
) -> tuple[Float[Array, "*batch"], Float[Array, "*batch 3"]]:
    """Compute the signed distances of points from a shape's surface, and the outward normals.

    Args:
        shape: its sizes broadcast against the points' leading axes.
        points: in the shape's own frame ``(..., 3)`` [m].

    Returns:
        Distances ``(...)`` [m], negative inside, and outward unit normals ``(..., 3)``.

    Example:
        >>> import numpy as np
        >>> from jaxgrasp.hand import Sphere, signed_distance
        >>> distance, out = signed_distance(Sphere(0.03), np.array([0.0, 0.0, 0.05]))
        >>> round(float(distance), 6), out.tolist()
        (0.02, [0.0, 0.0, 1.0])

    Raises:
        TypeError: for what is no shape, or no array of real numbers.
        ValueError: for points of other than three coordinates.
    """
    return _signed_distance(shape, points)


@jax.jit
def _signed_distance(shape: Shape, points: AnyArray) -> tuple[Array, Array]:
    points = jnp.asarray(points)
    distance, normal = shape._distance(Vec3(*(points[..., i] for i in range(3))))
    return distance, jnp.stack(jnp.broadcast_arrays(*normal), -1)


@checked
def check_shape(shape: Shape) -> None:
    """Raise ValueError unless every size is a positive, finite number."""
    for name, value in shape._sizes.items():
        sizes = np.asarray(value)
        bad = ~(np.isfinite(sizes) & (sizes > 0))
        expected = "a positive number of metres, since a shape of no volume cannot be touched"
        for fault in entries(f"{type(shape).__name__}.{name}", sizes, bad, expected):
            raise ValueError(str(fault))
