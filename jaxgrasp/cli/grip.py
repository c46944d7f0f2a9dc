"""``jaxgrasp grip``: the virtual hand takes an object up, turns it, and may let it go.

``jaxgrasp grip`` in a scene of many objects: what the engine moves, and what became of the others.
"""

import json
import math
from collections import Counter
from dataclasses import fields
from pathlib import Path
from typing import NamedTuple

import jax
import numpy as np

from jaxgrasp.cli.arguments import Grip
from jaxgrasp.cli.machine import compiling, provenance, sampled_times, set_up_jax
from jaxgrasp.cli.terminal import announce, show
from jaxgrasp.files.replace import check_writable, replace_file
from jaxgrasp.grip.monitor import Hold, Law
from jaxgrasp.grip.scene import Scene
from jaxgrasp.grip.scene_entries import GripEntry, HandEntry, ObjectEntry, TableEntry
from jaxgrasp.grip.scene_file import (
    GrippedScene,
    SceneFile,
    human_scale_warnings,
    load_scene,
    scene_path,
    torque_warnings,
)
from jaxgrasp.grip.simulation import Record, lift_and_turn, simulate, stacked
from jaxgrasp.hand.to_grasp import GripType, grip_type
from jaxgrasp.interop.mujoco_contacts import import_mujoco
from jaxgrasp.lab.loaded_scene import loaded_scene
from jaxgrasp.model.arrays import AnyArray
from jaxgrasp.model.hand import Hand, Posture
from jaxgrasp.report.grip_over_time import History, history
from jaxgrasp.validation.checked import check_finite, check_positive
from jaxgrasp.world.many_bodies import Engine, World, WorldState
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


UNBALANCED = 0.2
"""Part of the squeezing forces that may be unbalanced before it is worth a word."""
UNITS = dict.fromkeys(("length", "breadth", "radius", "height", "size", "depth", "below", "lift", "at"), "m") | {
    "mass": "kg",
    "stiffness": "N/m",
    "gravity": "m/s\N{SUPERSCRIPT TWO}",
    "turn": "\N{DEGREE SIGN}",
    "seconds": "s",
    "step": "s",
    "scale": "m for each unit of the mesh",
    "pitch": "m/rad",
    "through": "m",
}
"""Units of what the page's details name."""
BELOW = 0.4
"""Distance of the table below the object [m]."""
FEW = 1000
"""Instants up to which compiling takes longer than running what is compiled quickly."""


def grip_command(arguments: Grip) -> int:
    """Close, lift, turn; write what happened, and say it."""
    check_positive(arguments, "seconds", "step")
    check_finite(arguments, "lift", "turn")
    times = sampled_times(arguments.seconds, arguments.step)
    file = _scene_of(arguments) if arguments.scene is None else load_scene(scene_path(arguments.scene))
    check_writable(arguments.out)
    for line in human_scale_warnings(file):
        announce(line)
    if arguments.engine == "mujoco":
        import_mujoco("engine mujoco")
    set_up_jax("float64", quickly=len(times) <= FEW)
    with compiling("the hand and its contacts"):
        gripped = loaded_scene(file)
        world = moved_world(file, gripped, arguments.engine) if file.other or arguments.engine else None
    hand, closed = gripped.scene.hand, gripped.closed
    show(f"closed on the {_solid(file)}: {int(gripped.contacts.present.sum())} contacts, {_words(gripped.kind)}")
    postures = lift_and_turn(
        closed,
        times,
        lift=arguments.lift,
        turn=math.radians(arguments.turn),
        axis=np.array([1.0, 0.0, 0.0]),
        release=Posture(closed.wrist, gripped.open) if arguments.release else None,
    )
    dt = float(times[1] - times[0])
    with compiling("both laws, and what the object does"):
        if world is None:
            record, others = stacked(simulate(gripped.scene, postures, gripped.placed, dt, law=gripped.law)), None
        else:
            record, others = carried_world(world, postures, dt, gripped.law)
    arguments.out.mkdir(parents=True, exist_ok=True)
    summary = {"grip": _words(gripped.kind)} | _summary(hand, times, record) | _unbalanced(record)
    columns = _columns(hand, times, postures, record)
    if others is not None:
        summary |= others.summary
        columns |= others.columns
    _write(arguments.out, columns, summary)
    show(_summary_text(summary))
    for line in torque_warnings(summary["largest_resisting_torque_Nm"]):
        announce(line)
    show(f"written: {arguments.out / 'grip.npz'}, {arguments.out / 'grip.json'}")
    if arguments.report:
        _write_report(arguments, file, gripped.scene, history(gripped.scene, postures, times, record))
    return 0


