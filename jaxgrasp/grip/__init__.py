"""Grasps over time: whether a grasp holds, and how the object moves."""

from jaxgrasp.grip.monitor import Assessment, Hold, Touch, monitor
from jaxgrasp.grip.motion import Body
from jaxgrasp.grip.power_grip import power_grip
from jaxgrasp.grip.precision_grip import precision_grip
from jaxgrasp.grip.scene import Obstacle, Scene
from jaxgrasp.grip.simulation import Record, simulate
from jaxgrasp.grip.tick import StepResult, observe
from jaxgrasp.hand.to_grasp import GripType, balanced_contributions, contributions_of, grip_type
from jaxgrasp.model.squeeze import CYLINDRICAL_POWER_GRIP, Contributions, squeezing
from jaxgrasp.model.task import Held, HeldCylinder, Lift, Shake, Task, Turn, carrying

__all__ = [
    "CYLINDRICAL_POWER_GRIP",
    "Assessment",
    "Body",
    "Contributions",
    "GripType",
    "Held",
    "HeldCylinder",
    "Hold",
    "Lift",
    "Obstacle",
    "Record",
    "Scene",
    "Shake",
    "StepResult",
    "Task",
    "Touch",
    "Turn",
    "balanced_contributions",
    "carrying",
    "contributions_of",
    "grip_type",
    "monitor",
    "observe",
    "power_grip",
    "precision_grip",
    "simulate",
    "squeezing",
]


def __dir__() -> list[str]:
    return __all__
