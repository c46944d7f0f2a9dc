"""Joints of a MuJoCo model that follow others: URDF's ``mimic``, equalities of joints and tendons, and tight tendons.

Each is a linear equation of the joints' positions. Those of the joints of a hand are solved for the joints that follow,
and become the Hand's coupling; what is not linear, or reaches beyond the hand, is named instead.

Largest torques of the joints of a MuJoCo model, from its motors and its joints' limits.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from jaxgrasp.interop.model_file import LeftOut

if TYPE_CHECKING:
    import mujoco

TIGHT = 0.1
"""Share of the way that its joints could move a tendon, below which the tendon's range makes it rigid."""
NEGLIGIBLE = 1e-9
"""Share of an equation's largest coefficient that counts as zero."""


class Equation(NamedTuple):
    """Linear equation of joint positions: sum of coefficient x position = constant."""

    coefficients: dict[int, float]
    """Coefficients by the id of the joint; the first joint is the follower, where the model says so."""
    constant: float
    fault: str
    """Reason why it is not linear; empty where it is."""
    cause: str
    """Element of the model that ties the joints."""


class LinearLaw(NamedTuple):
    """Positions of some joints by those of the independent ones among them."""

    matrix: np.ndarray
    """``(J, I)``"""
    offset: np.ndarray
    """``(J,)``"""
    independent: np.ndarray
    """``(I,)`` indices into the joints."""


def couplings(
    mujoco: Any, model: mujoco.MjModel, joints: list[int], locked: dict[str, float]
) -> tuple[LinearLaw, tuple[LeftOut, ...]]:
    """Return the law of these joints, and the couplings that are not in it.

    Args:
        mujoco: the module.
        model: the compiled model.
        joints: ids of the hand's joints.
        locked: positions of joints that stay, by name.
    """
    fixed = {model.joint(name).id: position for name, position in locked.items()}
    law = _Solver(joints, _motorised(mujoco, model))
    left_out, ties = [], set()
    for equation in (*_equality_equations(mujoco, model), *_tendon_equations(mujoco, model)):
        tied = tuple(equation.coefficients)
        if not set(tied) & set(joints) or tied in ties:
            continue
        ties.add(tied)
        fault = equation.fault or law.add(equation, fixed)
        if fault:
            reason = f"{equation.cause}; {fault}: here each joint moves by itself"
            left_out.append(LeftOut(f"coupling of {_listed(model, tied)}", reason))
    return law.result(), tuple(left_out)


class _Solver:
    """Elimination of the joints that follow."""

    def __init__(self, joints: list[int], motorised: set[int]) -> None:
        self.joints, self.motorised = joints, motorised
        self.matrix, self.offset = np.eye(len(joints)), np.zeros(len(joints))
        self.is_independent = np.ones(len(joints), bool)

    def add(self, equation: Equation, fixed: dict[int, float]) -> str:
        """Solve an equation for one of its joints; return why it cannot be, or nothing."""
        row, remainder = np.zeros(len(self.joints)), equation.constant
        for joint, coefficient in equation.coefficients.items():
            if joint in self.joints:
                row[self.joints.index(joint)] += coefficient
            elif joint in fixed:
                remainder -= coefficient * fixed[joint]
            else:
                return "it involves a joint that is not the hand's"
        # q = C u + o over the independent joints u: a^T q = b is (a^T C) u = b - a^T o.
        over_independent, remainder = row @ self.matrix, remainder - float(row @ self.offset)
        least = NEGLIGIBLE * np.abs(row).max()
        if np.abs(over_independent).max() <= least:
            return "" if abs(remainder) <= 1e-6 * np.abs(row).max() else "it contradicts the other couplings"
        pivot = self._follower(equation, over_independent, least)
        substitution = -over_independent / over_independent[pivot]
        substitution[pivot] = 0
        # Put the solved joint into the positions of all that hang on it.
        self.offset += self.matrix[:, pivot] * (remainder / over_independent[pivot])
        self.matrix += np.outer(self.matrix[:, pivot], substitution)
        self.matrix[:, pivot] = 0
        self.is_independent[pivot] = False
        return ""

    def _follower(self, equation: Equation, row: np.ndarray, least: float) -> int:
        """Choose the joint to solve for: that of the model, one without a motor, or that of the largest coefficient."""
        usable = [i for i in np.flatnonzero(np.abs(row) > least).tolist() if self.is_independent[i]]
        first = next(iter(equation.coefficients))
        for i in usable:
            if self.joints[i] == first and first not in self.motorised:
                return i
        idle = [i for i in usable if self.joints[i] not in self.motorised]
        return max(idle or usable, key=lambda i: (self.joints[i] == first, abs(row[i])))

    def result(self) -> LinearLaw:
        independent = np.flatnonzero(self.is_independent)
        return LinearLaw(self.matrix[:, independent], self.offset, independent)


