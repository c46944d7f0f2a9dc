"""Gloves as they are driven: which joints they resist, how much, how fast, and in which steps."""

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from jaxgrasp.files.file_values import load_toml, nearest, number
from jaxgrasp.validation.checked import checked

MAX_CHANNELS = 32
"""Largest number of channels of a glove; a frame of the native protocol holds fewer."""
MAX_COUNTS = 2**15 - 1
FLEXIONS = (
    *("thumb MP", "thumb IP"),
    *(f"{finger} {joint}" for finger in ("index", "middle", "ring", "little") for joint in ("MP", "PIP", "DIP")),
)
"""The joints of [`jaxgrasp.hand.human_hand`][] that the paper's glove pulls on (section III-A)."""
FINGERS = ("thumb", "index", "middle", "ring", "little")
FIST = {"MP": 90, "PIP": 100, "DIP": 90, "thumb MP": 55, "thumb IP": 80}
"""Flexions of a closed fist [degrees]: where the joints of [`jaxgrasp.hand.human_hand`][] end."""


class CoupledJoint(NamedTuple):
    """A joint of the hand that bends with one of the glove's, by the same cable or string."""

    joint: str
    follows: str
    """Name of the glove's joint."""
    ratio: float
    """Its angle per radian of that joint [rad/rad], which is also the weight of its torque there."""


