"""A precision grip: fingertips alone hold an object, the thumb opposite the others."""

from itertools import product

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxgrasp.grip.fingertips import APART, CLEARANCE, COUPLING, FingertipTask, Misses, misses, weighed
from jaxgrasp.hand.detection import Contacts, find_contacts
from jaxgrasp.hand.human_hand import check_human, open_angles
from jaxgrasp.hand.kinematics import pose_hand
from jaxgrasp.hand.shapes import Shape, check_shape
from jaxgrasp.model.arrays import AnyArray
from jaxgrasp.model.hand import Hand, Pose, Posture
from jaxgrasp.numerics.least_squares import least_squares
from jaxgrasp.numerics.rotation import rotation_by
from jaxgrasp.validation.checked import checked

FINGERS = ("thumb", "index", "middle", "ring", "little")
PRESHAPES = {"MP": (25, 45, 65), "PIP": (25, 50), "thumb abduction": (30, 50)}
"""Angles from which the hand sets out, in all combinations [degrees]."""
THUMB_FLEXION = 20.0
"""Flexion of both of the thumb's joints, MP and IP, at the start [degrees]."""
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
def precision_grip(hand: Hand, shape: Shape, fingers: int = 3, depth: float = 1e-3) -> tuple[Posture, Pose, Contacts]:
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
        hand: a human hand.
        shape: of the object.
        fingers: that touch, with the thumb: 3 (thumb, index, middle), 4, or 5.
        depth: at which each fingertip presses into it [m].

    Raises:
        ValueError: for a hand that is not a human one, another number of fingers, a shape of no volume, and an object
            that this hand does not hold so; the message names what was not reached.
    """
    check_human(hand)
    check_shape(shape)
    if fingers not in (3, 4, 5):
        raise ValueError(f"fingers is {fingers}: expected 3, 4 or 5, since fewer hard contacts do not hold an object")
    if not (np.isfinite(depth) and depth > 0):
        raise ValueError(f"depth is {depth}: expected a positive number of metres")
    task = FingertipTask(hand, shape, depth, FINGERS[:fingers])
    angles, placed, missed = _solve(task, *_preshapes(task))
    _check_reached(task, jax.device_get(missed))
    posture = Posture(Pose(jnp.zeros(3), jnp.eye(3)), angles)
    return posture, placed, find_contacts(hand, posture, shape, placed)


def _preshapes(task: FingertipTask) -> tuple[np.ndarray, Pose]:
    """Angles ``(S, J)`` to set out from, the object midway between thumb and fingers."""
    starts = []
    for flexion, bend, abduction in np.radians(list(product(*PRESHAPES.values()))):
        angles = open_angles(task.hand)
        for kind, angle in (("MP", flexion), ("PIP", bend), ("DIP", COUPLING * bend)):
            angles[task.fingers_joints(kind)] = angle
        for kind, angle in (("abduction", abduction), *((kind, np.radians(THUMB_FLEXION)) for kind in ("MP", "IP"))):
            angles[task.hand.joints.index(f"thumb {kind}")] = angle
        starts.append(angles)
    whole = np.array(starts)
    posture = Posture(Pose(np.zeros(3), np.eye(3)), whole)
    links, tips = jax.device_get(pose_hand(task.hand, posture).links), task.tips
    ends = np.einsum("stij,tj->sti", links.rotation[:, tips], np.asarray(task.hand.skin.centers)[tips, -1])
    ends += links.origin[:, tips]
    thumb, others = ends[:, 0], ends[:, 1:].mean(1)
    x = others - thumb
    x /= np.linalg.norm(x, axis=-1, keepdims=True)
    # As much across the palm, towards the little finger of a right hand, as the line between them allows.
    z = x[:, 1:2] * x - np.array([0.0, 1.0, 0.0])
    z /= np.linalg.norm(z, axis=-1, keepdims=True)
    return whole, Pose((thumb + others) / 2, np.stack([x, np.cross(z, x), z], -1))


@jax.jit
def _solve(task: FingertipTask, angles: AnyArray, placed: Pose) -> tuple[Array, Pose, Misses]:
    """The best end of all starts: angles, the object's pose, and what is still missing."""
    free = np.array(task.joints)
    middle, half = (task.hand.upper + task.hand.lower)[free] / 2, (task.hand.upper - task.hand.lower)[free] / 2

    def read(angles: Array, placed: Pose, unknowns: Array) -> tuple[Array, Pose]:
        # A sine keeps within the limits whatever the unknowns are.
        turned = angles.at[free].set(middle + half * jnp.sin(unknowns[:-6]))
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
    others = [name for name in links if name not in tips]
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
