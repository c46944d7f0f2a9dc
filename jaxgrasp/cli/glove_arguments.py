"""The commands of ``jaxgrasp glove`` and ``jaxgrasp teleop``, and their arguments."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro


@dataclass(frozen=True)
class GloveFiles:
    """Files and baud rate of a glove."""

    model: Path | None = None
    """A TOML file of the glove; the paper's LRP Hand Master where not given."""
    calibration: Path | None = None
    """Calibration file of `jaxgrasp glove calibrate`; the nominal calibration where not given."""
    baud: int | None = None
    """Baud rate of the glove's serial line; the device's own where not given: 115200, and 3000000 for the servos of
    `doglove`."""


@dataclass(frozen=True)
class GloveDriven(GloveFiles):
    """Files, baud rate and protocol of a glove."""

    device: str = "native"
    """Protocol of the glove: `native`; `lucidgloves`, that of LucidGloves and of OpenGloves' firmware; `doglove`;
    `opengloves`, the driver's force-feedback pipe on Windows; `openxr`, hand tracking without forces, from
    udp:HOST:PORT or a pipe; or MODULE:CLASS, a `jaxgrasp.glove.GloveDevice` of your own. The built-in devices but the
    first have models of their own."""
    joints_from: str | None = None
    """Port from which joints are read, of devices that read them from another than the one to which forces go: the
    main board of a `doglove`, and udp:HOST:PORT for the hand-tracking records of `opengloves`."""
    hand: Literal["right", "left"] = "right"
    """Hand whose records count, of `openxr` and `opengloves`."""
    linkage: bool = False
    """Read the 21 joints of the linkage of a `doglove`, for a hand that is this linkage and touches by its caps, in
    place of 19 joints of a human hand: exact for a person of any size."""
    full_scale: int = 4095
    """Largest number that a LucidGloves sends: 4095 with an ESP32, 1023 with an AVR."""


@dataclass(frozen=True)
class GloveArmed(GloveDriven):
    """Files, baud rate and protocol of a glove, and the log of each time that it let go."""

    log: Path | None = None
    """File to which a line of JSON is added each time that the glove lets go: cause, time, last frames."""


@dataclass(frozen=True)
class Simulate(GloveFiles):
    """Run a simulated glove behind a pseudo-terminal as slow as a serial line, until interrupted (Linux, macOS)."""

    port: Path = Path("jaxgrasp-glove")
    """Name of its port, which becomes a link to the pseudo-terminal."""
    friction: bool = False
    """Let the cables stick and slip."""
    spoil: float = 0.0
    """Share of the transmitted pieces of data that get a fault."""
    bend: float = 0.0
    """Amplitude of the simulated person's flexion of all joints, from zero and back in four seconds [degrees]."""
    seconds: float | None = None
    """Duration; until interrupted where not given."""


@dataclass(frozen=True)
class Monitor(GloveDriven):
    """Show a glove's sensor readings ten times a second; the glove is never armed."""

    publish: str | None = None
    """Named pipe to which the joints go too, in the format of OpenGloves' input pipe, so that SteamVR sees the glove;
    `right` or `left` for the driver's own."""

    port: str = "jaxgrasp-glove"
    """Serial port of the glove."""
    seconds: float | None = None
    """Duration; until interrupted where not given."""


@dataclass(frozen=True)
class Test(GloveArmed):
    """Test a glove at the bench: read each sensor at rest and while the person bends each joint, and say what is wrong.

    With `--pull` it then arms the glove, which its person confirms, and lets each motor pull for a moment, by a
    twentieth of its torque.
    """

    port: str = "jaxgrasp-glove"
    """Serial port of the glove."""
    pull: bool = False
    """Let each motor pull in turn, at a twentieth of its limit."""
    seconds: float = 10.0
    """Time in which the person bends all joints."""
    out: Path | None = None
    """Calibration file to write, in which the flat hand that rested is at zero, with `--linkage` the straight linkage;
    the slopes stay."""


