"""Tasks that can fail: a plug into a socket, and a block onto another one, with a hand on an arm in MuJoCo.

The hand hangs over the table with its palm down; the plug's grip, or the block, stands between thumb and fingers.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from jaxtyping import Float

from jaxgrasp.interop.mujoco_contacts import import_mujoco
from jaxgrasp.teleop.follower import PalmPose
from jaxgrasp.teleop.mujoco_hand import HandModel, MujocoFollower, robot_spec
from jaxgrasp.validation.checked import checked

TaskName = Literal["peg", "stack"]
PALM_DOWN = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
"""Axes of the Shadow hand's palm as columns: fingers along the world's x, back of the hand up, thumb towards y."""
GRIP_POINT = np.array([0.0, -0.078, 0.111])
"""Point between thumb and fingers, in the palm's frame of the Shadow hand [m]."""
HALF_GRIP = (0.018, 0.035, 0.022)
"""Half of the grip's sides along the world's axes [m]."""
PEG_RADIUS, PEG_LENGTH = 0.012, 0.06
CLEARANCE = 1.5e-3
"""Of the peg in the hole, on each side [m]."""
SOCKET_HEIGHT = 0.04
TARGET = np.array([0.0, 0.12])
"""From the start to the hole or the lower block, along the table [m]."""
GOAL_DEPTH = 0.03
"""Depth of the peg in the hole that is success [m]."""
OBJECT_MASS = 0.08
FRICTION = (1.0, 0.005, 1e-4)
BLOCK_HEIGHT = 2 * HALF_GRIP[2]


@dataclass(frozen=True)
class TeleopTask:
    """A task with a robot hand: the world, its parts, and what counts as success."""

    name: TaskName
    home: PalmPose
    """Pose of the palm at the start."""
    tip_depth: float
    """From the object's origin down to its lowest end [m]."""
    target: Float[np.ndarray, "2"]
    """Place of the hole or of the lower block, along the table [m]."""
    contact_height: float
    """Height of the socket's rim or of the lower block's top [m]."""

    def follower(self, model: HandModel) -> MujocoFollower:
        """Build the world with the robot in it."""
        return MujocoFollower(self.spec(model), model, self.home, "object")

    def spec(self, model: HandModel) -> Any:
        """Build the specification of the world with the robot in it."""
        return robot_spec(model, self.home, self._adder())

    def tip(self, follower: MujocoFollower) -> Float[np.ndarray, "3"]:
        """Compute the place of the object's lowest end, on its axis [m]."""
        body = follower.data.body("object")
        return body.xpos - self.tip_depth * body.xmat.reshape(3, 3)[:, 2]

    def is_done(self, follower: MujocoFollower) -> bool:
        """Tell from the true poses whether the peg is in the hole, or the block rests on the lower one, let go."""
        tip, body = self.tip(follower), follower.data.body("object")
        across = np.linalg.norm(tip[:2] - self.target)
        if self.name == "peg":
            return bool(tip[2] < self.contact_height - GOAL_DEPTH + 1e-3 and across < PEG_RADIUS / 2)
        is_level = abs(tip[2] - self.contact_height) < 3e-3 and body.xmat[8] > 0.98
        is_at_rest = np.linalg.norm(body.cvel) < 0.05 and not len(follower.contacts().links)
        return bool(is_level and is_at_rest and across < min(HALF_GRIP[:2]))

    def _adder(self) -> Callable[[Any], None]:
        return _add_peg if self.name == "peg" else _add_blocks


@checked
def make_task(name: TaskName) -> TeleopTask:
    """Return a task by its name: ``"peg"`` or ``"stack"``.

    Raises:
        ValueError: for another name.
    """
    if name == "peg":
        # The tip stands on the table, in a wide holder.
        depth = PEG_LENGTH + HALF_GRIP[2]
        return TeleopTask(name, _home(depth), depth, TARGET, SOCKET_HEIGHT)
    if name == "stack":
        depth = BLOCK_HEIGHT / 2
        return TeleopTask(name, _home(depth), depth, TARGET, BLOCK_HEIGHT)
    raise ValueError(f"task is {name!r}: expected 'peg' or 'stack'")


def _home(height: float) -> PalmPose:
    return PalmPose(np.array([0.0, 0.0, height]) - PALM_DOWN @ GRIP_POINT, PALM_DOWN)


def _add_table(mujoco: Any, spec: Any) -> None:
    spec.worldbody.add_geom(name="table", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0.5, 0.5, 0.05], friction=FRICTION)


def _add_object(mujoco: Any, spec: Any, height: float) -> Any:
    body = spec.worldbody.add_body(name="object", pos=[0.0, 0.0, height])
    body.add_freejoint()
    body.add_geom(
        name="grip", type=mujoco.mjtGeom.mjGEOM_BOX, size=HALF_GRIP, mass=OBJECT_MASS, friction=FRICTION, condim=4
    )
    return body


def _add_peg(spec: Any) -> None:
    mujoco = import_mujoco("make_task")
    _add_table(mujoco, spec)
    body = _add_object(mujoco, spec, PEG_LENGTH + HALF_GRIP[2])
    body.add_geom(
        name="peg",
        type=mujoco.mjtGeom.mjGEOM_CYLINDER,
        size=[PEG_RADIUS, PEG_LENGTH / 2, 0],
        pos=[0, 0, -HALF_GRIP[2] - PEG_LENGTH / 2],
        mass=OBJECT_MASS / 4,
        friction=(0.3, 0.005, 1e-4),
        # The larger coefficient of a pair counts unless one geom has priority.
        priority=1,
    )
    for k, (place, gap, height) in enumerate(((np.zeros(2), 3e-3, 0.03), (TARGET, CLEARANCE, SOCKET_HEIGHT))):
        _add_socket(mujoco, spec, f"socket {k}", place, PEG_RADIUS + gap, height)


def _add_socket(mujoco: Any, spec: Any, name: str, place: np.ndarray, half: float, height: float) -> None:
    """Add a square hole of half-width ``half`` in a block of half-width 0.05, by four walls."""
    outer = 0.04
    wall = (outer - half) / 2
    for k, (x, y) in enumerate(((1, 0), (-1, 0), (0, 1), (0, -1))):
        spec.worldbody.add_geom(
            name=f"{name} wall {k}",
            type=mujoco.mjtGeom.mjGEOM_BOX,
            size=[wall if x else outer, wall if y else outer, height / 2],
            pos=[place[0] + x * (half + wall), place[1] + y * (half + wall), height / 2],
            friction=FRICTION,
        )


def _add_blocks(spec: Any) -> None:
    mujoco = import_mujoco("make_task")
    _add_table(mujoco, spec)
    _add_object(mujoco, spec, BLOCK_HEIGHT / 2)
    lower = spec.worldbody.add_body(name="lower block", pos=[*TARGET, BLOCK_HEIGHT / 2])
    lower.add_freejoint()
    lower.add_geom(
        name="lower block", type=mujoco.mjtGeom.mjGEOM_BOX, size=HALF_GRIP, mass=OBJECT_MASS, friction=FRICTION
    )
