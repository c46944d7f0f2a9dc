"""Arguments of ``jaxgrasp export FORMAT``."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro


@dataclass(frozen=True, kw_only=True)
class ExportPoses:
    """Arguments of the formats of poses."""

    poses: tyro.conf.Positional[Path]
    """Poses of one object: .npz, ACRONYM's .h5, GraspGen's .json or Isaac Sim's .yaml."""
    contacts: Path | None = None
    """Their contacts, as `jaxgrasp import` or `jaxgrasp contacts` wrote them: which grasps hold comes from the hold
    margin, the least of a grasp's wrenches. What the poses' file says is written where not given."""


@dataclass(frozen=True, kw_only=True)
class ExportIsaacGrasp(ExportPoses):
    """Isaac Sim's isaac_grasp .yaml, with a confidence of 1/2 + margin/4 where a grasp holds, else 0."""

    joints: tuple[str, ...] = ()
    """Names of the columns of a .npz file's angles; a .yaml file has them."""
    object_frame: str = "object"
    """Name of the object's frame, for people."""
    gripper_frame: str = "gripper"
    """Name of the gripper's frame, for people."""
    out: Path = Path("grasps.yaml")
    """The file to write, whole or not at all."""


@dataclass(frozen=True, kw_only=True)
class ExportGraspGen(ExportPoses):
    """GraspGen's .json, where object_in_gripper says which grasps hold."""

    mesh: str | None = None
    """Path of the object's mesh in the data set; as the poses' file has it where not given."""
    out: Path = Path("grasps.json")
    """The file to write, whole or not at all."""


@dataclass(frozen=True, kw_only=True)
class ExportLeRobot:
    """A LeRobot data set (v3.0) with contacts, their forces, the load and the hold margin of each frame."""

    contacts: tyro.conf.Positional[Path]
    """File of contacts, one grasp for each frame of an episode; with several wrenches each grasp is an episode, and its
    wrenches are the frames."""
    fps: float = 30.0
    """Frames a second."""
    task: str = "grasp"
    """What is done, in words."""
    out: Path = Path("grasps-lerobot")
    """Folder of the data set, which must be new or empty."""


@dataclass(frozen=True)
class ExportCommand:
    """Write grasps for other programs, with what the hold margin says of them."""

    command: tyro.conf.OmitSubcommandPrefixes[
        tyro.conf.OmitArgPrefixes[
            Annotated[ExportGraspGen, tyro.conf.subcommand("graspgen")]
            | Annotated[ExportIsaacGrasp, tyro.conf.subcommand("isaac-grasp")]
            | Annotated[ExportLeRobot, tyro.conf.subcommand("lerobot")]
        ]
    ]
