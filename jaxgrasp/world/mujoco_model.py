"""The MuJoCo model of a world: bodies, geoms and pairs for its hand, objects, table, obstacles and guide."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from jaxgrasp.grip.scene import Obstacle
from jaxgrasp.hand.shapes import Box, Capsule, Cylinder, Shape, Sphere
from jaxgrasp.hand.sphere_tree import SphereTree
from jaxgrasp.model.hand import Pose
from jaxgrasp.world.many_bodies import HAND, OBSTACLES, TABLE, Masses, RigidBody, World

if TYPE_CHECKING:
    import mujoco

UNMOVED = 1e3
"""Mass of a link's body [kg]: a newton in a step of a millisecond changes its speed by a micrometre per second. A
larger mass would hide the objects' own inertia from the solver's tolerance."""
RIGID = (0.004, 1.0)
"""Time constant [s] and damping ratio of contacts among objects, and with the table."""
IMPEDANCE = 0.9
"""MuJoCo's impedance of spring contacts: the share of a constraint that is satisfied at once."""
DAMPING = 1.0
"""Damping ratio of springs, for the object's own mass."""
STICKING = (0.002, 1.0)
"""Time constant [s] and damping ratio of friction at the hand."""
RATIO = 10.0
"""Stiffness of friction relative to the normal direction: with less, held objects creep."""


STRAIGHT = 1e-12
"""Pitch of a screw below which it is a hinge [m/rad]."""


class WorldModel(NamedTuple):
    """A compiled MuJoCo model, with the indices of the world's bodies in it."""

    model: mujoco.MjModel
    owners: np.ndarray
    """``(ngeom,)``: index of the object of each geom; -1 for the hand, -2 for the table, -3 for obstacles."""
    links: np.ndarray
    """``(ngeom,)``: index of the link of each geom; -1 for others."""
    pair_links: np.ndarray
    """``(npair,)``: index of the link of each pair; -1 for those of obstacles."""
    pair_bodies: np.ndarray
    """``(npair,)``: index of the object of each pair."""
    bodies: np.ndarray
    """``(N,)``: ids of the objects' bodies."""
    guide: Guide | None
    """Guide of the first object."""


class Guide(NamedTuple):
    """A slide, a hinge or a screw in the world."""

    axis: np.ndarray
    """``(3,)`` unit."""
    point: np.ndarray
    """``(3,)``: a point on the axis of a hinge or screw [m]."""
    slides: bool
    turns: bool
    pitch: float
    """Travel along the axis for a radian of a screw [m]."""


def read_guide(guide: np.ndarray) -> Guide:
    """Classify the one twist ``(6, 1)`` about the world's origin as a slide, a hinge or a screw.

    Raises:
        ValueError: for more than one twist.
    """
    if guide.shape[1] != 1:
        raise ValueError(f"guide has {guide.shape[1]} twists: expected one: that of a slide, a hinge or a screw")
    along, about = guide[:3, 0], guide[3:, 0]
    speed, turning = np.linalg.norm(along), np.linalg.norm(about)
    if turning == 0:
        return Guide(along / speed, np.zeros(3), True, False, 0.0)
    axis, pitch = about / turning, float(about @ along / turning**2)
    return Guide(axis, np.cross(about, along) / turning**2, bool(abs(pitch) > STRAIGHT), True, pitch)


def world_model(mujoco: Any, world: World, weights: Masses, placed: Pose) -> WorldModel:
    """Build and compile the model, with objects at their initial poses.

    Raises:
        ValueError: for shapes that the model does not support, and a guide of more than one twist.
    """
    builder = _ModelBuilder(mujoco, world)
    builder.add_table()
    for k, obstacle in enumerate(world.scene.obstacles):
        builder.add_obstacle(k, obstacle)
    for n, rigid_body in enumerate(world.bodies):
        builder.add_rigid_body(n, rigid_body, weights, Pose(placed.origin[n], placed.rotation[n]))
    builder.add_hand()
    return builder.compile()


