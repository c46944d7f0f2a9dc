"""The commands and their arguments: plain dataclasses, which need no JAX to be read."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from jaxgrasp.cli.experiment_arguments import Experiment
from jaxgrasp.cli.glove_arguments import Glove

MethodName = Literal["A", "B", "A-optimum", "B-optimum"]


@dataclass(frozen=True)
class Data:
    """Which grasps, and how they differ from the conventions."""

    file: tyro.conf.Positional[Path | None] = None
    """An .npz or .csv file of grasps; the simulated grips that ship with the package where not given."""
    normals: Literal["inward", "outward"] = "inward"
    """Where the file's normals point: into the object, or out of it."""


@dataclass(frozen=True)
class Evaluate(Data):
    """Compute closed forms and constrained optima of every grasp, sum them up, and write results and a report."""

    methods: tuple[MethodName, ...] = ("A", "B", "A-optimum", "B-optimum")
    """What to compute: method A (eq. 11), B (eq. 15), and their optima with friction imposed."""
    quality: str = ""
    """Measures of the grasps whatever they hold, with commas between them: force-closure, ferrari-canny-l1,
    ferrari-canny-linf, min-weight, least-singular-value, volume, isotropy. Balls cost up to a second a grasp."""
    friction: tuple[float, ...] = ()
    """Friction for all contacts, in place of the file's; several values are evaluated one after another."""
    squeeze: tuple[float, ...] = ()
    """Squeezing force for all contacts [N], in place of the file's; several values likewise."""
    out: Path = Path("jaxgrasp-results")
    """Folder for the results; it gets one sub-folder a value where values are swept."""
    chunk: int = 16_384
    """Grasps that each core works on at a time."""
    dtype: Literal["float64", "float32"] = "float64"
    """Precision of the arithmetic."""
    skip_bad: bool = False
    """Set bad grasps aside and count them, instead of stopping at the first."""
    resume: bool = False
    """Go on with an interrupted evaluation in the same folder."""
    report: bool = True
    """Write report.html beside the results (needs the extra `report`)."""

    def run(self) -> int:
        from jaxgrasp.cli.evaluate import evaluate_command

        return evaluate_command(self)


@dataclass(frozen=True)
class Info(Data):
    """Say what a file of grasps holds."""

    def run(self) -> int:
        from jaxgrasp.cli.inspect import info_command

        return info_command(self)


@dataclass(frozen=True)
class Validate(Data):
    """List every bad entry of a file of grasps; the exit code is 1 if there is any."""

    def run(self) -> int:
        from jaxgrasp.cli.inspect import validate_command

        return validate_command(self)


@dataclass(frozen=True)
class Grip:
    """Close the virtual hand on an object, lift it, turn it, and write contacts, forces, verdicts and torques.

    grip.npz holds arrays over time: points, normals, depths, forces and squeeze by `links`, angles and torques by
    `joints` (what resists flexion is negative). Points, normals, forces and poses are in the world, wrench and missed
    about the object's centre. Codes are those of jaxgrasp.grip.Hold, Touch, GripType and Verdict.
    """

    object: Literal["cylinder", "sphere", "capsule", "box"] = "cylinder"
    """What is gripped; in a power grip it lies across the palm."""
    grip: Literal["power", "precision-3", "precision-5"] = "power"
    """All of the hand around the object; or three or five fingertips, the thumb's opposite the others."""
    radius: float = 0.03
    """Radius of the object [m]; half the edge of a box."""
    height: float = 0.12
    """Height of a cylinder, of a capsule's straight part, or of a box [m]."""
    mass: float = 0.4
    """Mass of the object [kg]."""
    friction: float = 0.6
    """Coulomb's coefficient at every contact."""
    stiffness: float = 1000.0
    """K [N/m] of the paper's eq. 6: a contact's squeeze is K times its depth times its link's contribution."""
    depth: float = 2e-3
    """How far the links press into the object [m]."""
    hand_length: float = 0.19
    """Length of the hand, from the wrist to the middle finger's tip [m]."""
    side: Literal["right", "left"] = "right"
    """Which hand."""
    lift: float = 0.2
    """How high the hand goes [m]."""
    turn: float = 90.0
    """How far it then turns about its own length, by the right hand about the wrist's x [degrees]."""
    release: bool = False
    """Open the hand at the end."""
    seconds: float = 4.0
    """A quarter of it each to hold, lift, turn, and hold or let go [s]; in a short time inertia weighs more."""
    step: float = 0.02
    """Time from one instant to the next [s]."""
    law: Literal["closed-form", "optimum"] = "optimum"
    """Which forces decide whether the object slips; the paper's are the closed form, jaxgrasp.grip.carry's default."""
    report: bool = True
    """Write grip.html, grip.png and grip_forces.png beside the results (needs the extra `report`)."""
    out: Path = Path("jaxgrasp-grip")
    """Folder for the results."""

    def run(self) -> int:
        from jaxgrasp.cli.grip import grip_command

        return grip_command(self)


