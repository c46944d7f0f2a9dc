"""What stays the same while a hand handles an object: both of them, the laws of their contacts, and the world."""

import equinox as eqx

from jaxgrasp.contact.shapes import Shape
from jaxgrasp.model.arrays import AnyArray, Float
from jaxgrasp.model.hand import Hand, Pose
from jaxgrasp.prehension.motion import Body


class Obstacle(eqx.Module):
    """What stands in the object's way and never moves; without friction, as the paper's world is."""

    shape: Shape
    """An exact shape, or a tree."""
    placed: Pose
    stiffness: float | AnyArray
    """K of eq. 1 [N/m]"""


class Scene(eqx.Module):
    """A hand, an object, and the world around them."""

    hand: Hand
    body: Body
    table: Pose
    """Its top is the xy plane of this frame; the half space below is solid."""
    friction: float | AnyArray
    stiffness: float | AnyArray
    """K of eq. 6 [N/m]"""
    contributions: Float[AnyArray, "L"]
    """c of eq. 6, of each link."""
    gravity: Float[AnyArray, "3"]
    """[m/s^2]"""
    guide: Float[AnyArray, "6 k"] | None = None
    """Twists (linear, angular) about the world's origin, along which alone a guide lets the object move, such as
    ``np.eye(6)[:, 2:3]`` for a vertical rail; ``None`` for an object that moves freely."""
    obstacles: tuple[Obstacle, ...] = ()
    outline: Hand | None = None
    """The object's parts that meet obstacles, from [`jaxgrasp.rigid_body`][]; needed where there are any."""