@dataclass(frozen=True)
class Run(GloveArmed):
    """Let a hand in a glove feel an object that it grasps and lifts.

    Without a port, all of it happens in virtual time, on a simulated glove whose cable is cut: glove.csv and glove.png
    show it. With one, it happens now; orders are typed: `arm` (at 5 % of the torque), `full` (all of it), `disarm`,
    `stop` (emergency stop, here and in the glove), `quit`. A device without a watchdog, as LucidGloves, is armed by a
    sentence that it asks for.
    """

    scene: tyro.conf.Positional[str] = "cylinder"
    """TOML file of the scene, or the name of a ready one (`jaxgrasp scene list`)."""
    port: str | None = None
    """Serial port of the glove."""
    seconds: float | None = None
    """Duration with a port; until `quit` where not given."""
    rate: float = 100.0
    """Frequency at which contacts and forces are computed [Hz], at least 50; the line is answered 200 to 500 times a
    second in between, by its baud rate."""
    control: bool = False
    """Control torques by the measured tensions."""
    projection: Literal["clip", "scale"] = "clip"
    """Clip each torque at its limit, or scale all together and keep their direction."""
    law: Literal["closed-form", "optimum"] | None = None
    """Law of the forces that the hand applies: they are felt, and decide whether the object slips. The scene's where
    not given."""
    substitution: bool = False
    """Let each finger vibrate by its slip margin, at contact, and where a torque is cut, by the contacts of the virtual
    hand; of a `doglove` and of gloves of our own protocol, with a port or `--connect`."""
    warmest: float = 34.0
    """With `--substitution`, target temperature under the firmest grip [deg C], 34 to 42; 34 for no heat."""
    follow_grip: bool = False
    """Recognise the grip while it is made, and let the links contribute what it asks for."""
    tracker: str | None = None
    """Port of a tracker that moves the wrist."""
    alignment: Path | None = None
    """Alignment file of `jaxgrasp glove align`; without one the tracker's axes are the world's, and its first sample
    is the hand at home."""
    tracker_protocol: Literal["isotrak-binary", "fastrak-ascii", "fastrak-binary", "openxr"] = "isotrak-binary"
    """Protocol of the tracker; `openxr` takes the wrist's pose from hand-tracking records, from a port of their own:
    udp:HOST:PORT."""
    tracker_baud: int = 115_200
    """Baud rate of the tracker's serial line."""
    listen: str | None = None
    """Be the glove's host for an engine elsewhere: HOST:PORT to be called at (UDP)."""
    connect: str | None = None
    """Be the engine for a glove elsewhere: its host's HOST:PORT."""
    key_file: Path | None = None
    """File of the key that host and engine share, 32 to 128 hexadecimal digits, readable by its owner alone; the
    environment's JAXGRASP_GLOVE_KEY where not given. Without a key anyone on the network can speak."""
    out: Path = Path("jaxgrasp-glove-run")
    """Folder for the results, without a port."""
    view: bool = False
    """Show hand, object and forces in a browser, from a process beside the loop (needs the extra `view`)."""
    view_port: int = 8080
    """Port of that page."""
    host: str = "127.0.0.1"
    """Address at which that page listens: this machine alone where not given. For another machine of the laboratory
    give an address of this one, or 0.0.0.0 for all; the page's address then holds a token, without which none opens."""


@dataclass(frozen=True)
class Calibrate:
    """Fit encoders and strain gauges to recorded pairs by least squares; write the calibration, and a plot of it."""

    pairs: tyro.conf.Positional[Path]
    """CSV with the columns sensor (encoder or gauge), channel (its joint), counts, and value [rad or N]."""
    device: str = "native"
    """Device whose model and nominal calibration are the start, as for `jaxgrasp glove run`."""
    model: Path | None = None
    """A TOML file of the glove; the paper's LRP Hand Master where not given."""
    out: Path = Path("calibration.json")
    """The calibration."""
    plot: bool = True
    """Draw the calibration beside it, as PNG (needs the extra `report`)."""


@dataclass(frozen=True)
class Align:
    """Measure the alignment of a tracker: hold the hand at home, move it forward, move it up, then turn it in place;
    write the alignment."""

    tracker: tyro.conf.Positional[str]
    """Port of the Polhemus tracker."""
    tracker_protocol: Literal["isotrak-binary", "fastrak-ascii", "fastrak-binary"] = "isotrak-binary"
    """Its protocol."""
    tracker_baud: int = 115_200
    """Baud rate of its serial line."""
    turn: bool = True
    """Measure the lever arm from the wrist's centre to the receiver, by turning the hand in place; without it a hand
    that turns in place seems to move."""
    out: Path = Path("alignment.json")
    """The alignment, for `jaxgrasp glove run --alignment`."""


