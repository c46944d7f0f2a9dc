"""Contacts of one object in a MuJoCo state, the bodies that touch it, and the wrench that holds it."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from jaxgrasp.interop.mujoco_loads import inertial_wrench, loads_left_out, moving_parts, wrench_against_loads
from jaxgrasp.interop.mujoco_selection import (
    ContactSelection,
    Element,
    Exclude,
    ModelTree,
    listed,
    select_contacts,
    tree_of_mujoco,
)
from jaxgrasp.model.grasp import Grasp
from jaxgrasp.validation.checked import checked
from jaxgrasp.validation.optional_library import optional_library

if TYPE_CHECKING:
    import mujoco

FINGERTIP_STIFFNESS = 1000.0
"""[N/m]: a fingertip's pulp gives about one millimetre for one newton."""
ROLLING = (
    "rolling friction (condim 6) of the contacts with {} is left out: a Grasp has sliding and torsional friction only"
)
ADHESION = "adhesion of the contacts with {} is left out: a Grasp's contacts do not pull"
PASSIVE = 4
"""MuJoCo's ``contact.exclude`` of contacts that are passive forces instead of constraints."""
ANISOTROPIC = "two sliding coefficients of the contacts with {} differ: the smaller is taken for both directions"


@dataclass(frozen=True)
class MujocoGrasp:
    """The n contacts of an object in a simulator's state, and the simulator's own forces beside them.

    All in one frame: the world's axes, with the origin at the object's centre of mass, so that the torque
    of a weight is zero and the wrench of a resting object does not depend on how it is turned.
    """

    grasp: Grasp
    """NumPy float64 arrays, in the order of ``data.contact``; ``torsion`` is None where no contact has any."""
    wrench: np.ndarray
    """``(6,)``: force [N] and torque [N.m] that the contacts must exert on the object."""
    depths: np.ndarray
    """``(n,)``: penetration [m] past the distance where MuJoCo starts to press; never negative."""
    forces: np.ndarray
    """``(n, 3)``: MuJoCo's contact forces on the object [N]; zero rows where nothing presses."""
    links: tuple[str, ...]
    """Name of the touching body or flex of each contact, such as ``"body 7"`` where it has none."""
    moments: np.ndarray
    """``(n, 3)``: MuJoCo's torsional and rolling moments on the object at the contacts [N.m] (``condim`` 4 and 6)."""
    other_wrench: np.ndarray
    """``(6,)``: force and torque that contacts left out by ``hand=`` and ``exclude=`` exert on the object now.

    ``wrench`` is for a hand that bears all loads alone; ``wrench - other_wrench`` is its share beside a table.
    """