class _ModelBuilder:
    """Builder that adds bodies, geoms and pairs to a MuJoCo specification, and records the owner of each geom by
    name."""

    def __init__(self, mujoco: Any, world: World):
        self.mujoco, self.world = mujoco, world
        self.spec = spec = mujoco.MjSpec()
        spec.option.gravity = np.asarray(world.scene.gravity, float)
        spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
        spec.option.impratio = RATIO
        spec.option.tolerance = 1e-13
        self.guide = None if world.scene.guide is None else read_guide(np.asarray(world.scene.guide, float))
        self.owners: dict[str, tuple[int, int]] = {}
        self.pairs: list[tuple[int, int]] = []
        self.geoms: list[list[str]] = []

    def add_table(self) -> None:
        table = self.world.scene.table
        self.owners["table"] = (TABLE, -1)
        self.spec.worldbody.add_geom(
            name="table",
            type=self.mujoco.mjtGeom.mjGEOM_PLANE,
            size=[0, 0, 1],
            pos=np.asarray(table.origin, float),
            quat=self._quaternion(table.rotation),
            friction=[0, 0, 0],
            solref=RIGID,
            condim=3,
        )

    def add_obstacle(self, k: int, obstacle: Obstacle) -> None:
        if obstacle.path is None:
            origin, rotation = obstacle.placed.origin, obstacle.placed.rotation
            body = self.spec.worldbody.add_body(
                name=f"obstacle {k}", pos=np.asarray(origin, float), quat=self._quaternion(rotation)
            )
        else:
            body = self._add_kinematic_body(f"obstacle {k}")
        self._add_geoms(body, f"obstacle {k}", obstacle.shape, (OBSTACLES, -1), contype=0, conaffinity=0)

    def add_rigid_body(self, n: int, rigid_body: RigidBody, weights: Masses, placed: Pose) -> None:
        body = self.spec.worldbody.add_body(
            name=f"object {n}",
            pos=np.asarray(placed.origin, float),
            quat=self._quaternion(placed.rotation),
            mass=weights.mass[n],
            inertia=weights.moments[n],
            ipos=[0, 0, 0],
            explicitinertial=True,
        )
        if n == 0 and self.guide is not None:
            self._add_guide(body, self.guide, placed)
        else:
            body.add_freejoint()
        friction = [float(rigid_body.rubbing), 0, 0]
        names = self._add_geoms(body, f"object {n}", rigid_body.body.shape, (n, -1), friction=friction, solref=RIGID)
        self.geoms.append(names)
        for k, obstacle in enumerate(self.world.scene.obstacles):
            spring = spring_solref(float(obstacle.stiffness), weights.mass[n])
            for obstacle_geom in (geom for geom in self.owners if geom.startswith(f"obstacle {k} ")):
                for geom in names:
                    self._add_pair(obstacle_geom, geom, (-1, n), condim=1, solref=spring)

    def add_hand(self) -> None:
        hand = self.world.scene.hand
        for link, (centers, radii) in enumerate(zip(hand.skin.centers, hand.skin.radii, strict=True)):
            body = self._add_kinematic_body(f"link {link}")
            for ball in np.flatnonzero(np.asarray(radii) > 0):
                name = f"link {link} {ball}"
                self.owners[name] = (HAND, link)
                self._add_ball(body, name, centers[ball], radii[ball], contype=0, conaffinity=0)
                for n, member in enumerate(self.world.bodies):
                    torsion = float(member.torsion or 0)
                    friction = {
                        "condim": 4 if torsion else 3,
                        "friction": [float(member.friction)] * 2 + [torsion, 0, 0],
                    }
                    for geom in self.geoms[n]:
                        self._add_pair(name, geom, (link, n), solreffriction=STICKING, **friction)

    def compile(self) -> WorldModel:
        model = self.spec.compile()
        owners, links = (
            np.array([self.owners[model.geom(g).name][part] for g in range(model.ngeom)]) for part in (0, 1)
        )
        # The compiler preserves the order of pairs.
        pair_links, pair_bodies = np.array(self.pairs, int).reshape(-1, 2).T
        bodies = np.array([model.body(f"object {n}").id for n in range(len(self.geoms))])
        return WorldModel(model, owners, links, pair_links, pair_bodies, bodies, self.guide)

    def _add_kinematic_body(self, name: str) -> Any:
        """Add a body whose motion is prescribed."""
        body = self.spec.worldbody.add_body(
            name=name, mass=UNMOVED, inertia=[UNMOVED] * 3, ipos=[0, 0, 0], explicitinertial=True, gravcomp=1
        )
        body.add_freejoint()
        return body

    def _add_guide(self, body: Any, guide: Guide, placed: Pose) -> None:
        """Add the guide's joints in the body's own frame; those of a screw are coupled."""
        kinds, axis = self.mujoco.mjtJoint, placed.rotation.T @ guide.axis
        point = placed.rotation.T @ (guide.point - placed.origin)
        if guide.slides:
            body.add_joint(name="slide", type=kinds.mjJNT_SLIDE, axis=axis)
        if guide.turns:
            body.add_joint(name="hinge", type=kinds.mjJNT_HINGE, axis=axis, pos=point)
        if guide.slides and guide.turns:
            self.spec.add_equality(
                type=self.mujoco.mjtEq.mjEQ_JOINT,
                name1="slide",
                name2="hinge",
                objtype=self.mujoco.mjtObj.mjOBJ_JOINT,
                data=[0, guide.pitch, *[0] * 9],
                solref=RIGID,
            )

    def _add_pair(self, first: str, second: str, link_and_body: tuple[int, int], **kwargs: Any) -> None:
        name = f"pair {len(self.pairs)}"
        self.spec.add_pair(name=name, geomname1=first, geomname2=second, solimp=IMPEDANCES, **kwargs)
        self.pairs.append(link_and_body)

    def _add_geoms(self, body: Any, name: str, shape: Shape, owner: tuple[int, int], **kwargs: Any) -> list[str]:
        """Add the geom of an exact shape, or those of a tree's balls; return their names."""
        if isinstance(shape, SphereTree):
            centers, radii = np.asarray(shape.balls.centers), np.asarray(shape.balls.radii)
            names = [f"{name} {ball}" for ball in range(len(radii))]
            for ball_name, center, radius in zip(names, centers, radii, strict=True):
                self._add_ball(body, ball_name, center, radius, **kwargs)
        else:
            kind, size = primitive(self.mujoco, shape)
            names = [f"{name} 0"]
            body.add_geom(name=names[0], type=kind, size=size, condim=3, **kwargs)
        self.owners |= dict.fromkeys(names, owner)
        return names

    def _add_ball(self, body: Any, name: str, center: Any, radius: Any, **kwargs: Any) -> None:
        kind, position = self.mujoco.mjtGeom.mjGEOM_SPHERE, np.asarray(center, float)
        body.add_geom(name=name, type=kind, size=[float(radius), 0, 0], pos=position, condim=3, **kwargs)

    def _quaternion(self, rotation: Any) -> np.ndarray:
        quaternion = np.zeros(4)
        self.mujoco.mju_mat2Quat(quaternion, np.asarray(rotation, float).ravel())
        return quaternion


