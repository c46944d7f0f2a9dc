"""Where the virtual hand and the devices of a laboratory meet: rendering what is touched, the haptic loop.

``grasp_and_lift`` tells a whole story on a simulated glove; ``Haptics`` and ``run_loop`` are the loop on any; a
``GloveStimulus`` renders what an experiment of ``jaxgrasp.psychophysics`` asks a person about.
"""

from jaxgrasp.lab.felt_objects import FeltObject, felt_object
from jaxgrasp.lab.glove_error import glove_error
from jaxgrasp.lab.glove_hand import GloveHand, glove_hand
from jaxgrasp.lab.grasp_and_lift import Story, cylinder_scene, grasp_and_lift
from jaxgrasp.lab.haptic_loop import Haptics, run_loop
from jaxgrasp.lab.stimuli import GloveStimulus, PredictedGloveStimulus

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
