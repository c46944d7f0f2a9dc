"""Largest torques of the joints of a MuJoCo model, from its motors and its joints' limits."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxgrasp.interop.mujoco_couplings import LinearLaw

if TYPE_CHECKING:
    import mujoco

UNLIMITED = np.array([-np.inf, np.inf])


def largest_torques(mujoco: Any, model: mujoco.MjModel, joints: np.ndarray, law: LinearLaw) -> np.ndarray:
    """Compute the torque [N.m] or force [N] ``(J,)`` that each joint can exert both ways; inf where not known.

    A motor that drives a joint which follows another counts at that other one, by its lever there; inf of joints that
    follow others, whose own limits are not those of a motor.

    A motor's range is its ``forcerange``, or else what its ``ctrlrange`` makes of a plain motor; times its gear. The
    ranges of a joint's motors add up, and the joint's own ``actuatorfrcrange``, which a URDF's ``effort`` becomes,
    caps the sum. A motor at a fixed tendon counts at each joint of it by that joint's coefficient, as if it were alone.
    Not known is a joint without a motor, one whose motor is of another kind or has no limit, and one that is driven one
    way alone: a bound has to be right for both.
    """
    own_joints = joints[law.independent]
    ranges, driven = np.zeros((len(own_joints), 2)), np.zeros(len(own_joints), bool)
    for motor in range(model.nu):
        levers = np.zeros(model.njnt)
        for joint, lever in _levers(mujoco, model, motor):
            levers[joint] += lever
        driven |= ((levers[joints] != 0)[:, None] & (law.matrix != 0)).any(0)
        # Virtual work: the motor's displacement per unit displacement of the independent joint.
        for i, lever in enumerate(levers[joints] @ law.matrix):
            ranges[i] += _times(float(lever), _range(mujoco, model, motor))
    ranges[~driven] = UNLIMITED
    joint_ranges = np.where(model.jnt_actfrclimited.astype(bool)[:, None], model.jnt_actfrcrange, UNLIMITED)[own_joints]
    low, high = np.maximum(ranges[:, 0], joint_ranges[:, 0]), np.minimum(ranges[:, 1], joint_ranges[:, 1])
    largest = np.full(len(joints), np.inf)
    largest[law.independent] = np.where((low < 0) & (high > 0), np.minimum(-low, high), np.inf)
    return largest


def _times(lever: float, reach: np.ndarray) -> np.ndarray:
    """Multiply a range (low, high) by a lever, which may be negative; zeros for a lever of zero."""
    return np.sort(lever * reach) if lever else np.zeros(2)


def _levers(mujoco: Any, model: mujoco.MjModel, motor: int) -> Iterator[tuple[int, float]]:
    """Yield the joints that a motor drives, each with its torque for a unit of the motor's force."""
    kinds, target = mujoco.mjtTrn, int(model.actuator_trnid[motor, 0])
    gear = float(model.actuator_gear[motor, 0])
    transmission = model.actuator_trntype[motor]
    if transmission in (int(kinds.mjTRN_JOINT), int(kinds.mjTRN_JOINTINPARENT)):
        yield target, gear
    elif transmission == int(kinds.mjTRN_TENDON):
        first = int(model.tendon_adr[target])
        for wrap in range(first, first + int(model.tendon_num[target])):
            if model.wrap_type[wrap] == int(mujoco.mjtWrap.mjWRAP_JOINT):
                yield int(model.wrap_objid[wrap]), gear * float(model.wrap_prm[wrap])


def _range(mujoco: Any, model: mujoco.MjModel, motor: int) -> np.ndarray:
    """Return the least and the largest force of a motor."""
    if model.actuator_forcelimited[motor]:
        return model.actuator_forcerange[motor].copy()
    plain = (
        model.actuator_gaintype[motor] == int(mujoco.mjtGain.mjGAIN_FIXED)
        and model.actuator_biastype[motor] == int(mujoco.mjtBias.mjBIAS_NONE)
        and model.actuator_dyntype[motor] == int(mujoco.mjtDyn.mjDYN_NONE)
    )
    if plain and model.actuator_ctrllimited[motor]:
        return _times(float(model.actuator_gainprm[motor, 0]), model.actuator_ctrlrange[motor])
    return UNLIMITED
