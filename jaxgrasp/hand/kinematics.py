"""Frames of a posed hand, Jacobian of its contact points, and joint torques of contact forces."""

from functools import cache
from typing import NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxgrasp.model.arrays import AnyArray, Float
from jaxgrasp.model.hand import Hand, HandFrames, Pose, Posture
from jaxgrasp.numerics import vec3
from jaxgrasp.numerics.tiling import spread
from jaxgrasp.numerics.vec3 import Vec3
from jaxgrasp.validation.checked import check_numbers, checked

Axes = tuple[Vec3, Vec3, Vec3]
"""A rotation by its columns."""
Tree = TypeVar("Tree")


class Bodies(NamedTuple):
    """Frames of several bodies in batches: components of shape ``(bodies, B)``."""

    origin: Vec3
    axes: Axes


class PosedBodies(NamedTuple):
    """A posed hand, batch-last."""

    joints: Bodies
    axes: Vec3
    links: Bodies


@checked
@jax.jit
def pose_hand(hand: Hand, posture: Posture) -> HandFrames:
    """Compute the frames of a hand's joints and links.

    Args:
        hand: its tree of ``J`` joints and ``L`` links.
        posture: wrist and angles, with any leading axes that broadcast.

    Returns:
        Frames in the world ``(..., J)`` and ``(..., L)``.

    Raises:
        ValueError: where there are not as many angles as joints.
    """
    flat, batch = flatten_posture(hand, posture)
    bodies = place_bodies(hand, flat)
    return HandFrames(
        joints=Pose(vectors(bodies.joints.origin, batch), _rotations(bodies.joints.axes, batch)),
        axes=vectors(bodies.axes, batch),
        links=Pose(vectors(bodies.links.origin, batch), _rotations(bodies.links.axes, batch)),
    )


def flatten_posture(hand: Hand, posture: Posture) -> tuple[Posture, tuple[int, ...]]:
    """Return the posture with its leading axes broadcast and flattened into one, and their broadcast shape."""
    count = len(hand.joints)
    origin, rotation, angles = map(jnp.asarray, (posture.wrist.origin, posture.wrist.rotation, posture.angles))
    if angles.shape[-1:] != (count,):
        raise ValueError(f"angles has shape {angles.shape}: expected (..., {count}), one for each joint")
    batch = jnp.broadcast_shapes(origin.shape[:-1], rotation.shape[:-2], angles.shape[:-1])
    wrist = Pose(spread(batch, origin, (3,)), spread(batch, rotation, (3, 3)))
    return Posture(wrist, spread(batch, angles, (count,))), batch


def place_bodies(hand: Hand, posture: Posture) -> PosedBodies:
    """Compute the frames of a flat batch of postures, joints of equal depth at once."""
    wrist, angles, rows, slides = body(posture.wrist), posture.angles.T, levels(hand.parents), hand.slides[:, None]
    rotations, shifts = (jnp.where(mask, angles, 0) for mask in (~slides, slides))
    placed, axes = [wrist], []
    for depth, row in enumerate(rows):
        parents = [hand.parents[j] for j in row]
        carrier = take(placed[-1], np.searchsorted(rows[depth - 1], parents) if depth else np.zeros(len(row), int))
        origin = vec3.add(carrier.origin, vec3.rotate_back(carrier.axes, _column(hand.origins[row])))
        rest_axes = compose(carrier.axes, _columns(hand.rests[row]))
        axis = _column(hand.axes[row])
        axes.append(vec3.rotate_back(rest_axes, axis))
        if slides[row].any():
            origin = vec3.add(origin, vec3.scale(shifts[row], axes[-1]))
        placed.append(Bodies(origin, compose(rest_axes, _rotation(axis, rotations[row]))))
    order = np.argsort(np.concatenate([np.zeros(0, int), *rows]))
    # The wrist stands last, where an index of -1 finds it.
    all_placed = _joined([*placed[1:], wrist])
    joints = take(all_placed, order)
    links = take(_joined([joints, wrist]), np.array([link.joint for link in hand.links]))
    no_joint = jax.tree.map(lambda c: c[:0], wrist.origin)
    return PosedBodies(joints, take(_joined([*axes, no_joint]), order), links)


