"""What a glove does to a stimulus that it renders, in the stimulus' own unit."""

import numpy as np

from jaxgrasp.glove.model import GloveModel
from jaxgrasp.glove.sensors import nominal_sensors
from jaxgrasp.glove.simulated.cable import Cable
from jaxgrasp.lab.felt_objects import FeltObject, resistances
from jaxgrasp.psychophysics.prediction.rendering_error import RenderingError
from jaxgrasp.validation.checked import checked


@checked
def glove_error(
    felt: FeltObject,
    model: GloveModel,
    *,
    cable: Cable | None = None,
    pretension: float = 0.0,
    lag: float = 0.0,
    motions: float = 7.0,
) -> RenderingError:
    """Errors of a glove for a stimulus, at the joint that bears most of it.

    Args:
        felt: the stimulus.
        model: of the glove: its limits and its quantum.
        cable: whose friction in motion counts; none if None.
        pretension: of the cables [N], that keeps them taut.
        lag: delay by the stimulus' own relative rate of change.
        motions: over which a person averages what depends on the direction.

    Raises:
        ValueError: for a pretension that is negative, and whatever RenderingError refuses.
    """
    if not (np.isfinite(pretension) and pretension >= 0):
        raise ValueError(f"pretension is {pretension}: expected a finite number, 0 or more")
    of_one = np.asarray(resistances(felt, felt.postures(), 1.0))
    posture, channel = np.unravel_index(np.argmax(of_one / np.array(model.limits)), of_one.shape)
    torque = float(of_one[posture, channel])
    wound = 0.0 if cable is None else cable.sliding * cable.wrap
    arm = float(nominal_sensors(model).gauges.arm[channel])
    return RenderingError(
        quantum=model.quantum / torque,
        friction=wound,
        pretension=pretension * arm / torque,
        lag=lag,
        limit=model.limits[channel] / torque,
        motions=motions,
    )
