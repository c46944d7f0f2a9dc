"""Solution of a grasp at an instant as NumPy arrays, and its drawing: poses, sizes and colours of bodies.

The solution is independent of its source, and the drawing of the program that draws. It is of many equal bodies, each
with a place, a turn, sizes and a colour of its own: contacts, friction cones, arrows. An object that no forces hold
repeats a short motion along the twist that proves infeasibility.
"""

from collections.abc import Sequence
from typing import NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from scipy.spatial.transform import Rotation

from jaxgrasp.force.slip import friction_margin
from jaxgrasp.grip.monitor import Assessment, Law, Touch, assess
from jaxgrasp.model.grasp import Grasp
from jaxgrasp.model.solution import Solution, Verdict, is_balanced
from jaxgrasp.report.grasp_in_3d import round_up
from jaxgrasp.report.grip_over_time import Scale
from jaxgrasp.report.look import METHOD_COLOURS, MUTED, TOUCH_COLOURS, WRENCH_COLOUR

Tree = TypeVar("Tree")


class PosedHand(NamedTuple):
    """Pose and torques of a hand at an instant."""

    links: np.ndarray
    """Poses of its links ``(L, 3, 4)``."""
    joints: Sequence[str]
    torques: np.ndarray
    """Torques of the contacts on its joints ``(J,)`` [N.m]: negative against flexion."""


class SolvedGrasp(NamedTuple):
    """Grasp of at most ``n`` contacts under a load, with the solutions of both laws."""

    grasp: Grasp
    """Grasp in a frame with the world's axes."""
    origin: np.ndarray
    """Origin of that frame in the world ``(3,)`` [m]."""
    wrench: np.ndarray
    """Wrench that the contacts must exert ``(6,)``, about that origin [N, N.m]."""
    assessment: Assessment
    margins: tuple[np.ndarray, np.ndarray]
    """Friction margins of the closed form and of the optimum ``(n,)`` [rad]; infinite of contacts without load."""
    closed_touches: np.ndarray
    """State of each contact by the closed form: codes of a [`jaxgrasp.grip.Touch`][]."""
    law: Law
    names: Sequence[str]
    """Names of the contacts."""
    object_pose: np.ndarray
    """``(3, 4)``"""
    hand: PosedHand | None = None
    rests: bool = False
    """True if the table carries the load that the hand does not hold."""
    moving: np.ndarray = np.zeros((0, 3, 4))
    """Poses of further objects and of obstacles that move."""

    @property
    def touching(self) -> np.ndarray:
        """Mask ``(n,)`` of the contacts that touch."""
        present = self.grasp.present
        return np.ones(len(self.grasp.points), bool) if present is None else np.asarray(present) > 0.5

    @property
    def points(self) -> np.ndarray:
        """Positions of the contacts in the world ``(n, 3)`` [m]."""
        return np.asarray(self.grasp.points) + self.origin

    @property
    def escape(self) -> np.ndarray | None:
        """The twist about ``origin`` along which the object escapes, where it is proven that no forces hold it."""
        optimum = self.assessment.optimum
        if int(optimum.verdict) not in (Verdict.INFEASIBLE, Verdict.NO_CONTACTS):
            return None
        twist = -np.asarray(optimum.certificate, float)
        return twist if np.any(twist) else None

    @property
    def touches(self) -> np.ndarray:
        """State of each contact ``(n,)``: by the applied law or, if its forces do not balance the wrench, by the closed
        form; absent if neither balances.
        """
        applied = self.assessment.optimum if self.law == "optimum" else self.assessment.closed
        for answer, touches in ((applied, self.assessment.touches), (self.assessment.closed, self.closed_touches)):
            if is_balanced(int(answer.verdict)):
                return np.asarray(touches)
        return np.full(len(self.touching), Touch.ABSENT)

    def answers(self) -> tuple[tuple[str, Solution, np.ndarray], ...]:
        """Return method, solution and friction margins of both laws."""
        solutions = self.assessment.closed, self.assessment.optimum
        return tuple(zip(("B", "B-optimum"), solutions, self.margins, strict=True))

    def forces(self, answer: Solution) -> np.ndarray:
        """Return the forces ``(n, 3)`` [N] of a solution; zero at absent contacts and if they do not balance."""
        return np.where(self.touching[:, None] & bool(is_balanced(int(answer.verdict))), np.asarray(answer.forces), 0.0)


