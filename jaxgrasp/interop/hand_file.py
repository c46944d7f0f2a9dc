"""A hand's file, URDF or MJCF, and what of it is in the Hand: nothing is left out in silence."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxgrasp.interop.mjcf_file import read_mjcf
from jaxgrasp.interop.model_file import LeftOut, read_xml
from jaxgrasp.interop.mujoco_contacts import import_mujoco
from jaxgrasp.interop.mujoco_hand import MujocoHand, collides, hand_from_mujoco
from jaxgrasp.interop.urdf_hand import compile_urdf
from jaxgrasp.model.hand import Hand
from jaxgrasp.validation.checked import checked

if TYPE_CHECKING:
    import mujoco

FORMATS = {"robot": "URDF", "mujoco": "MJCF"}
"""Formats by the name of the file's root element."""
USED = "used"


@dataclass(frozen=True)
class JointEntry:
    """A joint of the file."""

    name: str
    kind: str
    """hinge or slide, or free or ball, which no Hand has."""
    limits: tuple[float, float] | None
    """[rad], or [m] of one that slides; None where the file has none."""
    torque_max: float
    """[N.m], or [N] of one that slides; inf where it is not known."""
    use: str
    """``used``, followed by the joint that it follows where there is such, or why not."""


@dataclass(frozen=True)
class LinkEntry:
    """A link of the Hand."""

    name: str
    shapes: tuple[str, ...]
    """Kinds of its shapes."""
    spheres: int
    """Number of spheres that stand for its shapes."""


@dataclass(frozen=True)
class HandFile:
    """A hand, and what its file holds."""

    format: str
    """URDF or MJCF."""
    wrist: str
    """The body whose frame is the Hand's."""
    mujoco_hand: MujocoHand
    joints: tuple[JointEntry, ...]
    links: tuple[LinkEntry, ...]
    left_out: tuple[LeftOut, ...]
    """Parts that are not in the Hand, or not as the file has them."""


@checked
def read_hand(
    path: str | Path,
    wrist: str | None = None,
    *,
    locked: Mapping[str, float] | None = None,
    names: Mapping[str, tuple[str, str]] | None = None,
    keep_going: bool = False,
) -> HandFile:
    """Read the hand in a URDF or MJCF file, with an account of the parts used, the parts left out and the reasons.

    Args:
        path: of the file.
        wrist: name of the body that is the wrist; where not given, the last one that all joints hang on.
        locked, names: as [`jaxgrasp.interop.hand_from_mujoco`][] takes them.
        keep_going: leave out shapes of a URDF that are missing or cannot touch, as
            [`jaxgrasp.interop.hand_from_urdf`][] does, instead of stopping at the first.

    Raises:
        ImportError: without MuJoCo.
        ValueError: for what is no URDF or MJCF, is not there, holds no hand, or is larger or nested more deeply than
            [`jaxgrasp.interop.load_mjcf`][] allows.
        OSError: for a file that cannot be read.
    """
    mujoco, path = import_mujoco("read_hand"), Path(path)
    format_ = _format(path)
    if format_ == "URDF":
        model, notes = compile_urdf(mujoco, path, keep_going)
        notes = (*notes, *_odd_limits(path))
    else:
        model, notes = read_mjcf(mujoco, path)
    if wrist is None:
        wrist = _carrying_all(mujoco, model, path)
    mujoco_hand = hand_from_mujoco(model, wrist, locked=locked, names=names)
    account = _Account(mujoco, model, mujoco_hand, wrist, dict(locked or {}))
    return HandFile(
        format=format_,
        wrist=wrist,
        mujoco_hand=mujoco_hand,
        joints=tuple(account.joint(i) for i in range(model.njnt)),
        links=tuple(account.link(i) for i in range(len(mujoco_hand.bodies))),
        left_out=(*notes, *mujoco_hand.coupled, *account.bare_bodies(), *account.geoms()),
    )


def _format(path: Path) -> str:
    tag = read_xml(path, "a URDF or MJCF file").tag
    if tag not in FORMATS:
        raise ValueError(
            f"path is {str(path)!r}: expected a URDF or MJCF file, whose root is <robot> or <mujoco>, not <{tag}>"
        )
    return FORMATS[tag]


def _odd_limits(path: Path) -> Iterator[LeftOut]:
    """Yield invalid limits of a URDF's joints: MuJoCo drops a reversed range, and takes the size of an effort."""
    for joint in read_xml(path, "a URDF file").iter("joint"):
        limit = joint.find("limit")
        if limit is None:
            continue
        name = str(joint.get("name"))[:80]
        low, high, effort = (_number(limit.get(key, "0")) for key in ("lower", "upper", "effort"))
        if low > high:
            yield LeftOut(
                f"limits of joint {name!r}", f"lower, {low:g}, is above upper, {high:g}: it has no limits here"
            )
        if effort < 0:
            yield LeftOut(f"effort of joint {name!r}", f"it is {effort:g}, below zero: its size counts here")


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan


