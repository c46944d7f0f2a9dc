"""The commands of ``jaxgrasp experiment`` and their arguments."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro


@dataclass(frozen=True)
class ObserverArguments:
    """A simulated observer."""

    weber: float = 0.15
    """Weber fraction of large references."""
    absolute: float = 0.0
    """Difference that is just noticed where there is no reference, in the stimulus' unit."""
    lapse: float = 0.0
    """Share of trials answered wrong for want of attention."""
    bias: float = 0.0
    """Preference for the second interval, by the noise of the difference."""
    learning: float = 0.0
    """Extra noise in the first trial, relative to the noise; 63 % of it is gone after 50 trials."""


@dataclass(frozen=True)
class PlanCommand:
    """Check a plan: trials, torques, and which stimuli the glove cannot render. Without a file, the paper's plan."""

    file: tyro.conf.Positional[Path | None] = None
    """TOML file of the plan."""
    glove: Path | None = None
    """A TOML file of the glove; the paper's LRP Hand Master where not given."""
    within: str | None = None
    """Factor of which every person meets all conditions: `feedback` for none, force, vibration and both, or
    `feedback=force,vibration`; that of the plan where not given."""
    subjects: int = 12
    """Number of persons, of whom the power of the comparison of conditions is predicted."""
    effect: float = 0.25
    """Cohen's f of that comparison: 0.1 is small, 0.25 medium, 0.4 large."""
    correlation: float = 0.5
    """Correlation of a person's values in two conditions."""
    write: Path | None = None
    """Write the plan, with all its defaults, to this new file."""


@dataclass(frozen=True)
class RunExperiment:
    """Run all trials of a plan with one person; each answer is on disk before the next question."""

    file: tyro.conf.Positional[Path | None] = None
    """TOML file of the plan; the paper's where not given."""
    subject: str = ""
    """Code of the person, without a name in it."""
    out: Path = Path("jaxgrasp-experiment")
    """Folder of the records, a file for each person."""
    resume: bool = False
    """Go on where this person's records end."""
    port: str | None = None
    """Serial port of the glove in which stimuli are felt."""
    glove: Path | None = None
    """A TOML file of the glove; the paper's LRP Hand Master where not given."""
    calibration: Path | None = None
    """Calibration file of `jaxgrasp glove calibrate`; the nominal calibration where not given."""
    baud: int | None = None
    """Baud rate of the glove's serial line; the device's own where not given."""
    device: str = "native"
    """Protocol of the glove: `native`, `lucidgloves`, `doglove` or MODULE:CLASS, as for `jaxgrasp glove run`."""
    joints_from: str | None = None
    """Port from which joints are read where it is another than the glove's, as for `jaxgrasp glove run`."""
    full_scale: int = 4095
    """Largest number that a LucidGloves sends."""
    screen: str | None = None
    """Terminal of the person, as `jaxgrasp experiment screen` prints it there; this one where not given."""
    log: Path | None = None
    """File to which a line of JSON is added each time that the glove lets go: cause, time, last frames."""
    simulate: bool = False
    """Let a simulated observer answer, without a glove."""
    noise: str = ""
    """Factors on a simulated observer's noise by condition, such as `force=1,vibration=1.6`; 1 where not given."""
    view: bool = False
    """Show the scene in a browser: one page for the person, and one for the experimenter (needs the extra `view`)."""
    view_port: int = 8080
    """Port of the person's page; the experimenter's is the next."""
    host: str = "127.0.0.1"
    """Address at which both pages listen, as for `jaxgrasp glove run`: this machine alone where not given, else each
    page's address holds a token of its own."""
    observer: tyro.conf.OmitArgPrefixes[ObserverArguments] = ObserverArguments()


@dataclass(frozen=True)
class Screen:
    """Make this terminal the person's, and print its path for `run --screen` in another terminal."""


@dataclass(frozen=True)
class HowAnalysed:
    """From which records, and how."""

    folder: tyro.conf.Positional[Path]
    """Folder of the records."""
    method: Literal["likelihood", "posterior", "interpolation", "line", "paper"] = "likelihood"
    """Method to estimate thresholds; `paper`: the line through chance at zero that gives the paper's numbers."""
    shape: Literal["gaussian", "logistic", "weibull", "difference"] | None = None
    """Shape of the psychometric function, for `likelihood` and `posterior`; where not given, `weibull` for constant
    stimuli, `difference` for staircases, and the plan's own for the adaptive method."""
    criterion: float | None = None
    """Hit ratio at the threshold; 0.75 where neither this nor an adaptive plan says otherwise."""
    lapse: float | None = None
    """Largest share of lapses that a fit may find; where not given, 0.05, and 0.1 where levels follow the answers."""
    interval: Literal["profile", "credible", "bootstrap", "bca"] | None = None
    """Kind of interval of each threshold; the method's own where not given."""
    saturated: Literal["include", "exclude"] = "exclude"
    """Include or exclude trials in which a torque was cut."""


@dataclass(frozen=True)
class Analyse(HowAnalysed):
    """Analyse a folder of records: thresholds, Weber fractions and their differences, with a report."""

    out: Path | None = None
    """Folder for analysis.json and report.html; that of the records where not given."""
    report: bool = True
    """Write report.html (needs the extra `report`)."""


@dataclass(frozen=True)
class Export(HowAnalysed):
    """Write tidy tables for other programs: trials.csv, a row an answer; thresholds.csv; persons.csv; dictionary.csv.

    Units stand in the heads, what each column means in dictionary.csv; yes is 1, no is 0, and what is not known empty.
    """

    out: Path | None = None
    """Folder for the tables; `export` in that of the records where not given."""


@dataclass(frozen=True)
class Paper:
    """Recompute every number of the paper's section III-C beside the printed one."""


@dataclass(frozen=True)
class Power:
    """Find the numbers of trials and persons that a precision needs, by simulated experiments."""

    file: tyro.conf.Positional[Path | None] = None
    """TOML file of the plan, of constant stimuli; the paper's where not given."""
    reference: float | None = None
    """One of the plan's references; the first where not given."""
    wanted: float | None = None
    """Standard error of the mean threshold over persons: of the Weber fraction, 0.02 where not given; in detection, of
    the intensity."""
    between: float | None = None
    """Standard deviation of the persons' own thresholds; 0.035 where not given, of the paper's 0.035 to 0.052."""
    most_subjects: int = 100
    """Largest number of persons available."""
    observer: tyro.conf.OmitArgPrefixes[ObserverArguments] = ObserverArguments()


@dataclass(frozen=True)
class Experiment:
    """Design, run and analyse experiments on what a person feels."""

    command: tyro.conf.OmitSubcommandPrefixes[
        tyro.conf.OmitArgPrefixes[
            Annotated[PlanCommand, tyro.conf.subcommand("plan")]
            | Annotated[RunExperiment, tyro.conf.subcommand("run")]
            | Annotated[Screen, tyro.conf.subcommand("screen")]
            | Annotated[Analyse, tyro.conf.subcommand("analyse")]
            | Annotated[Export, tyro.conf.subcommand("export")]
            | Annotated[Paper, tyro.conf.subcommand("paper")]
            | Annotated[Power, tyro.conf.subcommand("power")]
        ]
    ]