class LawComparison(NamedTuple):
    """Friction margins of both laws and contact states of the closed form."""

    margins: tuple[Array, Array]
    closed_touches: Array


def numbers_as_arrays(tree: Tree) -> Tree:
    """Convert all numbers of a tree to arrays, so that a program is compiled once for all values."""
    float_types = {int: float, float: float}
    return jax.tree.map(lambda leaf: jnp.asarray(leaf, float_types.get(type(leaf))), tree)


def compare_laws(grasp: Grasp, assessment: Assessment) -> LawComparison:
    """Compute the friction margins of both laws, and the contact states by the closed form."""
    closed, optimum = assessment.closed, assessment.optimum
    margins = [friction_margin(grasp, answer.forces, answer.moments) for answer in (closed, optimum)]
    return LawComparison((margins[0], margins[1]), assess(grasp, closed, optimum, "closed-form").touches)


HEAD, SHAFT, HEAD_RADIUS = 0.007, 0.0009, 0.0024
"""Length of an arrow's head, and radii of its shaft and of its head [m]; a short arrow is thinner all over."""
NOTHING = 1e-7
"""Size of an absent instance [m]: the number of instances is constant, so that no handle is created anew."""


class Instances(NamedTuple):
    """``N`` copies of a body that has unit size in each direction and stands along z."""

    positions: np.ndarray
    """``(N, 3)`` [m]"""
    quaternions: np.ndarray
    """``(N, 4)``, w first."""
    scales: np.ndarray
    """``(N, 3)`` [m]"""
    colours: np.ndarray
    """``(N, 3)``, bytes."""

    @property
    def is_visible(self) -> np.ndarray:
        """Mask ``(N,)`` of the copies that are not absent."""
        return self.scales.max(-1) > 2 * NOTHING

    def visible_positions(self) -> np.ndarray:
        """Return the positions of the visible copies ``(V, 3)`` [m]."""
        return self.positions[self.is_visible]

    def visible_ends(self) -> np.ndarray:
        """Return the ends of the visible copies along their own z ``(V, 3)`` [m]."""
        turns = Rotation.from_quat(self.quaternions[self.is_visible], scalar_first=True)
        along = turns.apply([0.0, 0.0, 1.0]).reshape(-1, 3)
        return self.visible_positions() + self.scales[self.is_visible, 2:] * along


class Arrows(NamedTuple):
    """Arrows by their shafts and their heads."""

    shafts: Instances
    heads: Instances


def rgb(colour: str) -> tuple[int, int, int]:
    """Convert a colour ``#rrggbb`` to three bytes."""
    red, green, blue = bytes.fromhex(colour.removeprefix("#"))
    return red, green, blue


def turned_to(axes: np.ndarray) -> np.ndarray:
    """Return quaternions ``(N, 4)`` of the shortest turns from z to unit vectors ``(N, 3)``; about x for -z."""
    x, y, z = axes.T
    quaternions = np.stack([1 + z, -y, x, np.zeros_like(z)], 1)
    # Half a turn has no shortest axis.
    quaternions[z < -1 + 1e-12] = [0.0, 1.0, 0.0, 0.0]
    return quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)


def dots(points: np.ndarray, mask: np.ndarray, radius: float, colours: np.ndarray) -> Instances:
    """Return balls of a radius [m] at the points whose mask is true."""
    sizes = np.where(mask, radius, NOTHING)
    identity = np.tile([1.0, 0.0, 0.0, 0.0], (len(points), 1))
    return Instances(points, identity, np.repeat(sizes[:, None], 3, 1), colours)


