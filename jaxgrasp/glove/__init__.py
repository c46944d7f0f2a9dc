"""Force-feedback glove: joint torques to bytes and sensors back, in NumPy alone; nothing here imports JAX.

``GloveProcess`` drives a glove from a process of its own: write torque laws to it, read its state. ``GloveHost`` does
the same inside the calling process. ``Simulator`` is a simulated glove. ``protocol/firmware/PROTOCOL.md`` specifies
how to build a device.
"""

from jaxgrasp.glove.glove_device import Capability, GloveDevice, LinkState, Reading
from jaxgrasp.glove.guard import Guard, GuardOutput, GuardState, read_latches
from jaxgrasp.glove.host import GloveHost
from jaxgrasp.glove.line import Line, LineError, SerialLine
from jaxgrasp.glove.loop.exchange import GloveState, TorqueLaw
from jaxgrasp.glove.loop.glove_process import GloveProcess
from jaxgrasp.glove.model import FLEXIONS, CoupledJoint, GloveModel, load_glove, lrp_hand_master, lucidgloves
from jaxgrasp.glove.monitors import TensionControl, TensionWatch
from jaxgrasp.glove.network.link import NetworkLink
from jaxgrasp.glove.other_devices.doglove import DogloveHost, doglove, doglove_linkage
from jaxgrasp.glove.other_devices.lucidgloves import LucidHost
from jaxgrasp.glove.other_devices.opengloves import OpenGlovesHost
from jaxgrasp.glove.other_devices.openxr import OpenXRHost, WristTracker, openxr
from jaxgrasp.glove.other_devices.polhemus import Tracker
from jaxgrasp.glove.passivity import EnergyTank, MotionPort, TorquePort
from jaxgrasp.glove.protocol.device import Device, DeviceState
from jaxgrasp.glove.sensors import (
    Encoders,
    Gauges,
    Sensors,
    fit_encoders,
    fit_gauges,
    load_sensors,
    nominal_sensors,
    save_sensors,
)
from jaxgrasp.glove.simulated.simulation import VirtualGlove
from jaxgrasp.glove.simulated.simulator import Simulator, read_record
from jaxgrasp.glove.substitution import (
    FINGERS,
    Sensations,
    Substitution,
    SubstitutionLaw,
    finger_contacts,
    finger_saturation,
    slip_margins,
    torque_amplitudes,
)

__all__ = [
    "FINGERS",
    "FLEXIONS",
    "Capability",
    "CoupledJoint",
    "Device",
    "DeviceState",
    "DogloveHost",
    "Encoders",
    "EnergyTank",
    "Gauges",
    "GloveDevice",
    "GloveHost",
    "GloveModel",
    "GloveProcess",
    "GloveState",
    "Guard",
    "GuardOutput",
    "GuardState",
    "Line",
    "LineError",
    "LinkState",
    "LucidHost",
    "MotionPort",
    "NetworkLink",
    "OpenGlovesHost",
    "OpenXRHost",
    "Reading",
    "Sensations",
    "Sensors",
    "SerialLine",
    "Simulator",
    "Substitution",
    "SubstitutionLaw",
    "TensionControl",
    "TensionWatch",
    "TorqueLaw",
    "TorquePort",
    "Tracker",
    "VirtualGlove",
    "WristTracker",
    "doglove",
    "doglove_linkage",
    "finger_contacts",
    "finger_saturation",
    "fit_encoders",
    "fit_gauges",
    "load_glove",
    "load_sensors",
    "lrp_hand_master",
    "lucidgloves",
    "nominal_sensors",
    "openxr",
    "read_latches",
    "read_record",
    "save_sensors",
    "slip_margins",
    "torque_amplitudes",
]


def __dir__() -> list[str]:
    return __all__
