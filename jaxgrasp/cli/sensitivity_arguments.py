"""Arguments of ``jaxgrasp sensitivity``."""

from dataclasses import dataclass
from pathlib import Path

from jaxgrasp.cli.evaluate_arguments import MethodName


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
