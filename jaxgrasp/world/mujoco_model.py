"""The model that MuJoCo's engine moves: what of a world becomes which of its bodies, geoms and pairs."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from jaxgrasp.grip.scene import Obstacle
from jaxgrasp.hand.shapes import Box, Capsule, Cylinder, Shape, Sphere
from jaxgrasp.hand.sphere_tree import SphereTree
from jaxgrasp.model.hand import Pose
from jaxgrasp.world.many_bodies import Masses, Thing, World
from jaxgrasp.world.physics import HAND, OBSTACLES, TABLE

if TYPE_CHECKING:
    import mujoco

UNMOVED = 1e3
"""Mass of a link's body [kg]: a newton in a step of a millisecond makes it a micrometre a second slower. More of it
would hide the objects' own inertia from the solver's tolerance."""
RIGID = (0.004, 1.0)
"""Time constant [s] and damping ratio of contacts among objects, and with the table."""
IMPEDANCE = 0.9
"""MuJoCo's share of a spring's constraint that is met at once."""
DAMPING = 1.0
"""Damping ratio of springs, for the object's own mass."""
STICKING = (0.002, 1.0)
"""Time constant [s] and damping ratio by which friction at the hand stops sliding."""
RATIO = 10.0
"""How much stiffer friction is than what presses: by less, what is held creeps."""


STRAIGHT = 1e-12
"""Pitch of a screw below which it is a hinge [m/rad]."""


class WorldModel(NamedTuple):
    """A compiled model, and where things are in it."""

    model: mujoco.MjModel
    owners: np.ndarray
    """``(ngeom,)``: which object a geom belongs to; -1 of the hand, -2 of the table, -3 of obstacles."""
    links: np.ndarray
    """``(ngeom,)``: which link a geom is of; -1 for others."""
    pair_links: np.ndarray
    """``(npair,)``: the link of each pair; -1 of those of obstacles."""
    pair_things: np.ndarray
    """``(npair,)``: the object of each pair."""
    bodies: np.ndarray
    """``(N,)``: ids of the objects' bodies."""
    guide: Guide | None
    """That of the first object."""


class Guide(NamedTuple):
    """A slide, a hinge or a screw in the world."""

    axis: np.ndarray
    """``(3,)`` unit."""
    point: np.ndarray
    """``(3,)``: one that a hinge or screw goes through [m]."""
    slides: bool
    turns: bool
    pitch: float
    """Way along the axis for a radian of a screw [m]."""


def read_guide(guide: np.ndarray) -> Guide:
    """What the one twist ``(6, 1)`` about the world's origin is.

    Raises:
        ValueError: for more than one.
    """
    if guide.shape[1] != 1:
        raise ValueError(f"guide has {guide.shape[1]} twists: expected one, as of a slide, a hinge or a screw")
    along, about = guide[:3, 0], guide[3:, 0]
    speed, turning = np.linalg.norm(along), np.linalg.norm(about)
    if turning == 0:
        return Guide(along / speed, np.zeros(3), True, False, 0.0)
    axis, pitch = about / turning, float(about @ along / turning**2)
    return Guide(axis, np.cross(about, along) / turning**2, bool(abs(pitch) > STRAIGHT), True, pitch)


def world_model(mujoco: Any, world: World, weights: Masses, placed: Pose) -> WorldModel:
    """Build and compile it, with objects where they stand at first.

    Raises:
        ValueError: for shapes that MuJoCo's model does not have here, and a guide of more than one twist.
    """
    building = _Building(mujoco, world)
    building.add_table()
    for k, obstacle in enumerate(world.scene.obstacles):
        building.add_obstacle(k, obstacle)
    for n, thing in enumerate(world.things):
        building.add_thing(n, thing, weights, Pose(placed.origin[n], placed.rotation[n]))
    building.add_hand()
    return building.compiled()


