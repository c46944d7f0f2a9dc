"""Loads on an object in a MuJoCo state: weight, applied and inertial wrenches, and the names of loads left out."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxgrasp.interop.mujoco_selection import ModelTree, listed

if TYPE_CHECKING:
    import mujoco

NEGLIGIBLE = 1e-6
"""Part of the object's weight and contact forces below which a load goes unmentioned."""
SLOW = 1e-2
"""Part of the object's weight below which the inertial loads of parts that move in their joints go unmentioned."""
STANDARD_GRAVITY = 9.81
"""[m/s^2]: scale of loads, also where a model has no gravity."""
PASSIVE = "passive forces, such as of fluids and springs (qfrc_passive)"
ACTUATORS = "actuators"
APPLIED = "qfrc_applied"
CONSTRAINTS = "constraints other than contacts"
LOADED = "body {} is loaded by {}, which is not in the wrench"
UNSUPPORTED = "what the joint bears or drives is not in the wrench (free= takes twists that a guide leaves)"


def wrench_against_loads(
    mujoco: Any, model: mujoco.MjModel, data: mujoco.MjData, parts: np.ndarray, center: np.ndarray
) -> np.ndarray:
    """Return minus the wrench of gravity and ``xfrc_applied`` on bodies ``parts`` (ids), about ``center``."""
    is_weightless = bool(model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_GRAVITY)
    gravity = np.zeros(3) if is_weightless else model.opt.gravity
    weighed_mass = (model.body_mass * (1 - model.body_gravcomp))[parts]
    forces = weighed_mass[:, None] * gravity + data.xfrc_applied[parts, :3]
    torques = np.cross(data.xipos[parts] - center, forces) + data.xfrc_applied[parts, 3:]
    return -np.concatenate([forces.sum(0), torques.sum(0)])


def inertial_wrench(
    mujoco: Any,
    model: mujoco.MjModel,
    data: mujoco.MjData,
    parts: np.ndarray,
    center: np.ndarray,
    dofs: np.ndarray | None = None,
) -> np.ndarray:
    """Return mass times acceleration and the rate of angular momentum about ``center``, summed over ``parts``.

    Args:
        mujoco: the library.
        model: the compiled model.
        data: its state.
        parts: ids of the bodies.
        center: of the torque, in the world [m].
        dofs: ``(nv,)`` booleans: velocities and accelerations of the others are taken as zero; all where None.
    """
    total = np.zeros(6)
    moving = np.ones(model.nv) if dofs is None else dofs.astype(float)
    for part in parts:
        # data.cacc would need mj_rnePostConstraint, which writes into the caller's state.
        jacobians, rates = np.zeros((2, 3, model.nv)), np.zeros((2, 3, model.nv))
        mujoco.mj_jacBodyCom(model, data, *jacobians, part)
        mujoco.mj_jacDot(model, data, *rates, data.xipos[part], part)
        linear, angular = jacobians @ (moving * data.qacc) + rates @ (moving * data.qvel)
        spin = jacobians[1] @ (moving * data.qvel)
        axes = data.ximat[part].reshape(3, 3)
        inertia = axes @ np.diag(model.body_inertia[part]) @ axes.T
        force = model.body_mass[part] * linear
        # Euler's equation: the rate of angular momentum is I alpha + omega x (I omega).
        torque = inertia @ angular + np.cross(spin, inertia @ spin)
        total += np.concatenate([force, torque + np.cross(data.xipos[part] - center, force)])
    return total


def moving_parts(
    mujoco: Any, model: mujoco.MjModel, data: mujoco.MjData, tree: ModelTree, root: int, inside: np.ndarray
) -> list[str]:
    """Return names of bodies that move in joints of the object, where that loads it by over ``SLOW`` of its weight.

    Args:
        mujoco: the library.
        model: the compiled model.
        data: its state.
        tree: bodies of the model.
        root: id of the object's topmost body.
        inside: ``(nbody,)`` booleans: bodies of the object.
    """
    of_dof = np.asarray(model.dof_bodyid)
    internal = inside[of_dof] & (of_dof != root)
    parts = np.flatnonzero(inside)
    mass = model.body_mass[parts]
    moves = internal & ((data.qvel != 0) | (data.qacc != 0))
    if not moves.any() or not mass.any():
        return []
    center = np.average(data.xipos[parts], axis=0, weights=mass)
    reach = np.linalg.norm(data.xipos[parts] - center, axis=-1).max()
    load = inertial_wrench(mujoco, model, data, parts, center, internal)
    scale = SLOW * mass.sum() * STANDARD_GRAVITY
    if np.linalg.norm(load[:3]) <= scale and np.linalg.norm(load[3:]) <= scale * reach:
        return []
    return [tree.body_name(int(body)) for body in np.unique(of_dof[moves])]


