"""``jaxgrasp grip`` in a scene of many objects: what the engine moves, and what became of the others."""

from typing import NamedTuple

import numpy as np

from jaxgrasp.cli.terminal import show
from jaxgrasp.grip.monitor import Law
from jaxgrasp.grip.scene_file import GrippedScene, SceneFile
from jaxgrasp.grip.simulation import Record, stacked
from jaxgrasp.model.arrays import AnyArray
from jaxgrasp.model.hand import Posture
from jaxgrasp.world.many_bodies import World, WorldState
from jaxgrasp.world.physics import Engine
from jaxgrasp.world.world_file import world_of
from jaxgrasp.world.world_simulation import EngineName, engine_of, simulate_world

STAYED = 1e-3
"""Distance below which an object counts as unmoved [m]."""


class MovedWorld(NamedTuple):
    """A world at first, and the engine that moves it."""

    world: World
    state: WorldState
    engine: Engine
    name: EngineName


class OthersRecord(NamedTuple):
    """Arrays over time and summary of the objects beside the gripped one."""

    columns: dict[str, AnyArray]
    summary: dict


def moved_world(file: SceneFile, gripped: GrippedScene, engine: EngineName | None) -> MovedWorld:
    """Return the world of a file, its first state, and the named engine, else the quasi-static one.

    Raises:
        ValueError: for objects that begin inside one another.
        ImportError: without what the engine needs.
    """
    world, state = world_of(file, gripped)
    name = engine or "quasi-static"
    return MovedWorld(world, state, engine_of(name, world, state), name)


def carried_world(moved: MovedWorld, postures: Posture, dt: float, law: Law) -> tuple[Record, OthersRecord]:
    """Simulate the world along the postures; return the record of the gripped object, and of the others."""
    count = len(moved.world.others)
    show(f"{count} more object{'' if count == 1 else 's'}, moved by the engine {moved.name}")
    instants = simulate_world(moved.world, moved.engine, postures, moved.state, dt, law=law)
    record = stacked([instant.gripped for instant in instants])
    states, loads = stacked([(instant.state, instant.loads) for instant in instants])
    exerted, points = stacked([(instant.share.by_hand, instant.share.touches.contacts.points) for instant in instants])
    columns = {
        "others_origin": states.placed.origin[:, 1:],
        "others_rotation": states.placed.rotation[:, 1:],
        "others_forces": exerted.forces[:, 1:],
        "others_points": points[:, 1:],
        "loads_by_table": loads.by_table,
        "loads_by_obstacles": loads.by_obstacles,
        "loads_by_things": loads.by_bodies,
    }
    if exerted.moments is not None:
        columns["others_moments"] = exerted.moments[:, 1:]
    distances = np.linalg.norm(states.placed.origin - states.placed.origin[0], axis=-1)[:, 1:]
    summary = {
        "engine": moved.name,
        "not_solved": int(sum(not instant.solved for instant in instants)),
        "others": {
            "furthest_m": distances.max(0).tolist(),
            "touched_by_hand": np.any(exerted.forces[:, 1:], (0, 2, 3)).tolist(),
        },
    }
    return record, OthersRecord(columns, summary)


def others_text(others: dict) -> str:
    """Format a line for each object: the distance that it moved, and whether the hand touched it."""
    lines = []
    for k, (distance, touched) in enumerate(zip(others["furthest_m"], others["touched_by_hand"], strict=True)):
        movement = "stayed where it was" if distance < STAYED else f"went {100 * distance:.1f} cm away at most"
        lines.append(f"other[{k}] {movement}, " + ("the hand touched it" if touched else "the hand did not touch it"))
    return "\n".join(lines)
