"""The virtual hand connected to the devices of a laboratory: rendering of contacts, and the haptic loop.

``grasp_and_lift`` plays a complete sequence on a simulated glove; ``Haptics`` and ``run_loop`` are the loop for any
glove; a ``GloveStimulus`` renders the stimuli of an experiment of ``jaxgrasp.psychophysics``.
"""

from jaxgrasp.lab.felt_objects import FeltObject, felt_object
from jaxgrasp.lab.glove_hand import GloveHand, glove_hand
from jaxgrasp.lab.grasp_and_lift import Story, cylinder_scene, grasp_and_lift
from jaxgrasp.lab.haptic_loop import Haptics, run_loop
from jaxgrasp.lab.stimuli import GloveStimulus, PredictedGloveStimulus, glove_error

__all__ = [
    "FeltObject",
    "GloveHand",
    "GloveStimulus",
    "Haptics",
    "PredictedGloveStimulus",
    "Story",
    "cylinder_scene",
    "felt_object",
    "glove_error",
    "glove_hand",
    "grasp_and_lift",
    "run_loop",
]


def __dir__() -> list[str]:
    return __all__