@dataclass(frozen=True)
class Contacts:
    """Find where hands or grippers touch a mesh, and write a file of contacts for evaluate (needs the extra `mesh`)."""

    file: tyro.conf.Positional[Path]
    """Poses of the wrist in the mesh's frame: .npz with `transforms` (N, 4, 4) and, of hands that do not close any
    further, `angles` (N, J); or ACRONYM's HDF5."""
    mesh: Path | None = None
    """A closed triangle mesh, in any format that trimesh reads; the one that the file names where not given."""
    scale: float | None = None
    """Metres for one unit of the mesh; the file's, or 1, where not given."""
    hand: Literal["jaw", "human-right", "human-left"] = "jaw"
    """Two parallel jaws like a Franka hand's, or a human hand."""
    hand_length: float = 0.19
    """Length of a human hand, from the wrist to the middle finger's tip [m]."""
    levels: int = 6
    """How often the cube about the mesh is cut in eight."""
    depth: float = 1e-3
    """How far a closing hand presses into the mesh [m]."""
    friction: float | None = None
    """Coulomb's coefficient; the file's where not given."""
    stiffness: float = 1000.0
    """K of eq. 6 [N/m]."""
    mass: float | None = None
    """Mass of the object [kg]; the file's where not given."""
    gravity: tuple[float, float, float] = (0.0, 0.0, -9.81)
    """Gravity in the mesh's frame [m/s^2]."""
    max_contacts: int | None = None
    """The most contacts of a grasp: the deepest are kept."""
    out: Path = Path("contacts.npz")
    """The file of contacts."""

    def run(self) -> int:
        from jaxgrasp.cli.contacts import contacts_command

        return contacts_command(self)


@dataclass(frozen=True)
class Sensitivity:
    """Follow slip angles along a task, and how every parameter moves them; write curves, a ranking and a figure.

    sensitivity.csv has a row for each method, finger and instant: the slip angle [rad] and its derivatives.
    ranking.csv has the parameters by their influence on the slip angles of each method, and on the reserve of friction,
    by which an optimum is ranked: its active contacts have no margin left.
    """

    task: Literal["cylinder"] = "cylinder"
    """The paper's (section II-G.3): five fingertips turn a cylinder of 10 N at pi rad/s, there and back."""
    methods: tuple[MethodName, ...] = ("A", "B", "B-optimum")
    """Methods by which forces are distributed."""
    by: tuple[str, ...] = ("contributions", "friction", "depths", "stiffness", "azimuths", "radius", "mass", "speed")
    """The parameters to differentiate by: whole arrays, or entries such as contributions[index]."""
    finger: Literal["thumb", "index", "middle", "ring", "little"] = "index"
    """Finger whose slip angle the figure shows."""
    vary: str = "contributions[index]"
    """The parameter that the figure varies."""
    values: tuple[float, ...] = (0.02, 0.1, 0.4)
    """What it is given, one after another."""
    seconds: float = 4.0
    """How long [s]."""
    step: float = 0.01
    """Time from one instant to the next [s]."""
    report: bool = True
    """Draw sensitivity.png beside the tables (needs the extra `report`)."""
    out: Path = Path("jaxgrasp-sensitivity")
    """Folder for the results."""

    def run(self) -> int:
        from jaxgrasp.cli.sensitivity import sensitivity_command

        return sensitivity_command(self)


Command = (
    Annotated[Contacts, tyro.conf.subcommand("contacts")]
    | Annotated[Evaluate, tyro.conf.subcommand("evaluate")]
    | Annotated[Experiment, tyro.conf.subcommand("experiment")]
    | Annotated[Glove, tyro.conf.subcommand("glove")]
    | Annotated[Grip, tyro.conf.subcommand("grip")]
    | Annotated[Info, tyro.conf.subcommand("info")]
    | Annotated[Sensitivity, tyro.conf.subcommand("sensitivity")]
    | Annotated[Validate, tyro.conf.subcommand("validate")]
)