class _Building:
    """Bodies, geoms and pairs as they are added; names say whose they are."""

    def __init__(self, mujoco: Any, world: World):
        self.mujoco, self.world = mujoco, world
        self.spec = spec = mujoco.MjSpec()
        spec.option.gravity = np.asarray(world.scene.gravity, float)
        spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
        spec.option.impratio = RATIO
        spec.option.tolerance = 1e-13
        self.guide = None if world.scene.guide is None else read_guide(np.asarray(world.scene.guide, float))
        self.whose: dict[str, tuple[int, int]] = {}
        self.pairs: list[tuple[int, int]] = []
        self.geoms: list[list[str]] = []

    def add_table(self) -> None:
        table = self.world.scene.table
        self.whose["table"] = (TABLE, -1)
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
            body = self._add_led(f"obstacle {k}")
        self._add_geoms(body, f"obstacle {k}", obstacle.shape, (OBSTACLES, -1), contype=0, conaffinity=0)

    def add_thing(self, n: int, thing: Thing, weights: Masses, placed: Pose) -> None:
        body = self.spec.worldbody.add_body(
            name=f"thing {n}",
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
        friction = [float(thing.rubbing), 0, 0]
        names = self._add_geoms(body, f"thing {n}", thing.body.shape, (n, -1), friction=friction, solref=RIGID)
        self.geoms.append(names)
        for k, obstacle in enumerate(self.world.scene.obstacles):
            spring = spring_solref(float(obstacle.stiffness), weights.mass[n])
            for name in (own for own in self.whose if own.startswith(f"obstacle {k} ")):
                for own in names:
                    self._add_pair(name, own, (-1, n), condim=1, solref=spring)

    def add_hand(self) -> None:
        hand = self.world.scene.hand
        for link, (centers, radii) in enumerate(zip(hand.skin.centers, hand.skin.radii, strict=True)):
            body = self._add_led(f"link {link}")
            for ball in np.flatnonzero(np.asarray(radii) > 0):
                name = f"link {link} {ball}"
                self.whose[name] = (HAND, link)
                self._add_ball(body, name, centers[ball], radii[ball], contype=0, conaffinity=0)
                for n, thing in enumerate(self.world.things):
                    torsion = float(thing.torsion or 0)
                    rubs = {"condim": 4 if torsion else 3, "friction": [float(thing.friction)] * 2 + [torsion, 0, 0]}
                    for own in self.geoms[n]:
                        self._add_pair(name, own, (link, n), solreffriction=STICKING, **rubs)

    def compiled(self) -> WorldModel:
        model = self.spec.compile()
        owners, links = (
            np.array([self.whose[model.geom(g).name][part] for g in range(model.ngeom)]) for part in (0, 1)
        )
        # The compiler keeps the order of pairs.
        pair_links, pair_things = np.array(self.pairs, int).reshape(-1, 2).T
        bodies = np.array([model.body(f"thing {n}").id for n in range(len(self.geoms))])
        return WorldModel(model, owners, links, pair_links, pair_things, bodies, self.guide)

    def _add_led(self, name: str) -> Any:
        """A body whose motion is prescribed."""
        body = self.spec.worldbody.add_body(
            name=name, mass=UNMOVED, inertia=[UNMOVED] * 3, ipos=[0, 0, 0], explicitinertial=True, gravcomp=1
        )
        body.add_freejoint()
        return body

    def _add_guide(self, body: Any, guide: Guide, placed: Pose) -> None:
        """Joints in the body's own frame; those of a screw are tied."""
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

    def _add_pair(self, one: str, other: str, whose: tuple[int, int], **kwargs: Any) -> None:
        name = f"pair {len(self.pairs)}"
        self.spec.add_pair(name=name, geomname1=one, geomname2=other, solimp=IMPEDANCES, **kwargs)
        self.pairs.append(whose)

    def _add_geoms(self, body: Any, name: str, shape: Shape, whose: tuple[int, int], **kwargs: Any) -> list[str]:
        """The geoms of an exact shape, or of a tree's balls; their names."""
        if isinstance(shape, SphereTree):
            centers, radii = np.asarray(shape.balls.centers), np.asarray(shape.balls.radii)
            names = [f"{name} {ball}" for ball in range(len(radii))]
            for each, center, radius in zip(names, centers, radii, strict=True):
                self._add_ball(body, each, center, radius, **kwargs)
        else:
            kind, size = primitive(self.mujoco, shape)
            names = [f"{name} 0"]
            body.add_geom(name=names[0], type=kind, size=size, condim=3, **kwargs)
        self.whose |= dict.fromkeys(names, whose)
        return names

    def _add_ball(self, body: Any, name: str, center: Any, radius: Any, **kwargs: Any) -> None:
        kind, place = self.mujoco.mjtGeom.mjGEOM_SPHERE, np.asarray(center, float)
        body.add_geom(name=name, type=kind, size=[float(radius), 0, 0], pos=place, condim=3, **kwargs)

    def _quaternion(self, rotation: Any) -> np.ndarray:
        quaternion = np.zeros(4)
        self.mujoco.mju_mat2Quat(quaternion, np.asarray(rotation, float).ravel())
        return quaternion


IMPEDANCES = (IMPEDANCE, IMPEDANCE, 0.001, 0.5, 2.0)


def spring_solref(stiffness: Any, mass: Any) -> np.ndarray:
    """MuJoCo's direct numbers ``(..., 2)`` for a contact that presses by a stiffness [N/m] an object of a mass [kg].

    What MuJoCo calls stiffness and damping are accelerations; its regularisation, for a body that is alone against what
    does not move (1 - d) / (d m), makes forces of them.
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
