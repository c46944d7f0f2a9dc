"""Arguments of ``jaxgrasp import FORMAT`` and ``jaxgrasp export FORMAT``."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro


@dataclass(frozen=True, kw_only=True)
class ImportGrasps:
    """Arguments of every format."""

    files: tyro.conf.Positional[tuple[Path, ...]]
    """The files."""
    friction: float | None = None
    """Coulomb's coefficient; the file's, or 0.5, where not given."""
    mass: float | None = None
    """Mass of the object [kg]; the file's, or 0.1, where not given."""
    gravity: tuple[float, float, float] = (0.0, 0.0, -9.81)
    """Gravity in the frame of the contacts, the mesh's or the file's world [m/s^2]."""
    keep_going: bool = False
    """Leave bad records and files out and count them, instead of stopping at the first."""
    out: Path = Path("grasps.npz")
    """The file of contacts."""


@dataclass(frozen=True, kw_only=True)
class ImportPoses(ImportGrasps):
    """Formats that say where a hand stands: contacts come from its geometry and the mesh's."""

    object: Path | None = None
    """The object's mesh, closed; or the folder under which the paths lie that the files name, which are looked for
    beside the files and above where not given."""
    scale: float | None = None
    """Metres for one unit of the mesh; the file's, or 1, where not given."""
    levels: int = 6
    """Number of times that the cube about the mesh is cut in eight."""
    stiffness: float = 1000.0
    """K of eq. 6 [N/m]: squeezing forces are K times the depth of the links in the mesh."""
    max_contacts: int | None = None
    """Largest number of contacts of a grasp: the deepest are kept."""


@dataclass(frozen=True, kw_only=True)
class ImportHands(ImportPoses):
    """Formats of hands, which stay as they stand."""

    hand: Path
    """The hand's MJCF, with the joints of the files; parts that this MuJoCo does not know are left out."""
    root: str | None = None
    """Body of the hand that the files place; the format's usual one where not given."""
    reach: float = 1e-3
    """Largest distance from the mesh at which a link touches it [m]: the files' hands stand at its surface."""


@dataclass(frozen=True, kw_only=True)
class DexGraspNet(ImportHands):
    """DexGraspNet's .npy files of the Shadow hand, joints by name."""


@dataclass(frozen=True, kw_only=True)
class DexGraspBench(ImportHands):
    """DexGraspBench's .npy files, joints in the order of the hand's MJCF; needs that MJCF."""

    posture: Literal["pregrasp", "grasp", "squeeze"] = "grasp"
    """The posture of a file whose contacts count."""


@dataclass(frozen=True, kw_only=True)
class GraspIt(ImportHands):
    """GraspIt!'s world .xml files, whose numbers have no names: needs the order of the hand's joints."""

    order: tuple[str, ...]
    """The hand's joint that each number of dofValues is of, and - for a flag of a joint that breaks away."""
    robot: str | None = None
    """The robot that is the hand, of several, by the name of its model's file."""


@dataclass(frozen=True, kw_only=True)
class ImportGrippers(ImportPoses):
    """Formats of two parallel jaws, which close on the mesh."""

    gripper: Literal["franka", "robotiq-2f-85", "robotiq-2f-140"] = "franka"
    """Gripper that the opening and the pads are of; it looks along z."""
    opening: float | None = None
    """Distance between the open pads [m]; the gripper's where not given."""
    pads: tuple[float, float] | None = None
    """Begin and end of the pads along z [m]; the gripper's where not given."""
    closes_along: Literal["x", "y"] = "x"
    """Axis of the files' frame along which the jaws close."""
    depth: float = 1e-3
    """Depth to which the jaws press into the mesh [m]."""
    successful: bool = False
    """Import only the grasps that held in simulation according to the file."""


@dataclass(frozen=True, kw_only=True)
class IsaacGrasp(ImportGrippers):
    """Isaac Sim's isaac_grasp .yaml files of two-jaw grippers, whatever frames they are in."""


@dataclass(frozen=True, kw_only=True)
class GraspGen(ImportGrippers):
    """GraspGen's .json files of two-jaw grippers."""


@dataclass(frozen=True, kw_only=True)
class ACRONYM(ImportGrippers):
    """ACRONYM's .h5 files of the Franka hand."""


@dataclass(frozen=True, kw_only=True)
class ImportContacts(ImportGrasps):
    """Formats that have contacts: they are used as they are, and no hand is needed."""

    center: tuple[float, float, float] | None = None
    """Centre of mass of the object in the file's world [m]; the file's, or the mesh's, where not given."""
    force: float = 1.0
    """Newtons for one unit of the file's forces."""
    squeeze: float = 1.0
    """Squeezing force of contacts without forces in the file [N]."""
    torsion: float | None = None
    """Torque about the normal for one newton that presses [m], of soft fingers; hard ones where not given."""


@dataclass(frozen=True, kw_only=True)
class Dexonomy(ImportContacts):
    """Dexonomy's .npy files, grasps and templates, with their own contacts."""


@dataclass(frozen=True, kw_only=True)
class BODex(ImportContacts):
    """BODex's .npy files, with their own contacts."""

    object: Path | None = None
    """The object's mesh, for its centre of mass; or the folder under which the paths lie that the files name."""


@dataclass(frozen=True)
class ImportCommand:
    """Convert another project's grasps to a file of contacts for evaluate (extras `hands` and `mesh`)."""

    command: tyro.conf.OmitSubcommandPrefixes[
        tyro.conf.OmitArgPrefixes[
            Annotated[ACRONYM, tyro.conf.subcommand("acronym")]
            | Annotated[BODex, tyro.conf.subcommand("bodex")]
            | Annotated[DexGraspBench, tyro.conf.subcommand("dexgraspbench")]
            | Annotated[DexGraspNet, tyro.conf.subcommand("dexgraspnet")]
            | Annotated[Dexonomy, tyro.conf.subcommand("dexonomy")]
            | Annotated[GraspGen, tyro.conf.subcommand("graspgen")]
            | Annotated[GraspIt, tyro.conf.subcommand("graspit")]
            | Annotated[IsaacGrasp, tyro.conf.subcommand("isaac-grasp")]
        ]
    ]


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
