"""A precision grip: fingertips alone hold an object, the thumb opposite the others."""

from itertools import product

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxgrasp.grip.fingertips import (
    APART,
    CLEARANCE,
    COUPLING,
    FingertipTask,
    Misses,
    fingertip_task,
    misses,
    tip_ends,
    weighed,
)
from jaxgrasp.hand.closing_way import ClosingWay, closing_way
from jaxgrasp.hand.detection import Contacts, find_contacts
from jaxgrasp.hand.human_hand import is_human
from jaxgrasp.hand.kinematics import pose_hand
from jaxgrasp.hand.shapes import Shape, check_shape
from jaxgrasp.model.arrays import AnyArray
from jaxgrasp.model.hand import Hand, Pose, Posture
from jaxgrasp.numerics.least_squares import least_squares
from jaxgrasp.numerics.rotation import rotation_by
from jaxgrasp.validation.checked import checked

FINGERS = ("thumb", "index", "middle", "ring", "little")
PRESHAPES = ((25.0, 45.0, 65.0), (25.0, 50.0))
"""Angles from which the fingers' first and second flexion set out, in all combinations [degrees]."""
THUMB_ABDUCTIONS = (30.0, 50.0)
"""Those of a human thumb's abduction [degrees]."""
THUMB_WAYS = (0.5, 1.0)
"""How far another hand's thumb is on its way round, but for its last two joints."""
THUMB_FLEXION = 20.0
"""Flexion of the thumb's last two joints at the start [degrees]."""
STEPS = 60
SHIFT = 0.05
"""A way of the object that counts as much as a radian of a joint [m]."""
EASE = 0.02
"""Weight of the way from the start, which decides what nothing else does."""
OFF_DEPTH = 0.1
"""By how much a depth may miss the wanted one, as a share of it."""
OFF_LINE = 0.2
"""By how much unit normals may miss the line from the thumb to the fingers; friction 0.5 allows 0.46 rad."""


@checked
def precision_grip(
    hand: Hand, shape: Shape, fingers: int = 3, depth: float = 1e-3, way: ClosingWay | None = None
) -> tuple[Posture, Pose, Contacts]:
    """A hand that holds an object by its fingertips: posture, the object's place, and the contacts.

    Joint angles within their limits and the object's pose are found together, by least squares from several
    preshapes: each fingertip presses to the wanted depth, the other links and fingertips stay clear, and the thumb's
    normal and the others' mean are opposed along the line between them, so that their friction cones hold that line:
    Nguyen's condition of force closure (IJRR 7(3):3-16, 1988) for the thumb and one finger in place of the others.
    Fingers that take no part are straight. Wrist at the world's origin, palm down; the object's z axis lies about
    across the palm, its x axis about from the thumb to the fingers.

    Hands of 0.16 to 0.21 m reach round objects of 15 to 35 mm radius and boxes as thick, pressed 0.3 to 3 mm deep.
    The first call for a kind of shape and a number of fingers compiles, about 15 s; another takes a third of a second.

    Args:
        hand: a human hand, or one whose links [`jaxgrasp.hand.name_fingers`][] has named, with a thumb.
        shape: of the object.
        fingers: that touch, with the thumb: 3 (thumb, index, middle), 4, or 5.
        depth: at which each fingertip presses into it [m].
        way: in which the hand closes, from [`jaxgrasp.hand.closing_way`][]; as that finds it where not given.

    Raises:
        ValueError: for a hand without palm and these fingers, another number of fingers, a shape of no volume, and an
            object that this hand does not hold so; the message names what was not reached.
    """
    way = closing_way(hand) if way is None else way
    check_shape(shape)
    if fingers not in (3, 4, 5):
        raise ValueError(f"fingers is {fingers}: expected 3, 4 or 5, since fewer hard contacts do not hold an object")
    if not (np.isfinite(depth) and depth > 0):
        raise ValueError(f"depth is {depth}: expected a positive number of metres")
    task = fingertip_task(hand, shape, depth, FINGERS[:fingers], way)
    angles, placed, missed = _solve(task, *_preshapes(task))
    _check_reached(task, jax.device_get(missed))
    posture = Posture(task.wrist, angles)
    return posture, placed, find_contacts(hand, posture, shape, placed)


def _preshapes(task: FingertipTask) -> tuple[np.ndarray, Pose]:
    """Angles ``(S, J)`` to set out from, the object midway between thumb and fingers."""
    bends = product(*PRESHAPES, _thumbs(task))
    whole = np.array([_preshape(task, flexion, bend, thumb) for flexion, bend, thumb in bends])
    posture, tips = Posture(task.wrist, whole), list(task.tips)
    links = jax.device_get(pose_hand(task.hand, posture).links)
    ends = np.einsum("stij,tj->sti", links.rotation[:, tips], tip_ends(task.hand, tips)) + links.origin[:, tips]
    thumb, others = ends[:, 0], ends[:, 1:].mean(1)
    x = others - thumb
    x /= np.linalg.norm(x, axis=-1, keepdims=True)
    # As much across the palm, towards the little finger of a right hand, as the line between them allows.
    z = x[:, 1:2] * x - np.array([0.0, 1.0, 0.0])
    z /= np.linalg.norm(z, axis=-1, keepdims=True)
    return whole, Pose((thumb + others) / 2, np.stack([x, np.cross(z, x), z], -1))