def loads_left_out(
    mujoco: Any,
    model: mujoco.MjModel,
    data: mujoco.MjData,
    tree: ModelTree,
    root: int,
    inside: np.ndarray,
    contact_wrench: np.ndarray,
) -> list[str]:
    """Return a sentence for each kind of load on the object that is neither gravity, ``xfrc_applied`` nor a contact.

    The six coordinates of the object's root see all loads from outside and none between its parts.

    Args:
        mujoco: the library.
        model: the compiled model.
        data: its state.
        tree: bodies of the model.
        root: id of the object's topmost body.
        inside: ``(nbody,)`` booleans: bodies of the object.
        contact_wrench: of all contacts from outside, about the world's origin ``(6,)``.
    """
    name, sentences = tree.body_name(root), []
    guide = guiding_joints(tree, root, model)
    if guide is not None:
        return [guide]
    first = int(model.body_dofadr[root])
    dofs = slice(first, first + 6)
    adhesion = data.qfrc_adhesion[dofs]
    loads = {
        PASSIVE: data.qfrc_passive[dofs] - adhesion - data.qfrc_gravcomp[dofs],
        ACTUATORS: data.qfrc_actuator[dofs],
        APPLIED: data.qfrc_applied[dofs],
    }
    if model.jnt_type[model.body_jntadr[root]] == mujoco.mjtJoint.mjJNT_FREE:
        # A free joint's torque is in the body's axes, about its frame's origin.
        torque = contact_wrench[3:] - np.cross(data.xpos[root], contact_wrench[:3])
        contacts = np.concatenate([contact_wrench[:3], data.xmat[root].reshape(3, 3).T @ torque])
        # MuJoCo adds adhesion to a contact's row and takes it off as a passive force; a contact's force is net of it.
        constraints = data.qfrc_constraint[dofs] + adhesion - contacts
        loads[CONSTRAINTS + equality_names(mujoco, model, data.eq_active, inside, tree.name_of)] = constraints
    mass = model.body_mass[inside].sum()
    tolerance = NEGLIGIBLE * (mass * STANDARD_GRAVITY + np.abs(contact_wrench[:3]).sum())
    for source, load in loads.items():
        if np.abs(load).max() > tolerance:
            sentences.append(LOADED.format(repr(name), source))
    return sentences


def guiding_joints(tree: ModelTree, root: int, model: Any) -> str | None:
    """Return a sentence on the joints that tie an object to the rest of the model; None for one that moves freely."""
    first, count = int(model.body_jntadr[root]), int(model.body_jntnum[root])
    # Six coordinates to the world, as of a free joint or of slides and a ball, guide nothing.
    if int(model.body_dofnum[root]) == 6 and tree.welds[tree.parents[root]] == 0:
        return None
    joints = listed([tree.name_of("joint", joint) or f"joint {joint}" for joint in range(first, first + count)])
    parent = tree.body_name(int(tree.parents[root]))
    return f"body {tree.body_name(root)!r} hangs on {parent!r} by {joints}: {UNSUPPORTED}"


def equality_names(
    mujoco: Any, model: Any, is_active: np.ndarray, inside: np.ndarray, name_of: Callable[[str, int], str]
) -> str:
    """Return the names of active connect and weld constraints between the object and something else, in brackets.

    Args:
        mujoco: the library.
        model: the compiled model, MuJoCo's own or in MJX.
        is_active: ``(neq,)`` booleans of the model's equality constraints.
        inside: ``(nbody,)`` booleans: bodies of the object.
        name_of: returns the name of an element by kind and id.
    """
    names = []
    for index in np.flatnonzero(is_active).tolist():
        if model.eq_type[index] not in (int(mujoco.mjtEq.mjEQ_CONNECT), int(mujoco.mjtEq.mjEQ_WELD)):
            continue
        ends = [int(model.eq_obj1id[index]), int(model.eq_obj2id[index])]
        if model.eq_objtype[index] == int(mujoco.mjtObj.mjOBJ_SITE):
            ends = [int(model.site_bodyid[end]) for end in ends]
        if inside[ends[0]] != inside[ends[1]]:
            names.append(repr(name_of("equality", index) or f"equality {index}"))
    return f" ({', '.join(names)})" if names else ""
