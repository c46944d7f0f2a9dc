"""Contacts out of a running MuJoCo simulation: one body, what touches it, and the wrench that holds it."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from jaxgrasp.model.grasp import Grasp
from jaxgrasp.validation.checked import checked
from jaxgrasp.validation.optional_library import optional_library

if TYPE_CHECKING:
    import mujoco

FINGERTIP_STIFFNESS = 1000.0
"""[N/m]: a fingertip's pulp gives about one millimetre for one newton."""


@dataclass(frozen=True)
class MujocoGrasp:
    """The n contacts of a body in a simulator's state, and the simulator's own answer beside them.

    All in one frame: the world's axes, with the origin at the body's centre of mass, so that the torque
    of a weight is zero and the wrench of a resting body does not depend on how it is turned.
    """

    grasp: Grasp
    """NumPy float64 arrays, in the order of ``data.contact``."""
    wrench: np.ndarray
    """``(6,)``: force [N] and torque [N.m] that the contacts must exert on the body."""
    depths: np.ndarray
    """``(n,)``: penetration [m] past the distance where MuJoCo starts to press; never negative."""
    forces: np.ndarray
    """``(n, 3)``: MuJoCo's contact forces on the body [N]; zero rows where nothing presses."""
    links: tuple[str, ...]
    """The body that touches, contact by contact; ``"body 7"`` if it has no name."""


@checked
def from_mujoco(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    body: str | int,
    *,
    squeeze: Literal["stiffness", "normal_force"] = "stiffness",
    stiffness: float | Mapping[str, float] = FINGERTIP_STIFFNESS,
    contribution: float | Mapping[str, float] = 1.0,
    accelerating: bool = False,
) -> MujocoGrasp:
    """The contacts between a free body and everything else, as a Grasp.

    Bodies welded to ``body`` count as part of it. The state is read, never changed: call ``mj_forward``
    first if positions were edited (after ``mj_step`` the contacts belong to the state before that step).

    MuJoCo's torsional and rolling moments (``condim`` 4 and 6) have no place in a point contact: they are
    left out, with a warning if they are not zero, and then ``grasp_matrix(points) @ forces`` misses them.
    Of two sliding coefficients that differ the first is taken.

    Args:
        model: the compiled model.
        data: its state, with contacts and contact forces computed.
        body: name or id of the held body.
        squeeze: where squeezing forces come from: ``"stiffness"`` is eq. 6, c K depth;
            ``"normal_force"`` is MuJoCo's own normal force.
        stiffness: K of eq. 6 [N/m], one or by name of the touching body; for ``"stiffness"`` only.
        contribution: c of eq. 6, one or by name of the touching body; for ``"stiffness"`` only.
        accelerating: add the inertial part to the wrench, so that MuJoCo's forces balance it in motion
            too; without it the wrench is the one that holds the body still.

    Returns:
        The grasp and the wrench against gravity and ``xfrc_applied``. Loads that joints, equality
        constraints, fluids or ``qfrc_applied`` put on the body are not in it.

    Raises:
        ImportError: without MuJoCo.
        ValueError: for an unknown or immovable body, an unknown ``squeeze``, a ``stiffness`` or a
            ``contribution`` that is negative, not finite or lacks a link.
    """
    mujoco = import_mujoco("from_mujoco")
    if squeeze not in ("stiffness", "normal_force"):
        raise ValueError(f"squeeze is {squeeze!r}: expected 'stiffness' or 'normal_force'")
    parts = _parts(mujoco, model, body)
    center = np.average(data.xipos[parts], axis=0, weights=model.body_mass[parts])
    contacts = _contacts_of(model, data, parts)
    links = tuple(_body_name(model, link) for _, _, link in contacts)
    points, normals, friction, depths, forces = _read(mujoco, model, data, contacts)
    by_name = (("stiffness", stiffness), ("contribution", contribution))
    scales = [_per_link(name, value, links) for name, value in by_name]
    # Eq. 6 in NumPy: importing this module must not start JAX's backend for one product.
    eq_6 = scales[0] * scales[1] * depths
    pressing = np.maximum(np.einsum("ij,ij->i", forces, normals), 0)
    wrench = _wrench_against_loads(mujoco, model, data, parts, center)
    if accelerating:
        wrench = wrench + _inertial_wrench(mujoco, model, data, parts, center)
    grasp = Grasp(points - center, normals, friction, eq_6 if squeeze == "stiffness" else pressing)
    return MujocoGrasp(grasp, wrench, depths, forces, links)


def import_mujoco(user: str) -> Any:
    """MuJoCo, or one line that says what to install for the function that needs it."""
    return optional_library("mujoco", missing=f"{user} needs MuJoCo: pip install 'jaxgrasp[hands]'")


