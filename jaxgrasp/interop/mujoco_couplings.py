"""Joints that a MuJoCo model lets move together alone: URDF's ``mimic``, equalities, and tendons over several."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from jaxgrasp.interop.left_out import LeftOut

if TYPE_CHECKING:
    import mujoco


def couplings(mujoco: Any, model: mujoco.MjModel, joints: list[int]) -> tuple[LeftOut, ...]:
    """The couplings that one of these joints has a part in, the first of the same joints; a Hand has none of them."""
    found: dict[tuple[int, ...], str] = {}
    for coupled, by in (*_of_equalities(mujoco, model), *_of_tendons(mujoco, model)):
        if set(coupled) & set(joints):
            found.setdefault(tuple(coupled), by)
    return tuple(
        LeftOut(f"coupling of {_listed(model, coupled)}", f"{by}; here each moves by itself")
        for coupled, by in found.items()
    )


def _listed(model: mujoco.MjModel, joints: tuple[int, ...]) -> str:
    return " and ".join(repr(model.joint(joint).name) for joint in joints)


def _of_equalities(mujoco: Any, model: mujoco.MjModel) -> list[tuple[list[int], str]]:
    found = []
    for i in range(model.neq):
        first, second = int(model.eq_obj1id[i]), int(model.eq_obj2id[i])
        if model.eq_type[i] == int(mujoco.mjtEq.mjEQ_JOINT):
            other = "a fixed place" if second < 0 else repr(model.joint(second).name)
            joints = [first] if second < 0 else [first, second]
            found.append((joints, f"the file has {model.joint(first).name!r} follow {other}"))
        elif model.eq_type[i] == int(mujoco.mjtEq.mjEQ_TENDON):
            both = [joint for tendon in (first, second) if tendon >= 0 for joint in _joints(mujoco, model, tendon)]
            found.append((both, "an equality of tendons ties them"))
    return found


def _of_tendons(mujoco: Any, model: mujoco.MjModel) -> list[tuple[list[int], str]]:
    """Fixed tendons over several joints whose length is limited."""
    each = ((i, _joints(mujoco, model, i)) for i in range(model.ntendon) if model.tendon_limited[i])
    return [(joints, f"the tendon {model.tendon(i).name!r} ties them") for i, joints in each if len(joints) > 1]


def _joints(mujoco: Any, model: mujoco.MjModel, tendon: int) -> list[int]:
    """Those that a fixed tendon goes over."""
    first = int(model.tendon_adr[tendon])
    wraps = range(first, first + int(model.tendon_num[tendon]))
    return [int(model.wrap_objid[w]) for w in wraps if model.wrap_type[w] == int(mujoco.mjtWrap.mjWRAP_JOINT)]
