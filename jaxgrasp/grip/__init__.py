"""The grasp over time: whether it holds, and what the object does."""

from jaxgrasp.grip.carry import Instant, carry
from jaxgrasp.grip.monitor import Assessment, Hold, Touch, monitor
from jaxgrasp.grip.motion import Body
from jaxgrasp.grip.power_grip import power_grip
from jaxgrasp.grip.precision_grip import precision_grip
from jaxgrasp.grip.scene import Obstacle, Scene
from jaxgrasp.grip.tick import Tick, observe
from jaxgrasp.hand.balanced_contributions import balanced_contributions
from jaxgrasp.hand.grip_type import GripType, contributions_of, grip_type
from jaxgrasp.model.held import Held, HeldCylinder
from jaxgrasp.model.paths import Lift, Shake, Turn
from jaxgrasp.model.squeeze import CYLINDRICAL_POWER_GRIP, Contributions, squeezing
from jaxgrasp.model.task import Task, carrying

__all__ = [
    "Assessment",
    "Body",
    "CYLINDRICAL_POWER_GRIP",
    "Contributions",
    "GripType",
    "Held",
    "HeldCylinder",
    "Hold",
    "Instant",
    "Lift",
    "Obstacle",
    "Scene",
    "Shake",
    "Task",
    "Tick",
    "Touch",
    "Turn",
    "balanced_contributions",
    "carry",
    "carrying",
    "contributions_of",
    "grip_type",
    "monitor",
    "observe",
    "power_grip",
    "precision_grip",
    "squeezing",
]


def __dir__() -> list[str]:
    return __all__
