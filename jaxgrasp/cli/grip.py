"""``jaxgrasp grip``: the virtual hand takes an object up, turns it, and may let it go."""

import json
import math
from collections import Counter
from dataclasses import asdict
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from jaxgrasp.cli.checks import check_finite, check_not_negative, check_positive, sampled_times
from jaxgrasp.cli.grip_arguments import Grip
from jaxgrasp.cli.machine import provenance, say_compiling, set_up_jax
from jaxgrasp.cli.terminal import show
from jaxgrasp.files.replace import replace_file
from jaxgrasp.grip.carry import Instant, carry, stacked
from jaxgrasp.grip.lifting import lift_and_turn
from jaxgrasp.grip.monitor import Hold
from jaxgrasp.grip.motion import Body
from jaxgrasp.grip.power_grip import power_grip
from jaxgrasp.grip.precision_grip import precision_grip
from jaxgrasp.grip.scene import Scene
from jaxgrasp.hand.balanced_contributions import balanced_contributions
from jaxgrasp.hand.detection import Contacts
from jaxgrasp.hand.grip_type import GripType, contributions_of, grip_type
from jaxgrasp.hand.human_hand import human_hand, open_angles
from jaxgrasp.hand.shapes import Box, Capsule, Cylinder, Shape, Sphere, check_shape
from jaxgrasp.model.hand import Hand, Pose, Posture
from jaxgrasp.model.task import GRAVITY
from jaxgrasp.report.grip_over_time import History, history

UNBALANCED = 0.2
"""Part of the squeezing forces that may be unbalanced before it is worth a word."""
TABLE = -0.5
"""Height of the table's top below the wrist's start [m]."""


def grip_command(arguments: Grip) -> int:
    """Close, lift, turn; write what happened, and say it."""
    check_positive(arguments, "mass", "stiffness", "depth", "seconds", "step")
    check_not_negative(arguments, "friction")
    check_finite(arguments, "lift", "turn")
    times = sampled_times(arguments.seconds, arguments.step)
    shape = _shape(arguments)
    check_shape(shape)
    set_up_jax("float64")
    say_compiling("the hand, its contacts and both laws", "minutes")
    hand = human_hand(arguments.hand_length, side=arguments.side)
    closed, placed, contacts = _closed(arguments, hand, shape)
    kind = GripType(int(grip_type(hand, closed, contacts)))
    show(f"closed on the {arguments.object}: {int(contacts.present.sum())} contacts, {_words(kind)}")
    contributions = contributions_of(hand, kind)
    if arguments.contributions == "balanced":
        contributions = balanced_contributions(contacts, contributions, placed.origin)
    postures = lift_and_turn(
        closed,
        times,
        lift=arguments.lift,
        turn=math.radians(arguments.turn),
        axis=np.array([1.0, 0.0, 0.0]),
        release=Posture(closed.wrist, jnp.asarray(open_angles(hand))) if arguments.release else None,
    )
    scene = Scene(
        hand=hand,
        body=Body(shape, arguments.mass),
        table=Pose(jnp.array([0.0, 0.0, TABLE]), jnp.eye(3)),
        friction=arguments.friction,
        stiffness=arguments.stiffness,
        contributions=contributions,
        gravity=jnp.array(GRAVITY),
    )
    record = stacked(carry(scene, postures, placed, float(times[1] - times[0]), law=arguments.law))
    arguments.out.mkdir(parents=True, exist_ok=True)
    summary = {"grip": _words(kind)} | _summary(hand, times, record) | _unbalanced(record)
    _write(arguments.out, hand, times, postures, record, summary)
    show(_said(summary))
    show(f"written: {arguments.out / 'grip.npz'}, {arguments.out / 'grip.json'}")
    if arguments.report:
        _write_report(arguments, scene, history(scene, postures, times, record))
    return 0


def _closed(arguments: Grip, hand: Hand, shape: Shape) -> tuple[Posture, Pose, Contacts]:
    """The hand, the object in it, and their contacts."""
    if arguments.grip == "power":
        return power_grip(hand, shape, arguments.depth)
    return precision_grip(hand, shape, int(arguments.grip.removeprefix("precision-")), arguments.depth)