def cones(
    apexes: np.ndarray, axes: np.ndarray, friction: np.ndarray, mask: np.ndarray, side: float, colours: np.ndarray
) -> Instances:
    """Return friction cones of equal side [m], so that large friction opens a cone and does not enlarge it."""
    angles = np.arctan(np.where(mask, friction, 0.0))
    sizes = side * np.stack([np.sin(angles), np.sin(angles), np.cos(angles)], 1)
    return Instances(apexes, turned_to(axes), np.where(mask[:, None], np.maximum(sizes, NOTHING), NOTHING), colours)


def arrows(tails: np.ndarray, vectors: np.ndarray, colour: str, size: float = 1.0) -> Arrows:
    """Return arrows ``(N, 3)`` [m] from their tails; heads at most half an arrow long, zero length is invisible.

    ``size`` is the thickness relative to arrows beside a human hand.
    """
    lengths = np.linalg.norm(vectors, axis=1)
    is_visible = lengths > NOTHING
    directions = np.where(is_visible[:, None], vectors / np.where(is_visible, lengths, 1)[:, None], [0.0, 0.0, 1.0])
    sizes = np.where(is_visible, np.minimum(HEAD * size, lengths / 2), NOTHING)
    thin = np.maximum(sizes / HEAD, NOTHING)
    turns, colours = turned_to(directions), np.tile(rgb(colour), (len(tails), 1)).astype(np.uint8)
    shafts = np.stack([SHAFT * thin, SHAFT * thin, np.maximum(lengths - sizes, NOTHING)], 1)
    heads = np.stack([HEAD_RADIUS * thin, HEAD_RADIUS * thin, sizes], 1)
    starts = tails + (lengths - sizes)[:, None] * directions
    return Arrows(Instances(tails, turns, shafts, colours), Instances(starts, turns, heads, colours))


CONE, DOT = 0.016, 0.0021
"""Side of a friction cone, radius of a contact [m]."""
LONG, LONGEST, SHORTEST = 0.045, 0.07, 0.012
"""Initial length of the largest arrow, and its longest and shortest length before the scale changes [m]."""
LENGTH = 0.01
"""Length that the stated scale refers to [m]."""
LOAD = 0.05
"""Length of the load's arrow, independent of its force [m]."""
TOUCHES = np.array([rgb(TOUCH_COLOURS.get(touch, MUTED)) for touch in Touch], np.uint8)
"""Colours of contacts by what they do."""


class Drawing(NamedTuple):
    """Poses, contacts, cones and arrows that are drawn at an instant."""

    links: np.ndarray | None
    """Poses of the hand's links ``(L, 3, 4)``; None where there is no hand."""
    object_pose: np.ndarray
    """``(3, 4)``"""
    moving: np.ndarray
    """Poses of further objects and of obstacles that move ``(M, 3, 4)``."""
    contacts: Instances
    cones: Instances
    forces: dict[str, Arrows]
    """Force arrows by the method's name."""
    load: Arrows
    """Arrow of the external force on the object."""
    scale: Scale
    origin: np.ndarray
    """Centre of the object's rotation when it escapes ``(3,)`` [m]."""


def drawing(solved: SolvedGrasp, scale: Scale | None = None, size: float = 1.0) -> Drawing:
    """Compute the drawing of a grasp.

    Args:
        seen: the grasp.
        scale: of the previous drawing's arrows, which is kept while it is legible.
        size: of contacts, cones and arrows, relative to those beside a human hand.
    """
    forces = {name: solved.forces(answer) for name, answer, _ in solved.answers()}
    scale = fitting(scale, forces, size)
    colours = TOUCHES[solved.touches]
    points, normals, touching = solved.points, np.asarray(solved.grasp.normals), solved.touching
    return Drawing(
        links=None if solved.hand is None else solved.hand.links,
        object_pose=solved.object_pose,
        moving=solved.moving,
        contacts=dots(points, touching, DOT * size, colours),
        cones=cones(points, normals, np.asarray(solved.grasp.friction), touching, CONE * size, colours),
        forces={
            name: arrows(points, scale.metres * force, METHOD_COLOURS[name], size) for name, force in forces.items()
        },
        load=_load(solved, size),
        scale=scale,
        origin=np.asarray(solved.origin, float),
    )


