"""The force-feedback glove: joint torques to bytes and sensors back, in NumPy alone; nothing here imports JAX.

``GloveProcess`` drives a glove from a process of its own: give it laws of torque, read its state. ``GloveHost`` is the
same in yours. ``Simulator`` is a glove for those who have none. ``firmware/PROTOCOL.md`` is what to build a device by.
"""

from jaxgrasp.glove.calibrate import fit_encoders, fit_gauges, load_sensors, save_sensors
from jaxgrasp.glove.device import Device, DeviceState
from jaxgrasp.glove.exchange import GloveState, TorqueLaw
from jaxgrasp.glove.glove_process import GloveProcess
from jaxgrasp.glove.guard import Guard, GuardState, Output
from jaxgrasp.glove.host import GloveHost, LinkState, Reading
from jaxgrasp.glove.line import Line, LineError, SerialLine
from jaxgrasp.glove.link import Link
from jaxgrasp.glove.lucidgloves import LucidHost, lucidgloves
from jaxgrasp.glove.model import FLEXIONS, GloveModel, load_glove, lrp_hand_master
from jaxgrasp.glove.sensors import Encoders, Gauges, Sensors, nominal_sensors
from jaxgrasp.glove.simulator import Simulator, read_record
from jaxgrasp.glove.tension import TensionControl, TensionWatch
from jaxgrasp.glove.tracker import Tracker
from jaxgrasp.glove.virtual_glove import VirtualGlove

__all__ = [
    "FLEXIONS",
    "Device",
    "DeviceState",
    "Encoders",
    "Gauges",
    "GloveHost",
    "GloveModel",
    "GloveProcess",
    "GloveState",
    "Guard",
    "GuardState",
    "Line",
    "LineError",
    "Link",
    "LinkState",
    "LucidHost",
    "Output",
    "Reading",
    "Sensors",
    "SerialLine",
    "Simulator",
    "TensionControl",
    "TensionWatch",
    "TorqueLaw",
    "Tracker",
    "VirtualGlove",
    "fit_encoders",
    "fit_gauges",
    "load_glove",
    "load_sensors",
    "lrp_hand_master",
    "lucidgloves",
    "nominal_sensors",
    "read_record",
    "save_sensors",
]