@dataclass(frozen=True)
class GloveModel:
    """A glove that resists flexion, one channel for each joint that it reads; a limit of 0 marks one without a motor.

    Raises:
        ValueError: for channels that are none or too many or named twice, limits that are negative or do not fit 16
            bits, rates, steps or spans that are no positive numbers, and coupled joints that follow none of the
            channels.
    """

    name: str
    joints: tuple[str, ...]
    """Joints of the hand that the glove resists, in the order of the channels."""
    limits: tuple[float, ...]
    """Largest torque of each channel [N.m]; 0 for a joint that is read and has no motor."""
    rate: float = 1.2
    """Largest change of a torque [N.m/s]."""
    quantum: float = 1e-5
    """Torque of one count [N.m]."""
    coupled: tuple[CoupledJoint, ...] = ()
    """Joints that bend with the channels'."""
    spans: tuple[float, ...] | None = None
    """Angle of each channel's joint where its finger is curled all the way [rad], of gloves that read curls."""
    continuous: tuple[float, ...] | None = None
    """Torque that each channel's motor can hold for ever [N.m], of gloves whose limits are for moments; 0 where the
    limit is 0."""
    heating: float = 30.0
    """Time constant by which a motor warms and cools [s]; that of small DC motors' windings is tens of seconds."""
    max_counts: tuple[int, ...] = field(init=False)
    """Largest count of each channel whose torque does not exceed its limit."""
    continuous_counts: tuple[int, ...] = field(init=False)
    """Largest count of each channel that its motor can hold for ever."""

    def __post_init__(self):
        if not 1 <= len(self.joints) <= MAX_CHANNELS:
            raise ValueError(f"joints has {len(self.joints)} entries: expected 1 to {MAX_CHANNELS}")
        for k, joint in enumerate(self.joints):
            if joint in self.joints[:k]:
                raise ValueError(f"joints[{k}] is {joint!r} again: expected each joint once")
        if len(self.limits) != len(self.joints):
            raise ValueError(
                f"limits has {len(self.limits)} entries: expected one for each of {len(self.joints)} joints"
            )
        for name in ("rate", "quantum", "heating"):
            _check_positive(name, getattr(self, name))
        if not (1 <= round(self.quantum * 1e7) <= MAX_COUNTS and abs(self.quantum * 1e7 % 1 - 0.5) > 0.5 - 1e-6):
            raise ValueError(
                f"quantum is {self.quantum:g}: expected 1 to {MAX_COUNTS} times 1e-7 N.m, as frames have it"
            )
        for k, limit in enumerate(self.limits):
            if limit == 0:
                continue
            _check_positive(f"limits[{k}]", limit)
            if not self.quantum <= limit <= MAX_COUNTS * self.quantum:
                raise ValueError(
                    f"limits[{k}] is {limit:g}: expected 1 to {MAX_COUNTS} times quantum, {self.quantum:g}"
                )
        for name in ("spans", "continuous"):
            self._check_per_channel(name, getattr(self, name))
        for k, torque in enumerate(self.continuous or ()):
            if torque > self.limits[k]:
                raise ValueError(f"continuous[{k}] is {torque:g}: expected at most its limit, {self.limits[k]:g}")
        self._check_coupled()
        for name, torques in (("max_counts", self.limits), ("continuous_counts", self.continuous or self.limits)):
            object.__setattr__(self, name, tuple(_compute_max_counts(torque, self.quantum) for torque in torques))

    @property
    def is_resisted(self) -> tuple[bool, ...]:
        """Mask of the channels that have a motor; the others are only read."""
        return tuple(limit > 0 for limit in self.limits)

    def resisting(
        self, joints: Sequence[str], torques: Float[np.ndarray, "*batch J"]
    ) -> Float[np.ndarray, "*batch channels"]:
        """Compute the torque by which each channel resists flexion [N.m]: the negative of the hand's joint torque.

        What coupled joints bear counts at the joint that they follow, by their ratio: the work is the same.

        Args:
            joints: names of the hand's joints.
            torques: on them [N.m], as from [`jaxgrasp.hand.joint_torques`][]: negative where they resist flexion.

        Raises:
            ValueError: for a hand without one of the glove's joints, or torques that are not one for each joint.
        """
        transmission = self.transmission(joints)
        if torques.shape[-1:] != (len(joints),):
            raise ValueError(f"torques have shape {torques.shape}: expected (..., {len(joints)}), one for each joint")
        return -torques @ transmission.T

    def transmission(self, joints: Sequence[str]) -> Float[np.ndarray, "channels J"]:
        """Compute the angle of each of a hand's joints for one radian of each channel [rad/rad].

        Raises:
            ValueError: for a hand without one of the glove's joints, or of those that follow them.
        """
        matrix = np.zeros((len(self.joints), len(joints)))
        matrix[np.arange(len(self.joints)), list(self.joint_indices(joints))] = 1
        for joint, follows, ratio in self.coupled:
            if joint not in joints:
                raise ValueError(f"the hand has no joint {joint!r}, which {self.name} couples{nearest(joint, joints)}")
            matrix[self.joints.index(follows), list(joints).index(joint)] = ratio
        return matrix

    def joint_indices(self, joints: Sequence[str]) -> tuple[int, ...]:
        """Return the indices of the channels' joints in a hand's list of joints.

        Raises:
            ValueError: for a hand without one of them.
        """
        for joint in self.joints:
            if joint not in joints:
                raise ValueError(f"the hand has no joint {joint!r}, which {self.name} pulls on{nearest(joint, joints)}")
        return tuple(list(joints).index(joint) for joint in self.joints)

    def _check_per_channel(self, name: str, values: tuple[float, ...] | None) -> None:
        if values is None:
            return
        if len(values) != len(self.joints):
            raise ValueError(f"{name} has {len(values)} entries: expected one for each of {len(self.joints)} joints")
        for k, value in enumerate(values):
            if not (name == "continuous" and value == 0 == self.limits[k]):
                _check_positive(f"{name}[{k}]", value)

    def _check_coupled(self) -> None:
        names = set(self.joints)
        for joint, follows, ratio in self.coupled:
            if joint in names:
                raise ValueError(f"coupled has {joint!r}, which is named already: expected each joint once")
            names.add(joint)
            if follows not in self.joints:
                raise ValueError(f"coupled[{joint!r}] follows {follows!r}{nearest(follows, self.joints)}")
            if not (math.isfinite(ratio) and ratio != 0):
                raise ValueError(f"coupled[{joint!r}] has the ratio {ratio}: expected a number that is not 0")


@checked
def lrp_hand_master() -> GloveModel:
    """Return the model of the paper's glove: 14 flexions, 0.12 N.m each (section III-A).

    Example:
        >>> from jaxgrasp.glove import lrp_hand_master
        >>> model = lrp_hand_master()
        >>> len(model.joints), model.joints[0], model.limits[0]
        (14, 'thumb MP', 0.12)
    """
    return GloveModel("LRP Hand Master", FLEXIONS, (0.12,) * len(FLEXIONS))


