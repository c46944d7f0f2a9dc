"""Teleoperation of a robot hand by a person in a force-feedback glove (the application that the paper announces).

A [`jaxgrasp.teleop.Follower`][] is the robot; ``Retargeting`` maps the person's fingertips to its joints,
``ForceFeedback`` its measured forces to the glove's torques, and ``PersonSide`` and ``RobotSide`` are the two ends of a
network that stays passive. ``run_trial`` plays a task with a simulated person.
"""

from jaxgrasp.teleop.cooperation import HandShare, Team, TeamStep
from jaxgrasp.teleop.feedback import ForceFeedback, shared_forces
from jaxgrasp.teleop.follower import Follower, FollowerContacts, FollowerState, NullFollower, PalmPose
from jaxgrasp.teleop.mujoco_hand import HandModel, MujocoFollower, robot_spec, shadow_hand
from jaxgrasp.teleop.network import NetworkModel, SimulatedLink
from jaxgrasp.teleop.operator import PersonModel, SimulatedPerson
from jaxgrasp.teleop.retarget import Calibration, Retargeting
from jaxgrasp.teleop.session import PersonMessage, PersonSide, RobotMessage, RobotSide
from jaxgrasp.teleop.tasks import Task, make_task
from jaxgrasp.teleop.trial import TrialResult, Workplace, run_trial

__all__ = [
    "Calibration",
    "Follower",
    "FollowerContacts",
    "FollowerState",
    "ForceFeedback",
    "HandModel",
    "HandShare",
    "MujocoFollower",
    "NetworkModel",
    "NullFollower",
    "PalmPose",
    "PersonMessage",
    "PersonModel",
    "PersonSide",
    "Retargeting",
    "RobotMessage",
    "RobotSide",
    "SimulatedLink",
    "SimulatedPerson",
    "Task",
    "Team",
    "TeamStep",
    "TrialResult",
    "Workplace",
    "make_task",
    "robot_spec",
    "run_trial",
    "shadow_hand",
    "shared_forces",
]


def __dir__() -> list[str]:
    return __all__