def _parts(mujoco: Any, model: mujoco.MjModel, body: str | int) -> np.ndarray:
    """Ids of the body and of all that is welded to it."""
    if isinstance(body, str):
        index = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, body)
        if index < 0:
            known = ", ".join(_body_name(model, i) for i in range(1, min(model.nbody, 12)))
            more = ", ..." if model.nbody > 12 else ""
            raise ValueError(f"body is {body!r}: expected a body of this model, such as {known}{more}")
    else:
        index = int(body)
        if not 0 <= index < model.nbody:
            raise ValueError(f"body is {body!r}: expected an id from 0 to {model.nbody - 1}")
    weld = model.body_weldid[index]
    if weld == 0:
        raise ValueError(f"body is {body!r}, which cannot move: expected a body that contacts hold")
    return np.flatnonzero(model.body_weldid == weld)


def _body_name(model: mujoco.MjModel, index: int) -> str:
    return model.body(index).name or f"body {index}"


def _contacts_of(model: mujoco.MjModel, data: mujoco.MjData, parts: np.ndarray) -> list[tuple[int, float, int]]:
    """(index of the contact, sign that turns its normal into the body, id of the other body)."""
    found = []
    for i in range(data.ncon):
        contact = data.contact[i]
        # A geom is -1 where a flex touches, and the address is -1 where MuJoCo left the contact out.
        if contact.efc_address < 0:
            continue
        first, second = (int(model.geom_bodyid[g]) if g >= 0 else -1 for g in contact.geom)
        if (first in parts) == (second in parts):
            continue
        found.append((i, -1.0, second) if first in parts else (i, 1.0, first))
    return found


def _read(
    mujoco: Any, model: mujoco.MjModel, data: mujoco.MjData, contacts: list[tuple[int, float, int]]
) -> tuple[np.ndarray, ...]:
    """Points, inward normals, friction, depths and forces on the body, in world axes."""
    n, lost = len(contacts), 0
    points, normals, forces = np.zeros((n, 3)), np.zeros((n, 3)), np.zeros((n, 3))
    friction, depths, force_and_moment = np.zeros(n), np.zeros(n), np.zeros(6)
    for row, (index, sign, _) in enumerate(contacts):
        contact = data.contact[index]
        frame = contact.frame.reshape(3, 3)
        mujoco.mj_contactForce(model, data, index, force_and_moment)
        points[row] = contact.pos
        normals[row] = sign * frame[0] / np.linalg.norm(frame[0])
        friction[row] = contact.friction[0] if contact.dim > 1 else 0.0
        depths[row] = max(contact.includemargin - contact.dist, 0.0)
        forces[row] = sign * force_and_moment[:3] @ frame
        lost += bool(np.any(force_and_moment[3:]))
    if lost:
        warnings.warn(
            f"{lost} of {n} contacts carry torsional or rolling moments (condim 4 or 6), which a Grasp leaves out",
            stacklevel=3,
        )
    return points, normals, friction, depths, forces


def _per_link(name: str, value: float | Mapping[str, float], links: tuple[str, ...]) -> np.ndarray:
    by_link = dict(value) if isinstance(value, Mapping) else None
    for key, each in ({"": value} if by_link is None else by_link).items():
        if not (isinstance(each, (int, float, np.number)) and np.isfinite(each) and each >= 0):
            place = f"[{key!r}]" if key else ""
            raise ValueError(f"{name}{place} is {each!r}: expected a finite number, zero or more")
    if by_link is None:
        return np.full(len(links), value, float)
    for link in links:
        if link not in by_link:
            raise ValueError(f"{name} has no entry for {link!r}: expected one for every body that touches")
    return np.array([by_link[link] for link in links], float)


def _wrench_against_loads(
    mujoco: Any, model: mujoco.MjModel, data: mujoco.MjData, parts: np.ndarray, center: np.ndarray
) -> np.ndarray:
    """Minus gravity's wrench and that of ``xfrc_applied``, about ``center``."""
    off = bool(model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_GRAVITY)
    gravity = np.zeros(3) if off else model.opt.gravity
    falling = (model.body_mass * (1 - model.body_gravcomp))[parts]
    forces = falling[:, None] * gravity + data.xfrc_applied[parts, :3]
    torques = np.cross(data.xipos[parts] - center, forces) + data.xfrc_applied[parts, 3:]
    return -np.concatenate([forces.sum(0), torques.sum(0)])


def _inertial_wrench(
    mujoco: Any, model: mujoco.MjModel, data: mujoco.MjData, parts: np.ndarray, center: np.ndarray
) -> np.ndarray:
    """Mass times acceleration and the rate of angular momentum about ``center``."""
    total = np.zeros(6)
    for part in parts:
        # data.cacc would need mj_rnePostConstraint, which writes into the caller's state.
        jacobians, rates = np.zeros((2, 3, model.nv)), np.zeros((2, 3, model.nv))
        mujoco.mj_jacBodyCom(model, data, *jacobians, part)
        mujoco.mj_jacDot(model, data, *rates, data.xipos[part], part)
        linear, angular = jacobians @ data.qacc + rates @ data.qvel
        turning = jacobians[1] @ data.qvel
        axes = data.ximat[part].reshape(3, 3)
        inertia = axes @ np.diag(model.body_inertia[part]) @ axes.T
        force = model.body_mass[part] * linear
        torque = inertia @ angular + np.cross(turning, inertia @ turning)
        total += np.concatenate([force, torque + np.cross(data.xipos[part] - center, force)])
    return total