@checked
def from_mujoco(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    body: str | int,
    *,
    hand: Element | Sequence[Element] | None = None,
    exclude: Exclude = (),
    squeeze: Literal["stiffness", "normal_force"] = "normal_force",
    stiffness: float | Mapping[str, float] | None = None,
    contribution: float | Mapping[str, float] | None = None,
    accelerating: bool = False,
) -> MujocoGrasp:
    """Read the contacts between an object and a hand, as a Grasp, from a MuJoCo state.

    The object is ``body`` with all that is welded to it and all bodies below it in joints, such as a lid: their weights
    count, contacts between them do not. The state is read, never changed: call ``mj_forward`` first if positions were
    edited (after ``mj_step`` the contacts belong to the state before that step).

    Contacts count where MuJoCo lets them press: those that are only within a gap do not. ``condim`` 1 is a contact
    without friction, 3 has friction, 4 has torsional friction too, which becomes the grasp's ``torsion``. MuJoCo's
    pyramidal cones lie inside the round ones of a Grasp.

    Args:
        model: the compiled model.
        data: its state, with contacts and contact forces computed.
        body: name or id of the held body.
        hand: elements whose contacts count: names of bodies, geoms or flexes, or ids of bodies; a body stands for its
            whole subtree, ``"world"`` for the world's own geoms. Names are looked for in this order. Contacts with
            everything but the object count where not given: a table too.
        exclude: elements whose contacts do not count, such as ``"table"``, or pairs of elements, such as
            ``[("table", "knob")]``, where only contacts between the two do not. Parts of the object may be named.
        squeeze: source of squeezing forces: ``"normal_force"`` is MuJoCo's own normal force; ``"stiffness"`` is eq. 6,
            c K depth. A K that is not that of the model's contacts gives other forces than the simulator's: with
            1,000 N/m a margin of a MuJoCo grip came out 2.6 times off.
        stiffness: K of eq. 6 [N/m], one or by name of the touching body or flex; 1,000 N/m where not given. Only with
            ``squeeze="stiffness"``.
        contribution: c of eq. 6, likewise; 1 where not given.
        accelerating: add the inertial loads to the wrench, so that MuJoCo's forces balance it in motion
            too; without it the wrench is the one that holds the object still.

    Returns:
        The grasp and the wrench against gravity and ``xfrc_applied`` on all parts of the object.

    Raises:
        ImportError: without MuJoCo.
        ValueError: for an unknown or immovable body; a name or id in ``hand`` or ``exclude`` that the model lacks or
            that cannot be meant; an unknown ``squeeze``; a ``stiffness`` or a ``contribution`` that is negative, not
            finite, lacks a link, or is given without ``squeeze="stiffness"``; an object that sleeps (MuJoCo's flag
            ``sleep``), whose contacts are not computed.

    Warns:
        UserWarning: by name of what is not in the answer: rolling friction (``condim`` 6), the larger of two sliding
            coefficients that differ, adhesion, contacts that MuJoCo handles as passive forces, loads of joints,
            equality constraints, actuators, fluids and ``qfrc_applied``, and inertial loads of parts that move in the
            object's own joints while ``accelerating`` is False.
    """
    mujoco = import_mujoco("from_mujoco")
    if squeeze not in ("stiffness", "normal_force"):
        raise ValueError(f"squeeze is {squeeze!r}: expected 'stiffness' or 'normal_force'")
    check_unused(squeeze, stiffness=stiffness, contribution=contribution)
    tree = tree_of_mujoco(mujoco, model)
    root = tree.object_root(body)
    if data.body_awake[root] == int(mujoco.mjtSleepState.mjS_ASLEEP):
        raise ValueError(
            f"body {body!r} sleeps, and MuJoCo computes no contacts of it: clear the flag sleep of the model"
        )
    inside = tree.subtree(root)
    parts = np.flatnonzero(inside)
    selection = select_contacts(tree, body, tree.shapes_of(inside), hand, exclude)
    center = np.average(data.xipos[parts], axis=0, weights=model.body_mass[parts])
    touching = _read(mujoco, model, data, selection.is_object, center)
    is_selected = selection.is_selected(*touching.shapes.T)
    contacts, others = touching.take(is_selected), touching.take(~is_selected)
    links = tuple(tree.link_name(shape) for shape in _other_shapes(contacts.shapes, selection.is_object))
    by_name = (("stiffness", stiffness, FINGERTIP_STIFFNESS), ("contribution", contribution, 1.0))
    scales = [_per_link(name, default if value is None else value, links) for name, value, default in by_name]
    # Eq. 6 in NumPy: importing this module must not start JAX's backend for one product.
    eq_6 = scales[0] * scales[1] * contacts.depths
    pressing = np.maximum(np.einsum("ij,ij->i", contacts.forces, contacts.normals), 0)
    wrench = wrench_against_loads(mujoco, model, data, parts, center)
    about_origin = touching.wrench()
    about_origin[3:] += np.cross(center, about_origin[:3])
    left_out = _friction_left_out(contacts, links) + _passive_contacts(model, data, tree, selection)
    left_out += loads_left_out(mujoco, model, data, tree, root, inside, about_origin)
    if accelerating:
        wrench = wrench + inertial_wrench(mujoco, model, data, parts, center)
    elif moving := moving_parts(mujoco, model, data, tree, root, inside):
        left_out.append(
            f"parts of body {tree.body_name(root)!r} move in their joints: inertial loads of {listed(moving)} are not "
            "in the wrench: accelerating=True adds those of the whole object"
        )
    for sentence in left_out:
        warnings.warn(sentence, stacklevel=3)
    has_torsion = bool((contacts.dims >= 4).any())
    grasp = Grasp(
        contacts.points,
        contacts.normals,
        contacts.friction,
        eq_6 if squeeze == "stiffness" else pressing,
        torsion=contacts.torsion if has_torsion else None,
    )
    return MujocoGrasp(grasp, wrench, contacts.depths, contacts.forces, links, contacts.moments, others.wrench())


def import_mujoco(user: str) -> Any:
    """Return MuJoCo; raise ImportError with the command that installs it for the function that needs it."""
    return optional_library("mujoco", missing=f"{user} needs MuJoCo: pip install 'jaxgrasp[hands]'")


def check_unused(squeeze: str, **scales: Any) -> None:
    """Raise ValueError for factors of eq. 6 that the choice of ``squeeze`` would leave unused."""
    for name, value in scales.items():
        if value is not None and squeeze != "stiffness":
            raise ValueError(f"{name} is given, but squeeze={squeeze!r} does not use it: add squeeze='stiffness'")


@dataclass(frozen=True)
class _Contacts:
    """Contacts between the object and anything else that press or may press, about the object's centre of mass."""

    shapes: np.ndarray
    """``(n, 2)``: numbers of both shapes."""
    points: np.ndarray
    normals: np.ndarray
    friction: np.ndarray
    torsion: np.ndarray
    depths: np.ndarray
    forces: np.ndarray
    moments: np.ndarray
    dims: np.ndarray
    """``(n,)``: MuJoCo's ``condim``: 1, 3, 4 or 6."""
    is_anisotropic: np.ndarray
    """``(n,)``: booleans where two sliding coefficients differ."""
    adhesion: np.ndarray
    """``(n,)``: [N]."""

    def take(self, mask: np.ndarray) -> _Contacts:
        """Return the contacts of a mask."""
        return _Contacts(*(getattr(self, field.name)[mask] for field in fields(self)))

    def wrench(self) -> np.ndarray:
        """Return the force and torque of all contacts together ``(6,)``."""
        torques = np.cross(self.points, self.forces) + self.moments
        return np.concatenate([self.forces.sum(0), torques.sum(0)])


