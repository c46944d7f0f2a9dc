"""The objects of the grips: spheres, cylinders, boxes and capsules of random size, mass and friction."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

SHAPES = {
    "precision": ("sphere", "cylinder", "box", "capsule"),
    "power": ("sphere", "cylinder", "box", "capsule"),
    "firm": ("box", "box", "box", "box"),
}
"""By recipe, in turn. A firm grip is for slabs, which offer a surface to every phalanx and to the palm."""
_SIZES = {
    "precision": ((0.008, 0.026), (0.008, 0.026), (0.015, 0.055)),
    "power": ((0.015, 0.038), (0.015, 0.038), (0.025, 0.075)),
    "firm": ((0.009, 0.015), (0.022, 0.030), (0.030, 0.060)),
}
"""Ranges of half sizes [m] along the three axes; what is round has the first for its radius."""
_GEOM = {
    "sphere": mujoco.mjtGeom.mjGEOM_SPHERE,
    "cylinder": mujoco.mjtGeom.mjGEOM_CYLINDER,
    "box": mujoco.mjtGeom.mjGEOM_BOX,
    "capsule": mujoco.mjtGeom.mjGEOM_CAPSULE,
}
SWING_DAMPING = 1e-4
"""[N.m.s/rad] and [N.s/m]: nothing at the speeds that count as rest."""


@dataclass(frozen=True)
class GraspedObject:
    """An object to grasp; its third axis is the long one, its first the one that a hand closes over."""

    shape: str
    size: tuple[float, ...]
    """As MuJoCo has it: radius, then half lengths [m]."""
    mass: float
    """[kg]"""
    friction: float

    @property
    def half_width(self) -> float:
        """Return the distance from the centre to the surface along the first axis [m]."""
        return self.size[0]

    def add_to(self, spec: mujoco.MjSpec) -> None:
        """Add a free body ``object``, held in its place by the weld ``hold`` until that is switched off."""
        body = spec.worldbody.add_body(name="object")
        # A sphere between two fingertips turns about their line without friction and would swing for ever.
        body.add_joint(name="object", type=mujoco.mjtJoint.mjJNT_FREE, damping=[SWING_DAMPING, 0, 0])
        size = [*self.size, *[0.0] * (3 - len(self.size))]
        body.add_geom(name="object", type=_GEOM[self.shape], size=size, mass=self.mass, contype=0, conaffinity=1)
        spec.add_equality(
            name="hold",
            type=mujoco.mjtEq.mjEQ_WELD,
            objtype=mujoco.mjtObj.mjOBJ_BODY,
            name1="object",
            name2="world",
            # Soft enough that closing fingers centre the object between them.
            solref=[0.04, 1.0],
        )


def draw(rng: np.random.Generator, shape: str, recipe: str) -> GraspedObject:
    """Draw an object for the fingertips, to wrap a hand around, or to lay the whole hand against."""
    widths, depths, lengths = _SIZES[recipe]
    width, length = rng.uniform(*widths), rng.uniform(*lengths)
    if shape == "sphere":
        size: tuple[float, ...] = (width * 1.15,)
        volume = 4 / 3 * np.pi * size[0] ** 3
    elif shape == "box":
        size = (width, rng.uniform(*depths), length)
        volume = 8 * np.prod(size)
    else:
        size = (width, length)
        volume = np.pi * width**2 * (2 * length + (4 / 3 * width if shape == "capsule" else 0))
    density = np.exp(rng.uniform(np.log(300), np.log(4000)))
    mass = float(np.clip(density * volume, 0.02, 1.0))
    return GraspedObject(shape, tuple(map(float, size)), mass, float(rng.uniform(0.3, 1.0)))