@cache
def levels(parents: tuple[int, ...]) -> list[np.ndarray]:
    """Group the joints by the number of joints that carry them; each level in ascending order."""
    depth: list[int] = []
    for parent in parents:
        depth.append(0 if parent < 0 else depth[parent] + 1)
    return [np.flatnonzero(np.array(depth) == d) for d in range(max(depth, default=-1) + 1)]


def ancestry(hand: Hand) -> np.ndarray:
    """Return the booleans ``(L, J)`` that tell which joints move which links."""
    return _ancestry(hand.parents, tuple(link.joint for link in hand.links))


@cache
def _ancestry(parents: tuple[int, ...], carriers: tuple[int, ...]) -> np.ndarray:
    """Return which joints move each body, given the joint that carries it; -1 for the wrist."""
    moves = np.zeros((len(carriers), len(parents)), bool)
    for row, joint in zip(moves, carriers, strict=True):
        while joint >= 0:
            row[joint] = True
            joint = parents[joint]
    return moves


def body(pose: Pose) -> Bodies:
    """Convert a flat batch of poses to one body, batch-last."""
    origin, rotation = pose.origin.T[:, None], jnp.moveaxis(pose.rotation, 0, -1)[:, :, None]
    return Bodies(Vec3(*origin), (Vec3(*rotation[:, 0]), Vec3(*rotation[:, 1]), Vec3(*rotation[:, 2])))


def bodies_of(poses: Pose) -> Bodies:
    """Convert the poses ``(n,)`` of the parts of one hand to bodies, in a batch of one."""
    return Bodies(_column(poses.origin), _columns(poses.rotation))


def compose(outer: Axes, inner: Axes) -> Axes:
    """Compute the product ``outer inner`` of two rotations."""
    x, y, z = (vec3.rotate_back(outer, column) for column in inner)
    return x, y, z


def take(parts: Tree, index: np.ndarray) -> Tree:
    """Gather rows of every component."""
    return jax.tree.map(lambda c: c[index], parts)


def _joined(parts: list[Tree]) -> Tree:
    return jax.tree.map(lambda *arrays: jnp.concatenate(arrays), *parts)


def _column(rows: AnyArray) -> Vec3:
    """Split ``(J, 3)`` into components ``(J, 1)``."""
    return Vec3(*(jnp.asarray(rows)[:, i : i + 1] for i in range(3)))


def _columns(rotations: AnyArray) -> Axes:
    """Split rotations ``(J, 3, 3)`` into columns with components ``(J, 1)``."""
    return _column(rotations[..., 0]), _column(rotations[..., 1]), _column(rotations[..., 2])


def _rotation(axis: Vec3, angle: Array) -> Axes:
    """Compute Rodrigues' rotation about a unit axis, by its columns."""
    cosine, sine = jnp.cos(angle), jnp.sin(angle)
    zero = jnp.zeros_like(angle)

    def column(i: int) -> Vec3:
        unit = Vec3(*(zero + (i == j) for j in range(3)))
        along = vec3.scale((1 - cosine) * axis[i], axis)
        return vec3.add(vec3.add(vec3.scale(cosine, unit), vec3.scale(sine, vec3.cross(axis, unit))), along)

    return (column(0), column(1), column(2))


def vectors(vector: Vec3, batch: tuple[int, ...]) -> Array:
    """Stack components ``(bodies, B)`` into vectors ``(..., bodies, 3)``."""
    return jnp.stack(vector, -1).swapaxes(0, 1).reshape(*batch, vector.x.shape[0], 3)


def _rotations(axes: Axes, batch: tuple[int, ...]) -> Array:
    columns = jnp.stack([jnp.stack(axis, -1) for axis in axes], -1)
    return columns.swapaxes(0, 1).reshape(*batch, columns.shape[0], 3, 3)


def joint_twists(hand: Hand, frames: HandFrames) -> Float[Array, "J 6"]:
    """Return the twist that each joint of one posed hand gives the bodies that it moves, for a unit of its rate.

    A twist is the velocity of a body's point at the world's origin, then its angular velocity.
    """
    # (o x z, z) of a hinge, (z, 0) of a slide
    hinges = jnp.concatenate([jnp.cross(frames.joints.origin, frames.axes), frames.axes], -1)
    slides = jnp.concatenate([frames.axes, jnp.zeros_like(frames.axes)], -1)
    return jnp.where(hand.slides[:, None], slides, hinges)


