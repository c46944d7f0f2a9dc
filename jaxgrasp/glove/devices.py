"""Registry of glove devices: built-in devices by name, and user classes by ``MODULE:CLASS``."""

from collections.abc import Callable, Mapping
from importlib import import_module
from pathlib import Path
from typing import Any

from jaxgrasp.glove.glove_device import GloveDevice
from jaxgrasp.glove.guard import Guard
from jaxgrasp.glove.host import GloveHost
from jaxgrasp.glove.line import Line, open_port
from jaxgrasp.glove.model import GloveModel, load_glove, lrp_hand_master, lucidgloves
from jaxgrasp.glove.other_devices.doglove import (
    BOARD_BAUD,
    LINKAGE_OPEN_ANGLE,
    OPEN_ANGLE,
    SERVO_BAUD,
    DogloveHost,
    doglove,
    doglove_linkage,
    doglove_sensors,
)
from jaxgrasp.glove.other_devices.lucidgloves import LucidHost
from jaxgrasp.glove.other_devices.opengloves import OpenGlovesHost
from jaxgrasp.glove.other_devices.openxr import OpenXRHost, openxr
from jaxgrasp.glove.sensors import Sensors, load_sensors, nominal_sensors

READY: dict[str, type[GloveDevice]] = {
    "native": GloveHost,
    "lucidgloves": LucidHost,
    "doglove": DogloveHost,
    "opengloves": OpenGlovesHost,
    "openxr": OpenXRHost,
}
NATIVE_BAUD = 115_200
BAUD_RATES = {"doglove": SERVO_BAUD}
"""Baud rates of the devices whose line has another than ``NATIVE_BAUD``."""
TWO_PORTS = ("doglove", "opengloves")
"""Devices that read joints from another port than the one to which forces go."""
MODELS = {"lucidgloves": lucidgloves, "doglove": doglove, "opengloves": lucidgloves, "openxr": openxr}
"""Models of the devices that have one of their own; those of the others are the paper's glove."""


def device_baud(options: Mapping[str, Any]) -> int:
    """Return the baud rate of the options, or that of the device that they name."""
    baud = options.get("baud")
    return BAUD_RATES.get(options.get("device", "native"), NATIVE_BAUD) if baud is None else baud


def check_joints_from(device: str, port: str | None) -> None:
    """Check that a port from which joints are read is given exactly for the devices that need one.

    Raises:
        ValueError: if it is missing, or not used.
    """
    if (port is None) == (device in TWO_PORTS):
        raise ValueError(
            f"joints_from is {port} for the device {device}: expected a port for {' and '.join(TWO_PORTS)}, "
            "and none for others"
        )


def load_model(options: Mapping[str, Any]) -> tuple[GloveModel, Sensors]:
    """Load a glove model and its sensors from the files ``model`` and ``calibration`` of the options.

    Without ``model``, return the paper's glove, or the built-in model of ``device``, with ``linkage`` that of its
    linkage; without ``calibration``, return the nominal sensors.

    Raises:
        ValueError: for a file that holds neither.
        OSError: for a file that cannot be read.
    """
    device = options.get("device", "native")
    if options.get("linkage") and device != "doglove":
        raise ValueError(f"linkage is for the device doglove: expected none for the device {device}")
    built_in = doglove_linkage if options.get("linkage") else MODELS.get(device, lrp_hand_master)
    model = load_glove(Path(options["model"])) if options.get("model") else built_in()
    path = options.get("calibration")
    if path:
        return model, load_sensors(Path(path), len(model.joints))
    return model, doglove_sensors(model) if device == "doglove" else nominal_sensors(model)


def find_device_class(name: str) -> type[GloveDevice]:
    """Return the class of a device, from the name of a built-in device or from ``MODULE:CLASS``.

    Raises:
        ValueError: for a name that is none of the ready ones, and a class that is not there or is no GloveDevice.
    """
    if name in READY:
        return READY[name]
    module, colon, class_name = name.partition(":")
    expected = f"expected {', '.join(READY)}, or MODULE:CLASS of your own"
    if not colon:
        raise ValueError(f"device is {name!r}: {expected}")
    try:
        device_class = getattr(import_module(module), class_name)
    except (ImportError, AttributeError, ValueError) as error:
        raise ValueError(f"device is {name!r}: {error}") from None
    if not (isinstance(device_class, type) and issubclass(device_class, GloveDevice)):
        raise ValueError(f"device is {name!r}, which is not a GloveDevice: {expected}")
    return device_class


def make_device(
    options: Mapping[str, Any], model: GloveModel, sensors: Sensors, open_line: Callable[[], Line], guard: Guard
) -> GloveDevice:
    """Create the device that the option ``device`` names; the default is the native device.

    A class of your own is called with model, ``open_line`` and guard.

    Raises:
        ValueError: for a device that is not there, and what it says of a model or options that it cannot use.
        ImportError: for a device that needs an extra which is not installed.
    """
    name, joints_from = options.get("device", "native"), options.get("joints_from")
    device_class = find_device_class(name)
    check_joints_from(name, joints_from)
    open_joints = lambda: open_port(joints_from or "", BOARD_BAUD)  # noqa: E731
    if device_class is GloveHost:
        return GloveHost(model, sensors, open_line, guard, baud=device_baud(options))
    if device_class is DogloveHost:
        open_angle = LINKAGE_OPEN_ANGLE if options.get("linkage") else OPEN_ANGLE
        return DogloveHost(model, sensors, open_line, open_joints, guard, open_angle=open_angle)
    if device_class is OpenGlovesHost:
        return OpenGlovesHost(model, open_line, open_joints, guard, hand=options.get("hand", "right"))
    if device_class is OpenXRHost:
        return OpenXRHost(model, open_line, guard, hand=options.get("hand", "right"))
    if device_class is LucidHost:
        return LucidHost(model, open_line, guard, full_scale=options.get("full_scale", 4095))
    constructor: Callable[[GloveModel, Callable[[], Line], Guard], GloveDevice] = device_class
    return constructor(model, open_line, guard)