def _words(kind: GripType) -> str:
    return kind.name.lower().replace("_", " ")


def _shape(arguments: Grip) -> Shape:
    radius, height = arguments.radius, arguments.height
    shapes: dict[str, Shape] = {
        "sphere": Sphere(radius),
        "cylinder": Cylinder(radius, height),
        "capsule": Capsule(radius, height),
        "box": Box(2 * radius, 2 * radius, height),
    }
    return shapes[arguments.object]


def _write(out: Path, hand: Hand, times: np.ndarray, postures: Posture, record: Instant, summary: dict) -> None:
    """Everything over time in arrays, and in words what a person asks first."""
    ticks = record.tick
    columns = {
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
        "missed": record.missed,
        "torques": ticks.torques,
        "grip_type": grip_type(hand, postures, ticks.contacts),
        "joints": np.array(hand.joints),
        "links": np.array([link.name for link in hand.links]),
    }
    replace_file(out / "grip.npz", lambda stream: np.savez_compressed(stream, **jax.device_get(columns)))
    text = json.dumps(summary, indent=2)
    replace_file(out / "grip.json", lambda stream: stream.write(text.encode()))


def _write_report(arguments: Grip, scene: Scene, happened: History) -> None:
    """Page and pictures; of what is not installed one line says how to get it."""
    from jaxgrasp.report.grip_page import write_grip_page
    from jaxgrasp.report.grip_pictures import write_grip_pictures

    out, whole = arguments.out, float(happened.times[-1])
    instants = {"closed": 0.0, "lifted": whole / 2, "turned": 3 * whole / 4, "end": whole}
    try:
        write_grip_page(out / "grip.html", scene, happened, title=_title(arguments), details=_details(arguments))
        show(f"report:  {out / 'grip.html'}")
    except ImportError as error:
        show(f"no report: {error}")
    try:
        show("pictures:", *write_grip_pictures(out, scene, happened, instants))
    except ImportError as error:
        show(f"no pictures: {error}")


def _title(arguments: Grip) -> str:
    hand = f"a {arguments.side} hand of {1000 * arguments.hand_length:g} mm"
    return f"A {arguments.grip} grip of a {arguments.object} of {1000 * arguments.mass:g} g in {hand}"


def _details(arguments: Grip) -> dict[str, str]:
    """What was asked for, and by which versions it was answered."""
    asked = {name: value for name, value in asdict(arguments).items() if name not in ("out", "report")}
    return {name.replace("_", " "): str(value) for name, value in asked.items()} | provenance()


def _summary(hand: Hand, times: np.ndarray, record: Instant) -> dict:
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


def _unbalanced(record: Instant) -> dict:
    """How much of the squeezing forces nothing balances, at first."""
    grasp = jax.tree.map(lambda x: x[0], record.tick.grasp)
    pressed = np.asarray(grasp.squeeze) * np.asarray(grasp.present)
    rest = np.linalg.norm(pressed @ np.asarray(grasp.normals))
    return {"squeezing_N": float(pressed.sum()), "unbalanced_squeezing_N": float(rest)}


def _said(found: dict) -> str:
    holds = ", ".join(f"{count} {name.lower()}" for name, count in found["hold"].items())
    lines = [
        f"{found['instants']} instants: {holds}; {found['contacts']['least']} to {found['contacts']['most']} contacts",
        f"closed form slips where the optimum holds: {found['laws_disagree']} instants",
        _said_of_squeezing(found),
        f"largest torque against flexion: {found['largest_resisting_torque_Nm']:.3f} N.m, "
        f"{found['its_joint']} at {found['its_time_s']:.2f} s",
    ]
    if found["first_not_stable_s"] is not None:
        lines.insert(1, f"not stable for the first time at {found['first_not_stable_s']:.2f} s")
    return "\n".join(lines)


def _said_of_squeezing(found: dict) -> str:
    squeezing, rest = found["squeezing_N"], found["unbalanced_squeezing_N"]
    hint = ", which takes the closed form out of the cones: see --contributions balanced"
    return f"squeezing forces: {squeezing:.1f} N, {rest:.1f} N unbalanced" + (
        hint if rest > UNBALANCED * squeezing else ""
    )