def frame_rates(hand: Hand, frames: HandFrames) -> HandFrames:
    """Return the derivatives of the frames of one posed hand by its joint angles, which are the first axis."""
    twists = joint_twists(hand, frames)
    linear, angular = twists[:, None, :3], twists[:, None, 3:]

    def rates(pose: Pose, moves: np.ndarray) -> Pose:
        # do = v + w x o, da = w x a for each column a of the rotation
        origin = moves * (linear + jnp.cross(angular, jnp.asarray(pose.origin)))
        columns = jnp.swapaxes(jnp.asarray(pose.rotation), -1, -2)
        turned = moves[..., None] * jnp.cross(angular[:, None], columns)
        return Pose(origin, jnp.swapaxes(turned, -1, -2))

    of_links = ancestry(hand).T[..., None].astype(float)
    of_joints = _ancestry(hand.parents, tuple(range(len(hand.joints)))).T[..., None].astype(float)
    axes = of_joints * jnp.cross(angular, jnp.asarray(frames.axes))
    return HandFrames(rates(frames.joints, of_joints), axes, rates(frames.links, of_links))


@checked
def contact_jacobian(
    hand: Hand, frames: HandFrames, points: Float[AnyArray, "*batch L 3"]
) -> Float[Array, "*batch L 3 J"]:
    """Compute the Jacobian of a point of each link: d point / d angle [m/rad, or 1 for joints that slide].

    Args:
        hand: whose tree tells which joints move which links.
        frames: of the posed hand.
        points: one of each link, in the world [m]; they move with their links.

    Returns:
        Joint axis x (point - joint) of hinges, the axis of joints that slide; zero for joints that do not carry
        the link.
    """
    moves = ancestry(hand)
    arms = jnp.asarray(points)[..., :, None, :] - frames.joints.origin[..., None, :, :]
    axes = frames.axes[..., None, :, :]
    # J_j = z_j x (p - o_j) of a hinge, z_j of a slide
    columns = jnp.where(hand.slides[:, None], axes, jnp.cross(axes, arms))
    return jnp.where(moves[:, :, None], columns, 0).swapaxes(-1, -2)


@checked
def joint_torques(
    hand: Hand,
    frames: HandFrames,
    points: Float[AnyArray, "*batch L 3"],
    forces: Float[AnyArray, "*batch L 3"],
    couples: Float[AnyArray, "*batch L 3"] | None = None,
) -> Float[Array, "*batch J"]:
    """Compute the joint torques of contact forces: J^T (-f) [N.m].

    ``forces`` are those of the hand on the object; the hand feels their opposites. A torque is positive
    where it helps a joint's positive angle: a torque that resists flexion is negative, and a glove renders it. For
    joints that slide it is the force along their axis [N].

    Args:
        hand: whose tree tells which joints carry which links.
        frames: of the posed hand, from [`jaxgrasp.hand.pose_hand`][].
        points: one contact of each link, in the world [m], such as those of [`jaxgrasp.hand.find_contacts`][].
        forces: on the object [N]; zero where a link does not touch.
        couples: of soft contacts on the object beside the forces, as vectors [N.m]; none where not given.
    """
    arrays = {"points": points, "forces": forces} | ({} if couples is None else {"couples": couples})
    for name, array in arrays.items():
        check_numbers(name, array, (len(hand.links), 3))
    moves = ancestry(hand).T.astype(float)
    reactions = -jnp.asarray(forces)
    total = jnp.einsum("jl,...lc->...jc", moves, reactions)
    moments = jnp.cross(jnp.asarray(points), reactions)
    if couples is not None:
        moments = moments - couples
    moment = jnp.einsum("jl,...lc->...jc", moves, moments)
    # tau_j = z_j . (sum p x (-f) - m - o_j x sum(-f)) of a hinge, z_j . sum(-f) of a slide
    wrench_part = jnp.where(hand.slides[:, None], total, moment - jnp.cross(frames.joints.origin, total))
    return jnp.sum(frames.axes * wrench_part, -1)