def _preshape(task: FingertipTask, flexion: float, bend: float, thumb: dict[int, float]) -> np.ndarray:
    """``(J,)`` Angles with fingers bent that far [degrees], and the thumb's joints where they are said to be."""
    bends = dict.fromkeys(task.flexions[0][-2:], THUMB_FLEXION)
    for chain in task.flexions[1:]:
        first, *middle, last = chain
        bends |= {first: flexion, last: COUPLING * bend, **dict.fromkeys(middle, bend)}
    angles = np.asarray(task.way.open).copy()
    for joint, angle in thumb.items():
        angles[joint] = angle
    for joint, angle in bends.items():
        angles[joint] += np.sign(task.way.closed[joint] - task.way.open[joint]) * np.radians(angle)
    angles = np.clip(angles, np.asarray(task.hand.lower), np.asarray(task.hand.upper))
    return angles if task.hand.coupling is None else np.asarray(task.hand.coupling.angles(angles))


def _thumbs(task: FingertipTask) -> list[dict[int, float]]:
    """Angles of the thumb's first joints to set out from [rad]."""
    if is_human(task.hand):
        return [{task.hand.joints.index("thumb abduction"): float(np.radians(a))} for a in THUMB_ABDUCTIONS]
    first = task.flexions[0][:-2]
    ways = np.asarray(task.way.closed) - np.asarray(task.way.open)
    return [{joint: float(task.way.open[joint] + share * ways[joint]) for joint in first} for share in THUMB_WAYS]


@jax.jit
def _solve(task: FingertipTask, angles: AnyArray, placed: Pose) -> tuple[Array, Pose, Misses]:
    """The best end of all starts: angles, the object's pose, and what is still missing."""
    free = np.array(task.joints)
    middle, half = (task.hand.upper + task.hand.lower)[free] / 2, (task.hand.upper - task.hand.lower)[free] / 2

    def read(angles: Array, placed: Pose, unknowns: Array) -> tuple[Array, Pose]:
        # A sine keeps within the limits whatever the unknowns are.
        turned = angles.at[free].set(middle + half * jnp.sin(unknowns[:-6]))
        if task.hand.coupling is not None:
            turned = task.hand.coupling.angles(turned)
        shift, turn = unknowns[-6:-3], unknowns[-3:]
        return turned, Pose(placed.origin + SHIFT * shift, rotation_by(turn) @ placed.rotation)

    def search(angles: Array, placed: Pose):
        phases = jnp.arcsin(jnp.clip((angles[free] - middle) / half, -0.95, 0.95))
        start = jnp.append(phases, jnp.zeros(6))

        def residuals(unknowns: Array) -> Array:
            return jnp.append(weighed(misses(task, *read(angles, placed, unknowns))), EASE * (unknowns - start))

        found = least_squares(residuals, start, STEPS)
        return found.cost, read(angles, placed, found.point)

    costs, ends = jax.vmap(search)(jnp.asarray(angles), jax.tree.map(jnp.asarray, placed))
    turned, pose = jax.tree.map(lambda x: x[jnp.nanargmin(costs)], ends)
    return turned, pose, misses(task, turned, pose)


def _check_reached(task: FingertipTask, missed: Misses) -> None:
    """Raise ValueError with what a grip lacks, the first thing of each kind."""
    links = [link.name for link in task.hand.links]
    tips = [links[i] for i in task.tips]
    others = [name for i, name in enumerate(links) if i not in task.tips]
    lacking = [
        f"{name} is {1e3 * abs(off):.1f} mm too {'deep' if off > 0 else 'far'}"
        for name, off in zip(tips, missed.depth, strict=True)
        if not abs(off) <= OFF_DEPTH * task.depth
    ]
    lacking += [
        f"{name} is in the way" for name, near in zip(others, missed.intrusion, strict=True) if near >= CLEARANCE
    ]
    if not missed.overlap.max() <= 2 * APART:
        lacking.append("fingertips have no room beside each other")
    if not max(*np.linalg.norm(missed.facing, axis=-1), *missed.opposing) <= OFF_LINE:
        lacking.append("the thumb does not come to face the fingers")
    if lacking:
        raise ValueError(
            f"no precision grip of {len(tips)} fingers on this {type(task.shape).__name__} was found: "
            f"{', '.join(lacking)}"
        )
