"""Arguments of the commands on grasps, hands, scenes, sensitivities, the viewer, and the suite of problems."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro


@dataclass(frozen=True)
class Convention:
    """Differences of a file's grasps from the conventions."""

    normals: Literal["inward", "outward"] = "inward"
    """Direction of the file's normals: into the object, or out of it."""
    normalize: bool = False
    """Scale every normal to length 1; those of tables with few digits are not."""


@dataclass(frozen=True)
class Data(Convention):
    """File of grasps, and its differences from the conventions."""

    file: tyro.conf.Positional[Path | None] = None
    """A file of grasps (.npz, .csv, .parquet, .h5); the simulated grips that ship with the package where not given."""


@dataclass(frozen=True)
class Info(Data):
    """Say what a file of grasps holds."""


@dataclass(frozen=True)
class Kernel:
    """Say where the C++ solver of one grasp lies, for controllers that run without Python and JAX."""

    include: bool = False
    """Print the folder of the headers alone, for the compiler's option -I."""


@dataclass(frozen=True)
class Validate(Data):
    """List every bad entry of a file of grasps; the exit code is 1 if there is any."""


@dataclass(frozen=True)
class Convert:
    """Convert a file of grasps to another format: .npz, .csv, .parquet or .h5, by the endings of the names."""

    file: tyro.conf.Positional[Path]
    """The file to read."""
    out: tyro.conf.Positional[Path]
    """The file to write, whole or not at all."""
    normals: Literal["inward", "outward"] = "inward"
    """Direction of the normals in the file to read; those that are written point into the object."""
    normalize: bool = False
    """Scale every normal to length 1; those of tables with few digits are not."""
    overwrite: bool = False
    """Replace an existing file."""


@dataclass(frozen=True)
class Template:
    """Write a small file of grasps with comments, to be filled in."""

    kind: tyro.conf.Positional[Literal["csv"]] = "csv"
    """Format of the file."""
    out: Path = Path("grasps.csv")
    """The file to write; an existing file is an error, and stays."""


MethodName = Literal["A", "B", "A-optimum", "B-optimum"]


@dataclass(frozen=True)
class Evaluate(Convention):
    """Compute closed forms and constrained optima of every grasp, sum them up, and write results and a report."""

    file: tyro.conf.Positional[tuple[str, ...]] = ()
    """A file of grasps (.npz, .csv, .parquet, .h5); the simulated grips that ship with the package where not given.
    With --cluster any number of Parquet files, or folders of them; of an object store too, by address:
    s3://bucket/folder/*.parquet."""
    methods: tuple[MethodName, ...] = ("A", "B", "A-optimum", "B-optimum")
    """Methods to compute: method A (eq. 11), B (eq. 15), and their optima with friction imposed."""
    quality: str = ""
    """Measures of the grasps whatever they hold, with commas between them: force-closure, ferrari-canny-l1,
    ferrari-canny-linf, min-weight, least-singular-value, volume, isotropy; with --task also task-ball-l1,
    task-ball-linf, task-margin, hold-probability. Balls cost up to a second a grasp."""
    task: Path | None = None
    """A TOML file of a task's demands on the grasps, for the measures of quality of a task: wrenches, an ellipsoid of
    disturbances, uncertainty."""
    friction: tuple[float, ...] = ()
    """Friction for all contacts, in place of the file's; several values are evaluated one after another."""
    squeeze: tuple[float, ...] = ()
    """Squeezing force for all contacts [N], in place of the file's; several values likewise."""
    torsion: float | None = None
    """Torsional friction of all contacts [m], in place of the file's: soft fingers, which resist some torque about
    their normals, as wide pads do. A pad's torsional friction is about its friction times 2/3 of its radius."""
    least_friction: bool = False
    """Find the least factor on its friction with which each grasp holds, if its normal forces together are its squeeze:
    above 1 it has to press harder. Costs about half a millisecond a grasp and wrench."""
    table: Literal["auto", "csv", "parquet", "none"] = "auto"
    """A table beside the results, one row for each grasp and wrench: auto writes results.csv up to 100,000 rows.
    Parquet, which holds the forces too, needs the extra `table`."""
    out: Path = Path("jaxgrasp-results")
    """Folder for the results; it gets one sub-folder a value where values are swept."""
    chunk: int = 16_384
    """Grasps that each core works on at a time."""
    dtype: Literal["float64", "float32"] = "float64"
    """Precision of the arithmetic."""
    skip_bad: bool = False
    """Set bad grasps aside and count them, instead of stopping at the first."""
    resume: bool = False
    """Go on with an interrupted evaluation in the same folder; files of results that are damaged are computed again."""
    overwrite: bool = False
    """Replace the results of another evaluation in the folder; without this option they stay, and are an error."""
    details: bool = False
    """Also print the statistics of each method: verdicts, times, the price of friction, distances in force."""
    report: bool = True
    """Write report.html beside the results (needs the extra `report`)."""
    cluster: str | None = None
    """Evaluate many Parquet files, each by some process of a cluster of Ray (extra `cluster`): `local` starts one on
    this machine, `auto` takes the one that runs here or that RAY_ADDRESS names, anything else is its address. Writes a
    Parquet file of results for each, by its own name."""
    workers: int | None = None
    """With --cluster: processes, of one core each; all cores of the cluster where not given."""
    gpus: float = 0.0
    """With --cluster: GPUs of each process."""
    skip_damaged: bool = False
    """With --cluster: name files that are damaged or hold bad grasps, and go on with the others."""