def tightened_limits(law: LinearLaw, limits: np.ndarray) -> np.ndarray:
    """Tighten limits ``(J, 2)`` so that no follower of a single joint passes its own; keep them if none are left."""
    limits = limits.copy()
    for row, offset, joint_limits in zip(law.matrix, law.offset, limits.copy(), strict=True):
        columns = np.flatnonzero(row)
        if len(columns) != 1:
            continue
        joint = law.independent[columns[0]]
        # The follower's q = m u + o stays within its limits for u between (limit - o) / m.
        reach = np.sort((joint_limits - offset) / row[columns[0]])
        low, high = max(limits[joint, 0], reach[0]), min(limits[joint, 1], reach[1])
        if low < high:
            limits[joint] = low, high
    return limits


def _motorised(mujoco: Any, model: mujoco.MjModel) -> set[int]:
    kinds = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))
    return {int(model.actuator_trnid[i, 0]) for i in range(model.nu) if model.actuator_trntype[i] in kinds}


def _listed(model: mujoco.MjModel, joints: tuple[int, ...]) -> str:
    return " and ".join(repr(model.joint(joint).name) for joint in joints)


def _equality_equations(mujoco: Any, model: mujoco.MjModel) -> Iterator[Equation]:
    """Yield those of joints and of tendons: y - y0 = a0 + a1 (x - x0) + ... to the fourth power."""
    for i in range(model.neq):
        if not model.eq_active0[i]:
            continue
        first, second, factors = int(model.eq_obj1id[i]), int(model.eq_obj2id[i]), model.eq_data[i, :5]
        fault = "the law is not linear" if second >= 0 and np.any(factors[2:]) else ""
        slope = float(factors[1]) if second >= 0 else 0.0
        if model.eq_type[i] == int(mujoco.mjtEq.mjEQ_JOINT):
            leader = "a fixed place" if second < 0 else repr(model.joint(second).name)
            cause = f"the file has {model.joint(first).name!r} follow {leader}"
            references = [float(model.qpos0[model.jnt_qposadr[joint]]) for joint in (first, second) if joint >= 0]
            coefficients = {first: 1.0} | ({second: -slope} if second >= 0 else {})
            constant = references[0] + float(factors[0]) - slope * (references[1] if second >= 0 else 0)
            yield Equation(coefficients, constant, fault, cause)
        elif model.eq_type[i] == int(mujoco.mjtEq.mjEQ_TENDON):
            terms = [(first, 1.0), *([(second, -slope)] if second >= 0 else [])]
            coefficients = {}
            for tendon, factor in terms:
                for joint, coefficient in _tendon_levers(mujoco, model, tendon).items():
                    coefficients[joint] = coefficients.get(joint, 0.0) + factor * coefficient
                if not _is_fixed(mujoco, model, tendon):
                    fault = "one of its tendons is not a fixed tendon"
            constant = float(factors[0]) + sum(f * float(model.tendon_length0[tendon]) for tendon, f in terms)
            yield Equation(coefficients, constant, fault, "an equality of tendons ties them")


def _tendon_equations(mujoco: Any, model: mujoco.MjModel) -> Iterator[Equation]:
    """Yield fixed tendons over several joints whose length is limited."""
    for i in range(model.ntendon):
        levers = _tendon_levers(mujoco, model, i)
        if not model.tendon_limited[i] or len(levers) < 2:
            continue
        low, high = map(float, model.tendon_range[i])
        travel = sum(abs(c) * float(np.ptp(model.jnt_range[j])) for j, c in levers.items() if model.jnt_limited[j])
        fault = "" if high - low <= TIGHT * travel else "its range lets them move apart"
        yield Equation(levers, (low + high) / 2, fault, f"the tendon {model.tendon(i).name!r} ties them")


def _is_fixed(mujoco: Any, model: mujoco.MjModel, tendon: int) -> bool:
    first = int(model.tendon_adr[tendon])
    kinds = model.wrap_type[first : first + int(model.tendon_num[tendon])]
    return bool(np.all(kinds == int(mujoco.mjtWrap.mjWRAP_JOINT)))


def _tendon_levers(mujoco: Any, model: mujoco.MjModel, tendon: int) -> dict[int, float]:
    """Return the joints that a fixed tendon goes over, and its length for a unit of their way."""
    levers: dict[int, float] = {}
    first = int(model.tendon_adr[tendon])
    for wrap in range(first, first + int(model.tendon_num[tendon])):
        if model.wrap_type[wrap] == int(mujoco.mjtWrap.mjWRAP_JOINT):
            joint = int(model.wrap_objid[wrap])
            levers[joint] = levers.get(joint, 0.0) + float(model.wrap_prm[wrap])
    return levers


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
        for joint, lever in _motor_levers(mujoco, model, motor):
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


def _motor_levers(mujoco: Any, model: mujoco.MjModel, motor: int) -> Iterator[tuple[int, float]]:
    """Yield the joints that a motor drives, each with its torque for a unit of the motor's force."""
    kinds, target = mujoco.mjtTrn, int(model.actuator_trnid[motor, 0])
    gear = float(model.actuator_gear[motor, 0])
    transmission = model.actuator_trntype[motor]
    if transmission in (int(kinds.mjTRN_JOINT), int(kinds.mjTRN_JOINTINPARENT)):
        yield target, gear
    elif transmission == int(kinds.mjTRN_TENDON):
        for joint, lever in _tendon_levers(mujoco, model, target).items():
            yield joint, gear * lever


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