def _scene_of(arguments: Grip) -> SceneFile:
    """Return the scene that the arguments describe, in the form of a loaded file."""
    entries = {
        entry_type: {
            field_.name: getattr(arguments, field_.name)
            for field_ in fields(entry_type)
            if hasattr(arguments, field_.name)
        }
        for entry_type in (ObjectEntry, GripEntry)
    }
    return SceneFile(
        name=f"a {arguments.object}",
        hand=HandEntry(arguments.hand_length, side=arguments.side),
        object=ObjectEntry(**entries[ObjectEntry] | {"shape": arguments.object}),
        grip=GripEntry(**entries[GripEntry] | {"kind": arguments.grip}),
        table=TableEntry(below=BELOW),
    )


def _words(grip_type: GripType) -> str:
    return grip_type.name.lower().replace("_", " ")


def _columns(hand: Hand, times: np.ndarray, postures: Posture, record: Record) -> dict[str, AnyArray]:
    """Collect motion, contacts, forces, verdicts and torques, as arrays with a leading axis of instants."""
    ticks = record.tick
    moments = ticks.assessment.moments
    return ({} if moments is None else {"moments": moments}) | {
        "time": times,
        "wrist_origin": postures.wrist.origin,
        "wrist_rotation": postures.wrist.rotation,
        "angles": postures.angles,
        "object_origin": record.placed.origin,
        "object_rotation": record.placed.rotation,
        "points": ticks.contacts.points,
        "normals": ticks.contacts.normals,
        "depths": ticks.contacts.depths,
        "present": ticks.contacts.present,
        "squeeze": ticks.grasp.squeeze,
        "wrench": ticks.wrench,
        "forces": ticks.assessment.forces,
        "closed_form_forces": ticks.assessment.closed.forces,
        "optimum_forces": ticks.assessment.optimum.forces,
        "closed_form_verdict": ticks.assessment.closed.verdict,
        "optimum_verdict": ticks.assessment.optimum.verdict,
        "hold": record.hold,
        "touches": ticks.assessment.touches,
        "disagrees": ticks.assessment.disagrees,
        "missed": record.wrench_residual,
        "torques": ticks.torques,
        "grip_type": grip_type(hand, postures, ticks.contacts),
        "joints": np.array(hand.joints),
        "links": np.array([link.name for link in hand.links]),
    }


def _write(out: Path, columns: dict[str, AnyArray], summary: dict) -> None:
    """Write the arrays to grip.npz, and the summary to grip.json."""
    replace_file(out / "grip.npz", lambda stream: np.savez_compressed(stream, **jax.device_get(columns)))
    text = json.dumps(summary, indent=2)
    replace_file(out / "grip.json", lambda stream: stream.write(text.encode()))


def _write_report(arguments: Grip, file: SceneFile, scene: Scene, happened: History) -> None:
    """Write the page and the pictures; where a package is missing, print a line that says how to install it."""
    from jaxgrasp.report.grip_page import write_grip_page
    from jaxgrasp.report.grip_pictures import write_grip_pictures

    out, duration = arguments.out, float(happened.times[-1])
    instants = {"closed": 0.0, "lifted": duration / 2, "turned": 3 * duration / 4, "end": duration}
    try:
        write_grip_page(out / "grip.html", scene, happened, title=_title(file), details=_details(arguments, file))
        show(f"report:  {out / 'grip.html'}")
    except ImportError as error:
        show(f"no report: {error}")
    try:
        show("pictures:", *write_grip_pictures(out, scene, happened, instants))
    except ImportError as error:
        show(f"no pictures: {error}")


