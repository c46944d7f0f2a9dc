"""What a person feels: experiments planned, run and analysed, in NumPy and SciPy alone; nothing here imports JAX.

``Plan`` says which stimuli and which procedure, ``run_experiment`` asks a person and loses no answer, ``analyse`` finds
thresholds with what they leave open. ``Stimulus`` is what renders an intensity; ``jaxgrasp.lab`` implements it.
"""

from jaxgrasp.psychophysics.analysis.anova import (
    one_way,
    one_way_of_summaries,
    repeated_measures,
    rounding_interval,
)
from jaxgrasp.psychophysics.analysis.cell import AnalysisSettings
from jaxgrasp.psychophysics.analysis.counts import Counts, count, pooled
from jaxgrasp.psychophysics.analysis.experiment import Analysis, Answers, analyse, load_experiment
from jaxgrasp.psychophysics.analysis.finding import Finding
from jaxgrasp.psychophysics.analysis.goodness import Goodness, goodness
from jaxgrasp.psychophysics.analysis.likelihood import Model
from jaxgrasp.psychophysics.analysis.signal_detection import DetectionSensitivity, detection_sensitivity
from jaxgrasp.psychophysics.analysis.threshold import Threshold, threshold
from jaxgrasp.psychophysics.analysis.tidy import tidy_tables
from jaxgrasp.psychophysics.analysis.weber import Weber, WeberLine, weber, weber_line
from jaxgrasp.psychophysics.latin_square import balanced_latin_square
from jaxgrasp.psychophysics.observer import Observer
from jaxgrasp.psychophysics.plan import Plan, SessionPlan, StimulusPlan, load_plan
from jaxgrasp.psychophysics.prediction.power import Precision, cheapest, precision
from jaxgrasp.psychophysics.prediction.rendering_error import RenderingError, jnd_through
from jaxgrasp.psychophysics.procedures.adaptive import Adaptive
from jaxgrasp.psychophysics.procedures.constant_stimuli import ConstantStimuli
from jaxgrasp.psychophysics.procedures.matching import Matching
from jaxgrasp.psychophysics.procedures.staircase import Staircase
from jaxgrasp.psychophysics.psychometric import PsychometricShape, hit_probability
from jaxgrasp.psychophysics.recomputed import recomputed
from jaxgrasp.psychophysics.running.person import Person, SimulatedPerson
from jaxgrasp.psychophysics.running.session import NoConsentError, run_experiment
from jaxgrasp.psychophysics.stimulus import IdealStimulus, NotFeltError, Rendered, Stimulus, StimulusLostError
from jaxgrasp.psychophysics.study_plan import StudyPlan

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
]


def __dir__() -> list[str]:
    return __all__
