"""A world of many bodies: a hand among objects that touch one another, by an engine of ours or by MuJoCo's."""

from jaxgrasp.world.hand_share import HandShare, ThingTouches
from jaxgrasp.world.many_bodies import Thing, World, WorldState, at_rest
from jaxgrasp.world.mujoco_engine import MujocoEngine
from jaxgrasp.world.physics import Engine, HandMove, Loads, Step
from jaxgrasp.world.quasi_static import QuasiStaticEngine
from jaxgrasp.world.standing import Standing, stands
from jaxgrasp.world.world_carry import WorldInstant, world_carry
from jaxgrasp.world.world_file import world_of

__all__ = [
    "Engine",
    "HandMove",
    "HandShare",
    "Loads",
    "MujocoEngine",
    "QuasiStaticEngine",
    "Standing",
    "Step",
    "Thing",
    "ThingTouches",
    "World",
    "WorldInstant",
    "WorldState",
    "at_rest",
    "stands",
    "world_carry",
    "world_of",
]


def __dir__() -> list[str]:
    return __all__