def _carriers(model: mujoco.MjModel, body: int) -> set[int]:
    """Return the bodies that a body hangs on, the world among them."""
    carriers = set()
    while body > 0:
        body = int(model.body_parentid[body])
        carriers.add(body)
    return carriers


def _carrying_all(mujoco: Any, model: mujoco.MjModel, path: Path) -> str:
    """Find the last body that everything which turns or slides hangs on."""
    kinds = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))
    moved = [int(model.jnt_bodyid[joint]) for joint in range(model.njnt) if model.jnt_type[joint] in kinds]
    if not moved:
        raise ValueError(f"path is {str(path)!r}: expected a hand, but it has no joint that turns or slides")
    # Bodies are numbered from the world outwards.
    return model.body(max(set.intersection(*(_carriers(model, body) for body in moved)))).name


def _following(hand: Hand) -> Iterator[tuple[str, str]]:
    """Yield the joints that follow others, and which."""
    coupling = hand.coupling
    if coupling is None:
        return
    for joint, row in enumerate(np.asarray(coupling.matrix)):
        if joint not in coupling.independent:
            leaders = [hand.joints[coupling.independent[i]] for i in np.flatnonzero(row)]
            yield hand.joints[joint], f"follows {' and '.join(map(repr, leaders))}" if leaders else "held in place"


class _Account:
    """Account of the use of a model's parts in the Hand."""

    def __init__(
        self, mujoco: Any, model: mujoco.MjModel, mujoco_hand: MujocoHand, wrist: str, locked: dict[str, float]
    ):
        self.mujoco, self.model, self.mujoco_hand, self.locked = mujoco, model, mujoco_hand, locked
        root = model.body(wrist).id
        self.below = {body for body in range(model.nbody) if body == root or root in _carriers(model, body)}
        hand = mujoco_hand.hand
        torques = [np.inf] * len(hand.joints) if hand.torque_max is None else np.asarray(hand.torque_max).tolist()
        self.torques = dict(zip(hand.joints, torques, strict=True))
        self.followed = dict(_following(hand))

    def joint(self, joint: int) -> JointEntry:
        model, name = self.model, self.model.joint(joint).name
        kind = self.mujoco.mjtJoint(int(model.jnt_type[joint])).name.removeprefix("mjJNT_").lower()
        low, high = map(float, model.jnt_range[joint])
        limits = (low, high) if model.jnt_limited[joint] else None
        use = USED
        if name in self.locked:
            use = f"locked at {self.locked[name]:g}"
        elif name not in self.torques:
            use = "not below the wrist"
        elif name in self.followed:
            use = f"{USED}, {self.followed[name]}"
        return JointEntry(name, kind, limits, self.torques.get(name, np.inf), use)

    def link(self, link: int) -> LinkEntry:
        model, body = self.model, int(self.mujoco_hand.bodies[link])
        first = int(model.body_geomadr[body])
        geoms = [g for g in range(first, first + int(model.body_geomnum[body])) if collides(model, g)]
        used = tuple(self._kind(geom) for geom in geoms if self._name(geom) not in self.mujoco_hand.left_out)
        hand = self.mujoco_hand.hand
        return LinkEntry(hand.links[link].name, used, int((np.asarray(hand.skin.radii[link]) > 0).sum()))

    def bare_bodies(self) -> Iterator[LeftOut]:
        """Yield the bodies of the hand that have no shape to touch."""
        for body in sorted(self.below - set(self.mujoco_hand.bodies.tolist())):
            yield LeftOut(f"body {self.model.body(body).name!r}", "none of its shapes can touch: it is not a link")

    def geoms(self) -> Iterator[LeftOut]:
        """Yield the shapes that are in no link."""
        model, n_untouchable = self.model, 0
        for geom in range(model.ngeom):
            body = int(model.geom_bodyid[geom])
            part = f"{self._kind(geom)} {self._name(geom)!r} of body {model.body(body).name!r}"
            if not collides(model, geom):
                n_untouchable += 1
            elif body not in self.below:
                yield LeftOut(part, "not below the wrist")
            elif self._name(geom) in self.mujoco_hand.left_out:
                only = "of an MJCF file, touches only as a sphere, capsule, cylinder, ellipsoid or box"
                yield LeftOut(part, f"{only}; load_mjcf can make capsules of meshes")
        if n_untouchable:
            yield LeftOut(f"{n_untouchable} shape{'s' * (n_untouchable > 1)}", "touch nothing by the file's flags")

    def _kind(self, geom: int) -> str:
        return self.mujoco.mjtGeom(int(self.model.geom_type[geom])).name.removeprefix("mjGEOM_").lower()

    def _name(self, geom: int) -> str:
        return self.model.geom(geom).name or f"geom {geom}"
