"""The engines by their names."""

from typing import Literal

from jaxgrasp.world.many_bodies import World, WorldState
from jaxgrasp.world.mujoco_engine import MujocoEngine
from jaxgrasp.world.physics import Engine
from jaxgrasp.world.quasi_static import QuasiStaticEngine

EngineName = Literal["quasi-static", "mujoco"]


def engine_of(name: EngineName, world: World, state: WorldState) -> Engine:
    """The engine of that name for a world whose objects are somewhere at first.

    Raises:
        ImportError: for MuJoCo's without MuJoCo.
        ValueError: for what the engine does not know.
    """
    return MujocoEngine(world, state) if name == "mujoco" else QuasiStaticEngine(world, state)
