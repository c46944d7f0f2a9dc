"""Solid as a tree of spheres, by which contacts with a mesh are found."""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array, lax

from jaxgrasp.hand.descent import Balls, Nodes, descend, try_all
from jaxgrasp.hand.shapes import Proximity, Shape, Size
from jaxgrasp.model.arrays import AnyArray, Float
from jaxgrasp.numerics import vec3
from jaxgrasp.numerics.vec3 import Vec3


class SphereTree(Shape):
    """A solid by balls inside it, the same for all poses; from [`jaxgrasp.hand.sphere_tree`][]."""

    balls: Balls
    nodes: Nodes
    moments: Float[AnyArray, "*batch 3"]
    """Principal moments of inertia by unit of mass [m^2]; NaN where the frame is not the principal one."""
    descends: bool = eqx.field(static=True)
    """True where contacts are found by descent, False where all balls are tried."""

    def scaled(self, factor: float) -> "SphereTree":
        """Return the tree of the same solid with all lengths multiplied by a factor."""
        balls, bounds = (jax.tree.map(lambda x: factor * x, part) for part in (self.balls, self.nodes.bounds))
        nodes = eqx.tree_at(lambda nodes: nodes.bounds, self.nodes, bounds)
        return SphereTree(balls, nodes, factor**2 * self.moments, self.descends)

    @property
    def _sizes(self) -> dict[str, Size]:
        return {}

    @property
    def _batch(self) -> tuple[int, ...]:
        return ()

    def _flat(self, batch: tuple[int, ...]) -> "SphereTree":
        return jax.tree.map(lambda x: jnp.asarray(x)[None], self)

    def _distance(self, point: Vec3) -> tuple[Array, Vec3]:
        """Compute the distance from the nearest of all balls, and the direction out of it."""
        centers, radii = self.balls.centers, jnp.asarray(self.balls.radii)

        def of_one(point_row: Array) -> tuple[Array, Array]:
            offset = point_row - centers
            length = jnp.sqrt(jnp.sum(offset * offset, -1))
            nearest = jnp.argmin(length - radii)
            shortest = Vec3(*offset[nearest])
            return vec3.norm(shortest) - radii[nearest], jnp.stack(vec3.unit(shortest))

        distance, out = lax.map(of_one, jnp.stack(point, -1).reshape(-1, 3))
        shape = jnp.shape(point.x)
        return distance.reshape(shape), Vec3(*(out[:, i].reshape(shape) for i in range(3)))

    def _bound(self, point: Vec3) -> Array:
        bounds = self.nodes.bounds
        root = Vec3(*(jnp.asarray(c)[:, 0] for c in (bounds.x, bounds.y, bounds.z)))
        return vec3.norm(vec3.sub(point, root)) - bounds.radii[:, 0]

    def _near(self, centers: Vec3, radii: Array) -> Proximity:
        shape = centers.x.shape
        points = jnp.moveaxis(jnp.stack(centers, -1).reshape(-1, shape[-1], 3), 0, 1)
        sizes = jnp.broadcast_to(radii, (*shape[:-1], 1)).ravel()
        query_balls = partial(descend, self.balls, self.nodes) if self.descends else partial(try_all, self.balls)
        query = query_balls(points, sizes)
        out = Vec3(*(query.out[..., i].T.reshape(shape) for i in range(3)))
        return Proximity(query.distance.T.reshape(shape), out, query.tests)

    def _support(self, direction: Vec3) -> Array:
        along = jnp.stack(direction, -1) @ self.balls.centers.T
        return jnp.max(along + self.balls.radii * vec3.norm(direction)[..., None], -1)

    def _moments(self) -> tuple[Array, Array, Array]:
        x, y, z = jnp.asarray(self.moments)
        return x, y, z