@dataclass(frozen=True)
class FindContacts:
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
    """Number of times that the cube about the mesh is cut in eight."""
    depth: float = 1e-3
    """Depth to which a closing hand presses into the mesh [m]."""
    friction: float | None = None
    """Coulomb's coefficient; the file's where not given."""
    stiffness: float = 1000.0
    """K of eq. 6 [N/m]."""
    mass: float | None = None
    """Mass of the object [kg]; the file's where not given."""
    gravity: tuple[float, float, float] = (0.0, 0.0, -9.81)
    """Gravity in the mesh's frame [m/s^2]."""
    max_contacts: int | None = None
    """Largest number of contacts of a grasp: the deepest are kept."""
    out: Path = Path("contacts.npz")
    """The file of contacts."""


@dataclass(frozen=True)
class Rank:
    """List the grasps of an evaluation by any column of its table."""

    results: tyro.conf.Positional[Path]
    """The folder that jaxgrasp evaluate wrote."""
    by: str
    """A column with numbers, as results.csv has them: B.margin_deg, ferrari-canny-l1.lower; or a measure of quality,
    which stands for its first column."""
    top: int = 20
    """Number of grasps."""
    smallest: bool = False
    """Start with the smallest number instead of the largest."""


@dataclass(frozen=True)
class Show(Data):
    """Draw one grasp of a file in three dimensions, with the forces of both answers."""

    grasp: str = "0"
    """Name of the grasp, or its number from 0."""
    wrench: int = 0
    """Number of one of its wrenches, from 0."""
    method: Literal["A", "B"] = "B"
    """Method whose closed form and optimum are drawn."""
    mesh: Path | None = None
    """The object, in the frame of the contacts (needs the extra `mesh`)."""
    scale: float = 1.0
    """Metres for one unit of the mesh."""
    out: Path = Path("show.html")
    """The page to write."""


