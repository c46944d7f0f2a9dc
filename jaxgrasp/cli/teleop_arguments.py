"""Arguments of ``jaxgrasp teleop``."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from jaxgrasp.cli.glove_arguments import GloveArmed


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
