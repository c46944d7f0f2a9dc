"""Worlds of many bodies: a hand among objects that touch one another, by the package's engine or MuJoCo's."""

from jaxgrasp.world.hand_share import BodyTouches, HandShare
from jaxgrasp.world.many_bodies import Engine, HandMove, Loads, RigidBody, Step, World, WorldState, at_rest
from jaxgrasp.world.mujoco_engine import MujocoEngine
from jaxgrasp.world.quasi_static import QuasiStaticEngine
from jaxgrasp.world.standing import Standing, stands
from jaxgrasp.world.world_file import world_of
from jaxgrasp.world.world_simulation import WorldRecord, simulate_world

__all__ = [
    "BodyTouches",
    "Engine",
    "HandMove",
    "HandShare",
    "Loads",
    "MujocoEngine",
    "QuasiStaticEngine",
    "RigidBody",
    "Standing",
    "Step",
    "World",
    "WorldRecord",
    "WorldState",
    "at_rest",
    "simulate_world",
    "stands",
    "world_of",
]


def __dir__() -> list[str]:
    return __all__