@dataclass(frozen=True)
class Grip:
    """Close the virtual hand on an object, lift it, turn it, and write contacts, forces, verdicts and torques.

    grip.npz holds arrays over time: points, normals, depths, forces and squeeze by `links`, angles and torques by
    `joints` (what resists flexion is negative). Points, normals, forces and poses are in the world, wrench and missed
    about the object's centre. Codes are those of jaxgrasp.grip.Hold, Touch, GripType and Verdict.
    """

    scene: str | None = None
    """TOML file of a scene, or the name of a ready one (`jaxgrasp scene list`): it has the hand, the object, the
    grip and its law, and the options for these have no effect."""
    engine: Literal["quasi-static", "mujoco"] | None = None
    """Engine that moves the objects of a scene with others beside the gripped one: our own, the default, or MuJoCo's
    (needs the extra `hands`)."""
    object: Literal["cylinder", "sphere", "capsule", "box"] = "cylinder"
    """Shape of the gripped object; in a power grip it lies across the palm."""
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
    contributions: Literal["table", "balanced"] = "table"
    """Contributions of the links: the paper's Table I, where it has them; or the nearest to it by which the squeezing
    forces balance, so that the closed form stays inside the friction cones."""
    depth: float = 2e-3
    """Depth to which the links press into the object [m]."""
    hand_length: float = 0.19
    """Length of the hand, from the wrist to the middle finger's tip [m]."""
    side: Literal["right", "left"] = "right"
    """Side of the hand."""
    lift: float = 0.2
    """Height by which the hand rises [m]."""
    turn: float = 90.0
    """Angle by which it then turns about its own length, by the right-hand rule about the wrist's x [degrees]."""
    release: bool = False
    """Open the hand at the end."""
    seconds: float = 4.0
    """Duration, a quarter each to hold, lift, turn, and hold or let go [s]; in a short time inertia weighs more."""
    step: float = 0.02
    """Time from one instant to the next [s]."""
    law: Literal["closed-form", "optimum"] = "optimum"
    """Law of the forces that decide whether the object slips; the paper's are the closed form, jaxgrasp.grip.simulate's
    default."""
    report: bool = True
    """Write grip.html, grip.png and grip_forces.png beside the results (needs the extra `report`)."""
    out: Path = Path("jaxgrasp-grip")
    """Folder for the results."""


@dataclass(frozen=True)
class CheckHand:
    """List the joints, links, shapes and meshes of a hand's file that are used, left out or missing (needs `hands`)."""

    action: tyro.conf.Positional[Literal["check"]]
    """Action to take."""
    file: tyro.conf.Positional[Path]
    """The hand's URDF or MJCF."""
    wrist: str | None = None
    """Body that is the wrist; where not given, the last one that all joints hang on."""


@dataclass(frozen=True)
class Check:
    """Check a scene: errors name the table and the key, before anything compiles."""

    scene: tyro.conf.Positional[str] = "cylinder"
    """TOML file of the scene, or the name of a ready one."""


@dataclass(frozen=True)
class ReadyScenes:
    """List the scenes that come with the package."""


@dataclass(frozen=True)
class SceneCommand:
    """Scenes in TOML files, for `jaxgrasp glove run` and `jaxgrasp grip --scene`."""

    command: tyro.conf.OmitSubcommandPrefixes[
        tyro.conf.OmitArgPrefixes[
            Annotated[Check, tyro.conf.subcommand("check")] | Annotated[ReadyScenes, tyro.conf.subcommand("list")]
        ]
    ]


@dataclass(frozen=True)
class FollowSensitivity:
    """Follow slip angles along a task, and their derivatives by every parameter; write curves, a ranking and a figure.

    sensitivity.csv has a row for each method, finger and instant: the slip angle [rad] and its derivatives.
    ranking.csv has the parameters by their influence on the worst over time: on each finger's largest slip angle by
    each method, and on the smallest reserve of friction, by which an optimum is ranked: its active contacts have no
    margin left.
    """

    task: str = "cylinder"
    """TOML file of a task, or the paper's (section II-G.3): five fingertips turn a cylinder of 10 N at pi rad/s, there
    and back."""
    methods: tuple[MethodName, ...] = ("A", "B", "B-optimum")
    """Methods by which forces are distributed."""
    by: tuple[str, ...] = ("contributions", "friction", "depths", "stiffness", "azimuths", "radius", "mass", "speed")
    """The parameters to differentiate by: whole arrays, or entries such as contributions[index]."""
    finger: str = "index"
    """Finger whose slip angle the figure shows."""
    vary: str = "contributions[index]"
    """The parameter that the figure varies."""
    values: tuple[float, ...] = (0.02, 0.1, 0.4)
    """Values of that parameter, one after another."""
    seconds: float = 4.0
    """Duration [s]."""
    step: float = 0.01
    """Time from one instant to the next [s]."""
    report: bool = True
    """Draw sensitivity.png beside the tables (needs the extra `report`)."""
    out: Path = Path("jaxgrasp-sensitivity")
    """Folder for the results."""