IMPEDANCES = (IMPEDANCE, IMPEDANCE, 0.001, 0.5, 2.0)


def spring_solref(stiffness: Any, mass: Any) -> np.ndarray:
    """Return MuJoCo's direct solref numbers ``(..., 2)`` for a contact of a stiffness [N/m] on an object of a mass
    [kg].

    MuJoCo's stiffness and damping are accelerations; its regularisation, (1 - d) / (d m) for a single body against a
    fixed one, turns them into forces.
    """
    share = (1 - IMPEDANCE) / np.asarray(mass, float)
    damping = 2 * DAMPING * np.sqrt(np.asarray(stiffness, float) * mass)
    return -np.stack(np.broadcast_arrays(share * stiffness, share * damping), -1)


def primitive(mujoco: Any, shape: Shape) -> tuple[Any, list[float]]:
    kinds = mujoco.mjtGeom
    if isinstance(shape, Sphere):
        return kinds.mjGEOM_SPHERE, [float(shape.radius), 0.0, 0.0]
    if isinstance(shape, Box):
        return kinds.mjGEOM_BOX, [float(edge) / 2 for edge in (shape.length, shape.width, shape.height)]
    if isinstance(shape, (Cylinder, Capsule)):
        kind = kinds.mjGEOM_CYLINDER if isinstance(shape, Cylinder) else kinds.mjGEOM_CAPSULE
        return kind, [float(shape.radius), float(shape.height) / 2, 0.0]
    raise ValueError(f"an object is a {type(shape).__name__}: expected a Sphere, Box, Cylinder, Capsule or SphereTree")
