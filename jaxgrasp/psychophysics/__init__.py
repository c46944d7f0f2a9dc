"""Experiments on what a person feels: plans, runs and analysis, in NumPy and SciPy; nothing here imports JAX.

``Plan`` says which stimuli and which procedure, ``run_experiment`` asks a person and loses no answer, ``analyse`` finds
thresholds with what they leave open. ``Stimulus`` is what renders an intensity; ``jaxgrasp.lab`` implements it.
"""

from jaxgrasp.psychophysics.analysis.anova import (
    one_way,
    one_way_of_summaries,
    repeated_measures,
    rounding_interval,
)
from jaxgrasp.psychophysics.analysis.cell import AnalysisSettings, Weber, WeberLine, weber, weber_line
from jaxgrasp.psychophysics.analysis.counts import Counts, DetectionSensitivity, count, detection_sensitivity, pooled
from jaxgrasp.psychophysics.analysis.experiment import Analysis, Answers, WithinComparison, analyse, load_experiment
from jaxgrasp.psychophysics.analysis.finding import Finding
from jaxgrasp.psychophysics.analysis.likelihood import Model
from jaxgrasp.psychophysics.analysis.threshold import Goodness, Threshold, goodness, threshold
from jaxgrasp.psychophysics.analysis.tidy import tidy_tables
from jaxgrasp.psychophysics.person import Person, SimulatedPerson
from jaxgrasp.psychophysics.plan import Plan, SessionPlan, StimulusPlan, StudyPlan, WithinPlan, load_plan
from jaxgrasp.psychophysics.prediction import (
    Precision,
    RenderingError,
    cheapest,
    jnd_through,
    persons_for_power,
    precision,
    within_power,
)
from jaxgrasp.psychophysics.procedures import Adaptive, ConstantStimuli, Matching, Staircase
from jaxgrasp.psychophysics.psychometric import Observer, PsychometricShape, hit_probability
from jaxgrasp.psychophysics.recomputed import recomputed
from jaxgrasp.psychophysics.schedule import balanced_latin_square
from jaxgrasp.psychophysics.session import NoConsentError, run_experiment
from jaxgrasp.psychophysics.trial import IdealStimulus, NotFeltError, Rendered, Stimulus, StimulusLostError

__all__ = [
    "Adaptive",
    "Analysis",
    "AnalysisSettings",
    "Answers",
    "ConstantStimuli",
    "Counts",
    "DetectionSensitivity",
    "Finding",
    "Goodness",
    "IdealStimulus",
    "Matching",
    "Model",
    "NoConsentError",
    "NotFeltError",
    "Observer",
    "Person",
    "Plan",
    "Precision",
    "PsychometricShape",
    "Rendered",
    "RenderingError",
    "SessionPlan",
    "SimulatedPerson",
    "Staircase",
    "Stimulus",
    "StimulusLostError",
    "StimulusPlan",
    "StudyPlan",
    "Threshold",
    "Weber",
    "WeberLine",
    "WithinComparison",
    "WithinPlan",
    "analyse",
    "balanced_latin_square",
    "cheapest",
    "count",
    "detection_sensitivity",
    "goodness",
    "hit_probability",
    "jnd_through",
    "load_experiment",
    "load_plan",
    "one_way",
    "one_way_of_summaries",
    "persons_for_power",
    "pooled",
    "precision",
    "recomputed",
    "repeated_measures",
    "rounding_interval",
    "run_experiment",
    "threshold",
    "tidy_tables",
    "weber",
    "weber_line",
    "within_power",
]


def __dir__() -> list[str]:
    return __all__