@dataclass(frozen=True)
class View:
    """Show a live hand, a scene or a file of grasps in a browser (needs the extra `view`)."""

    file: tyro.conf.Positional[str | None] = None
    """A file of grasps (.npz, .csv, .parquet, .h5), which is stepped through; a TOML file of a scene or the name of a
    ready one, in which time runs; a hand around a cylinder where not given."""
    grasp: str | None = None
    """Grasp of a file that is shown first: its name, or its number from 0; the best where not given."""
    law: Literal["closed-form", "optimum"] | None = None
    """Law of the forces that the hand applies; the scene's, or the optimum, where not given."""
    save: Path | None = None
    """Write the first state of the scene as a page that opens offline, and show nothing."""
    host: str = "127.0.0.1"
    """Address to listen at: others than this machine's own let others look, and move the sliders."""
    allowed_hosts: tuple[str, ...] = ()
    """Further names by which browsers reach this machine, beside localhost, addresses and `--host`; pages of other
    sites are refused."""
    port: int = 8080
    """Port to listen at; 0 for any free one."""
    normals: Literal["inward", "outward"] = "inward"
    """Direction of the normals of a file of grasps: into the object, or out of it."""
    normalize: bool = False
    """Scale every normal of a file of grasps to length 1; those of tables with few digits are not."""
    mesh: Path | None = None
    """The object of a file of grasps, in the frame of its contacts (needs the extra `mesh`)."""
    scale: float = 1.0
    """Metres for one unit of the mesh."""
    seconds: float | None = None
    """Duration; until interrupted where not given."""


OWN_SOLVERS = (
    *("jaxgrasp", "jaxgrasp-last-resort", "jaxgrasp-float32"),
    *("jaxgrasp-kernel", "jaxgrasp-kernel-last-resort", "jaxgrasp-kernel-float32"),
)
"""Names of this package's own solver."""


@dataclass(frozen=True)
class ListSuite:
    """List the kinds of problems, what makes each hard, and the solvers that are installed."""


@dataclass(frozen=True)
class ExportSuite:
    """Write the suite's problems for other programs."""

    format: Literal["cbf", "npz", "qps"] = "cbf"
    """cbf: a file of the Conic Benchmark Format for each problem, and index.csv with the answers. npz: one file with
    data and references. qps: quadratic programs with pyramids for cones, a .npz for each in qpbenchmark's layout."""
    out: Path = Path("grasp-suite")
    """Folder to write; the file grasp-suite.npz in it for npz."""
    kinds: tuple[str, ...] = ()
    """Kinds of problems; all where not given."""
    scaled: bool = False
    """Centre and scale the problems first, as solvers like them, instead of newtons and metres in the user's frame."""
    sides: int = 8
    """Sides of the pyramids of qps."""


@dataclass(frozen=True)
class RunSuite:
    """Solve the suite's problems by a solver, and score its answers against the references."""

    solver: str = "jaxgrasp"
    """jaxgrasp, or jaxgrasp-kernel for the compiled kernel, both also with -float32 or -last-resort behind; clarabel,
    ecos, scs, qoco, moreau, cvxopt, gurobi, mosek; or module:function, which takes a SuiteProblem and returns an Answer
    of jaxgrasp.testing.suite."""
    settings: Literal["default", "tight", "tightest"] = "default"
    """The solver's defaults; tight ones, with which most solvers still answer most problems; or the tightest, with
    which they say more often that they failed. jaxgrasp has no settings."""
    scaled: bool = True
    """Centre and scale the problems first; jaxgrasp and your own function get the data as they are."""
    kinds: tuple[str, ...] = ()
    """Kinds of problems; all where not given."""
    tolerance: float | None = None
    """Largest error of a right answer in balance, cones and objective; 100 times the solver's own tolerance, and at
    least 1e-6, where not given."""
    out: Path | None = None
    """CSV file to write, with a row for each problem."""


@dataclass(frozen=True)
class SuiteCommand:
    """Hard problems with references in extended precision, for people who write cone solvers."""

    command: tyro.conf.OmitSubcommandPrefixes[
        tyro.conf.OmitArgPrefixes[
            Annotated[ExportSuite, tyro.conf.subcommand("export")]
            | Annotated[ListSuite, tyro.conf.subcommand("list")]
            | Annotated[RunSuite, tyro.conf.subcommand("run")]
        ]
    ]