@checked
def lucidgloves() -> GloveModel:
    """Return the model of LucidGloves: five fingers, each read and stopped by one string over all its joints.

    The numbers are ours. A finger is taken to curl all the way to a fist's angles, its joints in proportion. Three
    times the paper's 0.12 N.m, one for each of a finger's joints, count as the whole range of a limit.
    """
    coupled = [CoupledJoint("thumb IP", "thumb MP", FIST["thumb IP"] / FIST["thumb MP"])]
    for finger in FINGERS[1:]:
        coupled += [
            CoupledJoint(f"{finger} {kind}", f"{finger} MP", FIST[kind] / FIST["MP"]) for kind in ("PIP", "DIP")
        ]
    return GloveModel(
        "LucidGloves",
        tuple(f"{finger} MP" for finger in FINGERS),
        (0.36,) * 5,
        rate=3.6,
        quantum=1.2e-4,
        coupled=tuple(coupled),
        spans=tuple(math.radians(FIST[kind]) for kind in ("thumb MP", *("MP",) * 4)),
    )


@checked
def load_glove(path: str | os.PathLike) -> GloveModel:
    """Load a glove from a TOML file of ``name``, ``joints``, ``limits`` (a number or a list), ``rate``, ``quantum``.

    ``spans`` and ``continuous`` are given like ``limits``, and ``heating``; in the table ``[coupled]``, a line such as
    ``"index PIP" = {follows = "index MP", ratio = 1.2}`` couples a joint.

    Raises:
        ValueError: for a file that is no TOML, keys that are unknown or missing, and values that no glove has.
        OSError: for a file that cannot be read.
    """
    contents = load_toml(Path(path))
    field_names = [entry.name for entry in fields(GloveModel) if entry.init]
    for key in contents:
        if key not in field_names:
            raise ValueError(f"{path} has {key!r}{nearest(key, field_names)}")
    for key in ("name", "joints", "limits"):
        if key not in contents:
            raise ValueError(f"{path} has no {key!r}: expected {', '.join(field_names)}")
    return GloveModel(**{key: _convert_value(key, value, contents) for key, value in contents.items()})


def _convert_value(key: str, value: Any, contents: dict[str, Any]) -> Any:
    """Convert a value of the file to the type that its key needs."""
    if key == "name":
        if not isinstance(value, str):
            raise ValueError(f"name is {value!r}: expected text")
        return value
    if key == "joints":
        if not (isinstance(value, list) and all(isinstance(entry, str) for entry in value)):
            raise ValueError(f"joints is {value!r}: expected a list of names")
        return tuple(value)
    if key == "coupled":
        return _read_coupled(value)
    is_per_channel = key in ("limits", "spans", "continuous")
    if is_per_channel and isinstance(value, list):
        return tuple(number(f"{key}[{k}]", entry) for k, entry in enumerate(value))
    entry = number(key, value)
    return (entry,) * len(_convert_value("joints", contents["joints"], contents)) if is_per_channel else entry


def _read_coupled(value: Any) -> tuple[CoupledJoint, ...]:
    if not isinstance(value, dict):
        raise ValueError(f"coupled is {value!r}: expected a table of joints")
    coupled_joints = []
    for joint, entry in value.items():
        if not (isinstance(entry, dict) and entry.keys() == {"follows", "ratio"} and isinstance(entry["follows"], str)):
            raise ValueError(f"coupled[{joint!r}] is {entry!r}: expected {{follows = JOINT, ratio = NUMBER}}")
        coupled_joints.append(
            CoupledJoint(joint, entry["follows"], number(f"coupled[{joint!r}].ratio", entry["ratio"]))
        )
    return tuple(coupled_joints)


def _check_positive(name: str, value: float) -> None:
    if not (math.isfinite(value) and value > 0):
        raise ValueError(f"{name} is {value}: expected a positive number")


def _compute_max_counts(limit: float, quantum: float) -> int:
    """Compute the largest count whose torque does not exceed the limit, in spite of rounding."""
    counts = int(limit / quantum)
    return counts - 1 if counts * quantum > limit else counts