def _other_shapes(shapes: np.ndarray, is_object: np.ndarray) -> list[int]:
    """Return the number of each contact's shape that is not the object's."""
    return np.where(is_object[shapes[:, 0]], shapes[:, 1], shapes[:, 0]).tolist()


def _shapes(model: mujoco.MjModel, contact: Any) -> np.ndarray:
    """Return ``(ncon, 2)`` numbers of the shapes that touch: geoms first, then flexes."""
    geoms, flexes = np.reshape(contact.geom, (-1, 2)), np.reshape(contact.flex, (-1, 2))
    # A geom is -1 where a flex touches.
    return np.where(geoms >= 0, geoms, model.ngeom + flexes)


def _read(
    mujoco: Any, model: mujoco.MjModel, data: mujoco.MjData, is_object: np.ndarray, center: np.ndarray
) -> _Contacts:
    """Return the contacts between the object and anything else."""
    contact = data.contact
    shapes = _shapes(model, contact)
    shape_is_object = is_object[shapes]
    # The address is -1 where MuJoCo exerts no force, such as within a gap.
    indices = np.flatnonzero((np.ravel(contact.efc_address) >= 0) & (shape_is_object[:, 0] != shape_is_object[:, 1]))
    signs = np.where(shape_is_object[indices, 0], -1.0, 1.0)
    frames = np.reshape(contact.frame, (-1, 3, 3))[indices]
    local = np.zeros((len(indices), 6))
    for row, index in enumerate(indices):
        mujoco.mj_contactForce(model, data, int(index), local[row])
    normals = signs[:, None] * frames[:, 0]
    dims = np.ravel(contact.dim)[indices]
    coefficients = np.reshape(contact.friction, (-1, 5))[indices]
    return _Contacts(
        shapes=shapes[indices],
        points=np.reshape(contact.pos, (-1, 3))[indices] - center,
        normals=normals / np.linalg.norm(normals, axis=-1, keepdims=True),
        friction=np.where(dims > 1, coefficients[:, :2].min(-1), 0.0),
        torsion=np.where(dims > 3, coefficients[:, 2], 0.0),
        depths=np.maximum(np.ravel(contact.includemargin)[indices] - np.ravel(contact.dist)[indices], 0.0),
        forces=signs[:, None] * np.einsum("ni,nij->nj", local[:, :3], frames),
        moments=signs[:, None] * np.einsum("ni,nij->nj", local[:, 3:], frames),
        dims=dims,
        is_anisotropic=(dims > 1) & (coefficients[:, 0] != coefficients[:, 1]),
        adhesion=np.ravel(contact.adhesion)[indices],
    )


def _friction_left_out(contacts: _Contacts, links: tuple[str, ...]) -> list[str]:
    """Return a sentence for each property of contacts that a Grasp does not have, with the links' names."""
    cases = (
        (contacts.dims == 6, ROLLING),
        (contacts.is_anisotropic, ANISOTROPIC),
        (contacts.adhesion != 0, ADHESION),
    )
    named = ((text, [link for link, is_case in zip(links, mask, strict=True) if is_case]) for mask, text in cases)
    return [text.format(listed(names)) for text, names in named if names]


def _passive_contacts(
    model: mujoco.MjModel, data: mujoco.MjData, tree: ModelTree, selection: ContactSelection
) -> list[str]:
    """Return a sentence on contacts of a flex that MuJoCo turns into passive forces, which it does not report."""
    shapes = _shapes(model, data.contact)[np.ravel(data.contact.exclude) == PASSIVE]
    chosen = shapes[selection.is_selected(*shapes.T)]
    if not len(chosen):
        return []
    names = listed([tree.link_name(shape) for shape in _other_shapes(chosen, selection.is_object)])
    return [f"contacts with {names} are left out: MuJoCo handles them as passive forces and does not report them"]


def _per_link(name: str, value: float | Mapping[str, float], links: tuple[str, ...]) -> np.ndarray:
    """Return a factor of eq. 6 for each contact, of one number or of one by link."""
    by_link = dict(value) if isinstance(value, Mapping) else None
    for key, factor in ({"": value} if by_link is None else by_link).items():
        if not (isinstance(factor, (int, float, np.number)) and np.isfinite(factor) and factor >= 0):
            entry = f"[{key!r}]" if key else ""
            raise ValueError(f"{name}{entry} is {factor!r}: expected a finite number, zero or more")
    if by_link is None:
        return np.full(len(links), value, float)
    for link in links:
        if link not in by_link:
            raise ValueError(f"{name} has no entry for {link!r}: expected one for every body that touches")
    return np.array([by_link[link] for link in links], float)
