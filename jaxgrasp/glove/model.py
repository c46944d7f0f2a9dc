"""Gloves as they are driven: which joints they resist, how much, how fast, and in which steps."""

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from jaxgrasp.files.toml_fields import load_toml, nearest, number
from jaxgrasp.validation.checked import checked

MOST_CHANNELS = 14
"""Values in a frame of the native protocol."""
MOST_COUNTS = 2**15 - 1
FLEXIONS = (
    *("thumb MP", "thumb IP"),
    *(f"{finger} {joint}" for finger in ("index", "middle", "ring", "little") for joint in ("MP", "PIP", "DIP")),
)
"""The joints of [`jaxgrasp.hand.human_hand`][] that the paper's glove pulls on (section III-A)."""


@dataclass(frozen=True)
class GloveModel:
    """A glove that resists flexion by cables, one channel for each joint that has a motor.

    Raises:
        ValueError: for channels that are none or too many or named twice, and limits, rates or steps that are no
            positive numbers or do not fit a frame's 16 bits.
    """

    name: str
    joints: tuple[str, ...]
    """Joints of the hand that the glove resists, in the order of the channels."""
    limits: tuple[float, ...]
    """Largest torque of each channel [N.m]."""
    rate: float = 1.2
    """Largest change of a torque [N.m/s]."""
    quantum: float = 1e-5
    """Torque of one count [N.m]."""
    most_counts: tuple[int, ...] = field(init=False)
    """Largest count of each channel whose torque does not exceed its limit."""

    def __post_init__(self):
        if not 1 <= len(self.joints) <= MOST_CHANNELS:
            raise ValueError(f"joints are {len(self.joints)}: expected 1 to {MOST_CHANNELS}")
        for k, joint in enumerate(self.joints):
            if joint in self.joints[:k]:
                raise ValueError(f"joints[{k}] is {joint!r} again: expected each joint once")
        if len(self.limits) != len(self.joints):
            raise ValueError(f"limits are {len(self.limits)}: expected one for each of {len(self.joints)} joints")
        for name in ("rate", "quantum"):
            _check_positive(name, getattr(self, name))
        if not (1 <= round(self.quantum * 1e7) <= MOST_COUNTS and abs(self.quantum * 1e7 % 1 - 0.5) > 0.5 - 1e-6):
            raise ValueError(
                f"quantum is {self.quantum:g}: expected 1 to {MOST_COUNTS} times 1e-7 N.m, as frames have it"
            )
        for k, limit in enumerate(self.limits):
            _check_positive(f"limits[{k}]", limit)
            if not self.quantum <= limit <= MOST_COUNTS * self.quantum:
                raise ValueError(
                    f"limits[{k}] is {limit:g}: expected 1 to {MOST_COUNTS} times quantum, {self.quantum:g}"
                )
        object.__setattr__(self, "most_counts", tuple(_most_counts(limit, self.quantum) for limit in self.limits))

    def resisting(
        self, joints: Sequence[str], torques: Float[np.ndarray, "*batch J"]
    ) -> Float[np.ndarray, "*batch channels"]:
        """Torque by which each channel is to resist flexion [N.m]: less a hand's joint torque, so positive there.

        Args:
            joints: names of the hand's joints.
            torques: on them [N.m], as from [`jaxgrasp.hand.joint_torques`][]: negative where they resist flexion.

        Raises:
            ValueError: for a hand without one of the glove's joints, or torques that are not one for each joint.
        """
        places = self.places(joints)
        if torques.shape[-1:] != (len(joints),):
            raise ValueError(f"torques have shape {torques.shape}: expected (..., {len(joints)}), one for each joint")
        return -torques[..., list(places)]

    def places(self, joints: Sequence[str]) -> tuple[int, ...]:
        """Indices of the channels' joints among a hand's.

        Raises:
            ValueError: for a hand without one of them.
        """
        for joint in self.joints:
            if joint not in joints:
                raise ValueError(f"the hand has no joint {joint!r}, which {self.name} pulls on{nearest(joint, joints)}")
        return tuple(list(joints).index(joint) for joint in self.joints)


@checked
def lrp_hand_master() -> GloveModel:
    """The paper's: 14 flexions, 0.12 N.m each (section III-A)."""
    return GloveModel("LRP Hand Master", FLEXIONS, (0.12,) * len(FLEXIONS))


@checked
def load_glove(path: str | os.PathLike) -> GloveModel:
    """A glove from a TOML file of ``name``, ``joints``, ``limits`` (a number or one for each), ``rate``, ``quantum``.

    Raises:
        ValueError: for a file that is no TOML, keys that are unknown or missing, and values that no glove has.
        OSError: for a file that cannot be read.
    """
    given = load_toml(Path(path))
    known = [one.name for one in fields(GloveModel) if one.init]
    for key in given:
        if key not in known:
            raise ValueError(f"{path} has {key!r}{nearest(key, known)}")
    for key in ("name", "joints", "limits"):
        if key not in given:
            raise ValueError(f"{path} has no {key!r}: expected {', '.join(known)}")
    return GloveModel(**{key: _read(key, value, given) for key, value in given.items()})


def _read(key: str, value: Any, given: dict[str, Any]) -> Any:
    """A value of the file, of the kind that its key needs."""
    if key == "name":
        if not isinstance(value, str):
            raise ValueError(f"name is {value!r}: expected text")
        return value
    if key == "joints":
        if not (isinstance(value, list) and all(isinstance(one, str) for one in value)):
            raise ValueError(f"joints is {value!r}: expected a list of names")
        return tuple(value)
    if key == "limits" and isinstance(value, list):
        return tuple(number(f"limits[{k}]", one) for k, one in enumerate(value))
    one = number(key, value)
    return (one,) * len(_read("joints", given["joints"], given)) if key == "limits" else one


def _check_positive(name: str, value: float) -> None:
    if not (math.isfinite(value) and value > 0):
        raise ValueError(f"{name} is {value}: expected a positive number")


def _most_counts(limit: float, quantum: float) -> int:
    """Rounding must not let the largest count exceed the limit."""
    counts = int(limit / quantum)
    return counts - 1 if counts * quantum > limit else counts
