"""Handle of the computing side on the process that owns the glove's line."""

import tempfile
from pathlib import Path
from typing import Any

from jaxgrasp.glove.loop.child import WorkerProcess
from jaxgrasp.glove.loop.exchange import GloveState, TorqueLaw
from jaxgrasp.glove.loop.peers import make_slots


class GloveProcess:
    """A glove driven by a process of its own: laws in, states out, both the latest; a context manager that ends it."""

    def __init__(self, port: str, channels: int, **options: Any) -> None:
        """Start a process that opens a port and is not armed.

        Args:
            port: of the glove.
            channels: of its model.
            options: ``baud``, ``model`` and ``calibration`` (files), ``device`` (``native``, ``lucidgloves``,
                ``doglove``, ``opengloves``, ``openxr`` or ``MODULE:CLASS``) and its ``full_scale``, ``joints_from`` (a
                port) or ``hand``, ``rate`` [Hz], ``scale`` (of all torques, 0.05 if left out), ``ramp`` [s],
                ``projection``, ``control`` (of tension, yes or no), ``oldest`` [s], ``log`` (a file for why it
                latched, which ``read_latches`` reads);
                ``listen`` (host and port) for an engine elsewhere in place of ``write`` and ``state``, with
                ``transport`` and ``key_file`` (or the environment's ``JAXGRASP_GLOVE_KEY``).

        Raises:
            OSError: if it does not come to listen.
        """
        self._folder = tempfile.TemporaryDirectory(prefix="jaxgrasp-loop-")
        self._channels = channels
        self._law, self._state = make_slots(Path(self._folder.name), channels)
        options = {"port": port, **options}
        if "listen" not in options:
            options["slots"] = self._folder.name
        self.child = WorkerProcess("jaxgrasp.glove.loop.io_process", options)
        self.summary: dict[str, Any] = {}
        """Counters of the process, after it has ended."""
        if "listen" in options:
            try:
                self.child.wait_for(lambda message: "listens" in message)
            except OSError:
                self.close()
                raise

    def write(self, law: TorqueLaw) -> None:
        """Publish the torque law that the glove follows from now on."""
        self._law.write(law.vector())

    def state(self) -> GloveState | None:
        """Return the latest state of the glove; None before the first report."""
        vector = self._state.read()
        return None if vector is None else GloveState.of(vector, self._channels)

    def arm(self, accepted: str = "") -> None:
        """Let torques flow; ``state`` says when they do.

        Args:
            accepted: what the user said, of a device that needs its ``acceptance``.

        Raises:
            ValueError: if it refuses; the message says why.
            OSError: if it has ended.
        """
        self._order({"arm": accepted})

    def disarm(self) -> None:
        """Disarm the glove: no torque from the next command on."""
        self._order({"disarm": True})

    def stop(self) -> None:
        """Execute the emergency stop: no torque, and latched, in the process and in the device, in any state.

        Raises:
            OSError: if it has ended.
        """
        self._order({"stop": True})

    def rescale(self, scale: float) -> None:
        """Set the scale of all torques, while the glove is not armed.

        Raises:
            ValueError: if it refuses.
        """
        self._order({"scale": scale})

    def report(self) -> dict[str, Any]:
        """Return the device's present counters, as [`jaxgrasp.glove.GloveDevice`][] reports them.

        Raises:
            OSError: if the process has ended.
        """
        before = self.child.count
        self.child.order({"report": True})
        return self.child.wait_for(lambda message: "report" in message, before)["report"]

    def is_alive(self) -> bool:
        """Return True while the process runs."""
        return self.child.process.poll() is None

    def events(self) -> list[dict[str, Any]]:
        """Return the changes of link and guard, each with its time ``at``."""
        return [message["event"] | {"at": message["at"]} for message in list(self.child.messages) if "event" in message]

    def close(self) -> None:
        """End the process, which sends a zero first, and free its shared memory."""
        self.child.close()
        self.summary = next((message["summary"] for message in self.child.messages if "summary" in message), {})
        self._law.close()
        self._state.close()
        self._folder.cleanup()

    def __enter__(self) -> "GloveProcess":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _order(self, order: dict[str, Any]) -> None:
        before = self.child.count
        self.child.order(order)
        answer = self.child.wait_for(lambda message: "done" in message or "refused" in message, before)
        if "refused" in answer:
            raise ValueError(answer["refused"])
