"""What is wrong with concrete limits, before anything is computed."""

from collections.abc import Iterator, Mapping

import jax
import numpy as np

from jaxgrasp.model.faults import Fault, GraspError, entries
from jaxgrasp.model.grasp import Grasp
from jaxgrasp.model.limits import BOUNDS, NORMALS, TORQUES, Limits
from jaxgrasp.validation.values import check_instance


def check_limits(limits: Limits, grasp: Grasp) -> Limits:
    """Raise unless the concrete ``limits`` fit the ``grasp`` and are usable, and return them unchanged.

    Checked, in this order: shapes, then numbers: none is NaN, bounds are zero or more, the largest normal force is no
    smaller than the least, and only upper bounds are infinite. Entries of absent contacts are not looked at.

    Raises:
        GraspError: naming the field, the first bad index, the value and what was expected.
        TypeError: if anything is traced, as under ``jit``: there are no values to check.
    """
    check_instance("limits", limits, Limits)
    check_instance("grasp", grasp, Grasp)
    if any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves((limits, grasp))):
        raise TypeError("check_limits needs concrete arrays: call it outside jit, vmap and grad")
    arrays = {name: getattr(limits, name) for name in BOUNDS}
    arrays = {name: np.asarray(array) for name, array in arrays.items() if array is not None}
    _check_shapes(arrays, np.shape(grasp.points))
    present = np.ones(np.shape(grasp.friction), bool) if grasp.present is None else np.asarray(grasp.present) == 1
    for fault in limit_faults(arrays, present):
        raise GraspError(fault)
    return limits


def _check_shapes(arrays: dict[str, np.ndarray], points: tuple[int, ...]) -> None:
    for name in NORMALS:
        if name in arrays and arrays[name].shape != points[:-1]:
            expected = f"the shape {points[:-1]} that points imply"
            raise GraspError(Fault(name, (), f"an array of shape {arrays[name].shape}", expected))
    if not any(name in arrays for name in TORQUES):
        return
    for name in TORQUES:
        if name not in arrays:
            counterpart = TORQUES[1 - TORQUES.index(name)]
            raise GraspError(Fault(name, (), "None", f"an array, beside {counterpart}"))
    shape, batch = arrays["torque_map"].shape, points[:-1]
    if len(shape) != len(batch) + 2 or shape[:-2] != batch or shape[-2] not in (3, 4) or shape[-1] == 0:
        expected = f"a shape ({', '.join(map(str, batch))}, 3 or 4, joints)"
        raise GraspError(Fault("torque_map", (), f"an array of shape {shape}", expected))
    bounds_shape = (*batch[:-1], shape[-1])
    if arrays["torque_max"].shape != bounds_shape:
        description = f"an array of shape {arrays['torque_max'].shape}"
        raise GraspError(Fault("torque_max", (), description, f"the shape {bounds_shape} that torque_map implies"))


def limit_faults(arrays: Mapping[str, np.ndarray], present: np.ndarray) -> Iterator[Fault]:
    """Every entry of some of the fields of Limits that breaks a rule; shapes must fit already."""
    finite = "a finite number, zero or more"
    for name, array in arrays.items():
        looked_at = {"torque_max": True, "torque_map": present[..., None, None]}.get(name, present)
        endless = name.endswith("_max")
        with np.errstate(invalid="ignore"):
            is_usable = np.isfinite(array) if name == "torque_map" else (array >= 0) & (endless | np.isfinite(array))
        expected = "a finite number" if name == "torque_map" else "a number, zero or more" if endless else finite
        yield from entries(name, array, looked_at & ~is_usable, expected)
    if all(name in arrays for name in NORMALS):
        low, high = (arrays[name] for name in NORMALS)
        for index in np.argwhere(present & (high < low)):
            position = tuple(int(i) for i in index)
            expected = f"no less than normal_min there, {low[position].item()!r}"
            yield Fault("normal_max", position, repr(high[position].item()), expected)
