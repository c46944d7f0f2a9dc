"""Teleoperation of a robot hand by a person in a force-feedback glove (the application that the paper announces).

A [`jaxgrasp.teleop.Follower`][] is the robot; ``Retargeting`` maps the person's fingertips to its joints,
``ForceFeedback`` its measured forces to the glove's torques, and ``PersonSide`` and ``RobotSide`` are the two ends of a
network that stays passive. ``run_trial`` plays a task with a simulated person.
"""

from jaxgrasp.teleop.cooperation import Team, TeamShare, TeamStep
from jaxgrasp.teleop.feedback import ForceFeedback, shared_forces
from jaxgrasp.teleop.follower import Follower, FollowerContacts, FollowerState, NullFollower, PalmPose
from jaxgrasp.teleop.importance import JointRanking, rank_joints
from jaxgrasp.teleop.mujoco_hand import HandModel, MujocoFollower, allegro_hand, robot_spec, shadow_hand
from jaxgrasp.teleop.network import NetworkModel, SimulatedLink
from jaxgrasp.teleop.operator import PersonModel, SimulatedOperator
from jaxgrasp.teleop.probe import HeldProbe, Surface, load_heights
from jaxgrasp.teleop.retarget import Calibration, Retargeting
from jaxgrasp.teleop.session import PersonMessage, PersonSide, RobotMessage, RobotSide
from jaxgrasp.teleop.tasks import TeleopTask, make_task
from jaxgrasp.teleop.trial import TrialResult, Workplace, run_trial
from jaxgrasp.teleop.wrist import SimulatedWrist, WristDevice, wrist_wrench

__all__ = [
    "Calibration",
    "Follower",
    "FollowerContacts",
    "FollowerState",
    "ForceFeedback",
    "HandModel",
    "HeldProbe",
    "JointRanking",
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
    "SimulatedOperator",
    "SimulatedWrist",
    "Surface",
    "Team",
    "TeamShare",
    "TeamStep",
    "TeleopTask",
    "TrialResult",
    "Workplace",
    "WristDevice",
    "allegro_hand",
    "load_heights",
    "make_task",
    "rank_joints",
    "robot_spec",
    "run_trial",
    "shadow_hand",
    "shared_forces",
    "wrist_wrench",
]


def __dir__() -> list[str]:
    return __all__
