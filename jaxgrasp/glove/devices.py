"""Registry of glove devices: built-in devices by name, and user classes by ``MODULE:CLASS``."""

from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any

from jaxgrasp.glove.glove_device import GloveDevice
from jaxgrasp.glove.guard import Guard
from jaxgrasp.glove.host import GloveHost
from jaxgrasp.glove.line import Line
from jaxgrasp.glove.model import GloveModel
from jaxgrasp.glove.other_devices.lucidgloves import LucidHost
from jaxgrasp.glove.sensors import Sensors

READY: dict[str, type[GloveDevice]] = {"native": GloveHost, "lucidgloves": LucidHost}


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
    """
    device_class = find_device_class(options.get("device", "native"))
    if device_class is GloveHost:
        return GloveHost(model, sensors, open_line, guard, baud=options.get("baud", 115_200))
    if device_class is LucidHost:
        return LucidHost(model, open_line, guard, full_scale=options.get("full_scale", 4095))
    constructor: Callable[[GloveModel, Callable[[], Line], Guard], GloveDevice] = device_class
    return constructor(model, open_line, guard)