@dataclass(frozen=True)
class Ablate:
    """Compare the glove's joints for a scene: the loss where one of them is neither read nor resisted.

    With `--trials`, over whole trials of the teleoperated tasks instead of one posture: the part of what is felt that
    each joint renders, and whether the order is the same from trial to trial (extra `hands`).
    """

    scene: tyro.conf.Positional[str] = "cylinder"
    """TOML file of the scene, or the name of a ready one (`jaxgrasp scene list`)."""
    trials: int | None = None
    """Number of trials of a simulated person, 3 or more: half of each task, each with another grip."""
    model: Path | None = None
    """A TOML file of the glove; the paper's LRP Hand Master where not given."""
    out: Path | None = None
    """CSV file for the same table."""


@dataclass(frozen=True)
class Ports:
    """List the serial ports of this machine."""


@dataclass(frozen=True)
class Glove:
    """Drive a force-feedback glove, or a simulated one."""

    command: tyro.conf.OmitSubcommandPrefixes[
        tyro.conf.OmitArgPrefixes[
            Annotated[Simulate, tyro.conf.subcommand("simulate")]
            | Annotated[Monitor, tyro.conf.subcommand("monitor")]
            | Annotated[Test, tyro.conf.subcommand("test")]
            | Annotated[Run, tyro.conf.subcommand("run")]
            | Annotated[Calibrate, tyro.conf.subcommand("calibrate")]
            | Annotated[Align, tyro.conf.subcommand("align")]
            | Annotated[Ablate, tyro.conf.subcommand("ablate")]
            | Annotated[Ports, tyro.conf.subcommand("ports")]
        ]
    ]


@dataclass(frozen=True)
class Teleop(GloveArmed):
    """Teleoperate a robot hand in MuJoCo, with forces back, over a network that may be late (extra `hands`).

    With the simulated operator a task is done by a simulated person, in virtual time or, with `--view`, as you watch.
    With `--glove` you do it; orders are typed: `arm` (at 5 % of the torque), `full`, `disarm`, `stop`, `quit`.
    """

    scene: Literal["peg", "stack"] = "peg"
    """Task: a plug into a socket, or a block onto another."""
    operator: Literal["simulated"] = "simulated"
    """Person where no glove is given."""
    glove: str | None = None
    """Serial port of a glove; `jaxgrasp glove simulate` makes a simulated one."""
    seed: int = 0
    """Seed of the simulated person's and the network's noise; trials count on from it."""
    trials: int = 1
    """Number of trials of the simulated person."""
    delay: float = 0.0
    """One-way delay of the network [ms]."""
    jitter: float = 0.0
    """Largest random delay that is added to it [ms]."""
    loss: float = 0.0
    """Share of messages that are lost, from 0 to below 1."""
    feedback: bool = True
    """Give the measured forces back to the person."""
    wrist: bool = False
    """Exert the contacts' force on the wrist of the simulated person too, by a simulated arm master."""
    substitution: bool = False
    """Let each finger vibrate by its slip margin, at contact, and where a torque is cut; with `--no-feedback` in place
    of forces. It is computed at the robot's side, and `--view` shows it."""
    warmest: float = 34.0
    """With `--substitution`, target temperature under the firmest grip [deg C], 34 to 42; 34 for no heat."""
    rate: float = 250.0
    """Frequency of the messages with a glove [Hz], at least 50."""
    seconds: float | None = None
    """Duration with a glove; until `quit` where not given."""
    serve: str | None = None
    """Be the robot's side for a glove elsewhere: HOST:PORT to be called at (UDP)."""
    robot: str | None = None
    """Be the person's side of a robot elsewhere: its HOST:PORT."""
    key_file: Path | None = None
    """File of the key that both sides share, as for `jaxgrasp glove run`."""
    tracker: str | None = None
    """Port of a Polhemus tracker that moves the wrist; it stays where it is without one."""
    tracker_protocol: Literal["isotrak-binary", "fastrak-ascii", "fastrak-binary"] = "isotrak-binary"
    """Protocol of the tracker."""
    tracker_baud: int = 115_200
    """Baud rate of the tracker's serial line."""
    out: Path | None = None
    """CSV file for the trials of the simulated person."""
    view: bool = False
    """Show the robot's world in a browser (needs the extra `view`)."""
    view_port: int = 8080
    """Port of that page."""