def drawn_points(drawn: Drawing) -> np.ndarray:
    """Return points ``(P, 3)`` [m] that a picture of the contacts and arrows has to contain: contacts, tails and tips
    of all visible arrows, and the middles of the cones' rims.
    """
    ends = [drawn.contacts.visible_positions(), drawn.cones.visible_ends()]
    for each in (*drawn.forces.values(), drawn.load):
        ends += [each.shafts.visible_positions(), each.heads.visible_ends()]
    return np.concatenate(ends)


def fitting(scale: Scale | None, forces: dict[str, np.ndarray], size: float = 1.0) -> Scale:
    """Return the previous scale if it draws the largest force [N] at a legible length, else a new round scale."""
    largest = max(float(np.linalg.norm(force, axis=-1).max(initial=0)) for force in forces.values())
    if scale is not None and (largest == 0 or SHORTEST * size <= scale.metres * largest <= LONGEST * size):
        return scale
    length = round_up(LENGTH * size)
    return Scale(length, round_up(largest * length / (LONG * size)))


def _load(solved: SolvedGrasp, size: float) -> Arrows:
    """Return an arrow along the load: the opposite of the force that the contacts must exert."""
    force = -np.asarray(solved.wrench[:3], float)
    newtons = float(np.linalg.norm(force))
    vector = force * (LOAD * size / newtons) if newtons > 0 else force
    return arrows(middle(solved)[None], vector[None], WRENCH_COLOUR, size)


def middle(solved: SolvedGrasp) -> np.ndarray:
    """Return the tail of the load's arrow ``(3,)`` [m]: the object's centre with a hand, else the contacts' mean."""
    touching = solved.touching
    if solved.hand is not None or not touching.any():
        return np.asarray(solved.object_pose[:, 3], float)
    return solved.points[touching].mean(0)


TRAVEL = 0.02
"""Distance that the object's farthest point moves [m]."""
TURN = 0.7
"""Largest rotation of the object [rad]."""
PERIOD, REST_SHARE = 2.4, 0.25
"""Duration of a motion [s], and the share of it in which the object rests, half of it at either end."""


def scaled_twist(twist: np.ndarray, origin: np.ndarray, corners: np.ndarray, size: float = 1.0) -> np.ndarray:
    """Scale a twist for display: the object's farthest corner moves by ``TRAVEL``, or the object turns by ``TURN``.

    Args:
        twist: (linear, angular) ``(6,)`` about the origin, of any length.
        origin: ``(3,)`` [m].
        corners: of the object in the world ``(V, 3)`` [m].
        size: of contacts and object, relative to those beside a human hand.
    """
    speeds = np.linalg.norm(twist[:3] + np.cross(twist[3:], corners - origin), axis=1)
    fastest, turning = float(speeds.max(initial=0)), float(np.linalg.norm(twist[3:]))
    lengths = [TRAVEL * size / fastest if fastest > 0 else np.inf, TURN / turning if turning > 0 else np.inf]
    return twist * min(lengths) if np.isfinite(min(lengths)) else np.zeros(6)


def escaped(pose: np.ndarray, twist: np.ndarray, origin: np.ndarray, share: float) -> np.ndarray:
    """Move a pose ``(3, 4)`` along a share, 0 to 1, of a twist ``(6,)`` about an origin ``(3,)``."""
    rotation = Rotation.from_rotvec(share * twist[3:]).as_matrix()
    # x' = o + R (x - o) + s v.
    position = origin + rotation @ (pose[:, 3] - origin) + share * twist[:3]
    return np.concatenate([rotation @ pose[:, :3], position[:, None]], 1)


def share_at(time: float) -> float:
    """Return the share of the motion at a time [s], 0 to 1: it grows smoothly, rests, and begins again."""
    phase = (time % PERIOD) / PERIOD
    phase = min(max((phase - REST_SHARE / 2) / (1 - REST_SHARE), 0.0), 1.0)
    return phase * phase * (3 - 2 * phase)