def _solid(file: SceneFile) -> str:
    return file.object.shape if file.object.mesh is None else Path(file.object.mesh).stem


def _title(file: SceneFile) -> str:
    hand, held = file.hand, file.object
    hand_words = f"a {hand.side} hand of {1000 * hand.length:g} mm" if hand.file is None else Path(hand.file).stem
    return f"A {file.grip.kind} grip of a {_solid(file)} of {1000 * held.mass:g} g in {hand_words}"


def _details(arguments: Grip, file: SceneFile) -> dict[str, str]:
    """Return the scene's entries and the motion, with units, and the versions, for the page's details."""
    moves = {name: _in_units(name, getattr(arguments, name)) for name in ("lift", "turn", "release", "seconds", "step")}
    entries = {
        f"{table} {key}": _in_units(key, value)
        for table, values in file.tables().items()
        for key, value in values.items()
        if not (key == "scale" and file.object.mesh is None)
    }
    return {"scene": file.name} | entries | moves | provenance()


def _in_units(name: str, value: object) -> str:
    # An obstacle's turn is an axis as long as its angle in radians.
    unit = "rad" if name == "turn" and isinstance(value, tuple) else UNITS.get(name, "")
    text = ", ".join(f"{component:g}" for component in value) if isinstance(value, tuple) else str(value)
    return f"{text} {unit}".strip()


def _summary(hand: Hand, times: np.ndarray, record: Record) -> dict:
    ticks = record.tick
    holds = Counter(Hold(code).name for code in np.asarray(record.hold).tolist())
    worst = np.unravel_index(np.argmin(ticks.torques), ticks.torques.shape)
    contacts = ticks.contacts.present.sum(-1).astype(int).tolist()
    slips = times[np.asarray(record.hold) != Hold.STABLE].tolist()
    return {
        "instants": len(times),
        "hold": dict(holds),
        "first_not_stable_s": slips[0] if slips else None,
        "laws_disagree": int(ticks.assessment.disagrees.sum()),
        "contacts": {"least": min(contacts), "most": max(contacts)},
        "largest_resisting_torque_Nm": float(-ticks.torques[worst]),
        "its_joint": hand.joints[worst[1]],
        "its_time_s": float(times[worst[0]]),
    }


def _unbalanced(record: Record) -> dict:
    """Sum the squeezing forces of the first instant, and the norm of their resultant, which is unbalanced [N]."""
    grasp = jax.tree.map(lambda x: x[0], record.tick.grasp)
    pressed = np.asarray(grasp.squeeze) * np.asarray(grasp.present)
    resultant = np.linalg.norm(pressed @ np.asarray(grasp.normals))
    return {"squeezing_N": float(pressed.sum()), "unbalanced_squeezing_N": float(resultant)}


def _summary_text(summary: dict) -> str:
    holds = ", ".join(f"{count} {name.lower()}" for name, count in summary["hold"].items())
    lines = [
        f"{summary['instants']} instants: {holds}; "
        f"{summary['contacts']['least']} to {summary['contacts']['most']} contacts",
        f"closed form slips where the optimum holds: {summary['laws_disagree']} instants",
        _squeezing_line(summary),
        f"largest torque against flexion: {summary['largest_resisting_torque_Nm']:.3f} N.m, "
        f"{summary['its_joint']} at {summary['its_time_s']:.2f} s",
    ]
    if "others" in summary:
        lines.append(others_text(summary["others"]))
    if summary["first_not_stable_s"] is not None:
        lines.insert(1, f"not stable for the first time at {summary['first_not_stable_s']:.2f} s")
    return "\n".join(lines)


def _squeezing_line(summary: dict) -> str:
    squeezing, unbalanced = summary["squeezing_N"], summary["unbalanced_squeezing_N"]
    hint = ", which takes the closed form out of the cones: see --contributions balanced"
    return f"squeezing forces: {squeezing:.1f} N, {unbalanced:.1f} N unbalanced" + (
        hint if unbalanced > UNBALANCED * squeezing else ""
    )
