"""Handle of a simulated glove in a process of its own, which takes orders and faults."""

import os
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from jaxgrasp.glove.loop.child import WorkerProcess
from jaxgrasp.validation.checked import checked


class Simulator:
    """Simulated glove in a process of its own, behind ``port``; a context manager that ends it."""

    def __init__(self, **options: Any) -> None:
        """Start a simulated glove that waits at its port.

        Args:
            options: ``port`` (a path; one in a fresh folder if left out), ``baud``, ``model`` and ``calibration``
                (files), ``friction`` (of the cables, yes or no), ``record`` (a file) and ``record_every`` [s],
                ``clock`` (where the device's begins [us]), ``drift``, and ``wander`` (speed of the person's joints at
                rest [rad/s]; 0 for a hand that stands perfectly still, from which the host takes torque after a while).

        Raises:
            OSError: on a system without pseudo-terminals, or if it does not start.
        """
        if os.name != "posix":
            raise OSError("the simulated glove needs pseudo-terminals, which this system lacks: use Linux or macOS")
        self._folder = tempfile.TemporaryDirectory(prefix="jaxgrasp-glove-")
        self.port = str(options.setdefault("port", str(Path(self._folder.name) / "glove")))
        self._child = WorkerProcess("jaxgrasp.glove.simulated.simulator_process", options)
        self.process = self._child.process
        try:
            self._child.wait_for(lambda message: "port" in message)
        except OSError:
            self.close()
            raise

    def order(self, **fields: Any) -> dict[str, Any]:
        """Send an order to the simulator; return its report right after.

        Args:
            fields: ``bend`` (angles to go to [rad]) and ``lasts`` [s]; ``cut`` or ``unplug`` [s]; ``spoil`` (share of
                what passes) and ``seed``; ``stuck`` (encoders, yes or no); ``frozen`` (a channel's encoder, or None);
                ``slack`` (a channel, or None); ``fault`` (the device's own); ``press`` (its emergency stop, yes or no);
                ``report``.

        Raises:
            OSError: if it has ended, or does not answer.
        """
        before = self._child.count
        self._child.order(fields)
        return self._child.wait_for(lambda message: "done" in message, before)["report"]

    def zeros(self, since: float) -> list[dict[str, Any]]:
        """Return the events at which the torque fell to zero since a time [s], each with its cause."""
        return [
            message
            for message in list(self._child.messages)
            if message.get("event") == "zero" and message["at"] >= since
        ]

    def vibrations(self) -> list[dict[str, Any]]:
        """Return the events at which a vibration began, each with its time ``at`` [s] and ``amplitudes`` [1/1000]."""
        return [message for message in list(self._child.messages) if message.get("event") == "vibration"]

    def close(self) -> None:
        """End the simulator and remove its port."""
        self._child.close()
        self._folder.cleanup()

    def __enter__(self) -> "Simulator":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


@checked
def read_record(path: str | os.PathLike, channels: int = 14) -> dict[str, np.ndarray]:
    """Read a simulator's record: ``time`` [s], ``state``, ``counts``, ``angles`` [rad] and ``tensions`` [N]."""
    raw = np.fromfile(path, np.float64)
    width = 2 + 14 + 2 * channels
    rows = raw[: len(raw) // width * width].reshape(-1, width)
    counts, angles, tensions = np.split(rows[:, 2:], [14, 14 + channels], axis=1)
    return {"time": rows[:, 0], "state": rows[:, 1], "counts": counts, "angles": angles, "tensions": tensions}
