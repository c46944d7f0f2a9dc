"""Runs a simulated glove as a process, and tells it what is to happen to it."""

import json
import os
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

PATIENCE = 10.0
"""How long a simulator may take to start or to answer [s]."""


class Simulator:
    """A simulated glove in a process of its own, behind ``port``; a context manager that ends it."""

    def __init__(self, **options: Any) -> None:
        """A glove that waits at its port.

        Args:
            options: ``port`` (a path; one in a fresh folder if left out), ``baud``, ``model`` and ``calibration``
                (files), ``friction`` (of the cables, yes or no), ``record`` (a file) and ``record_every`` [s],
                ``clock`` (where the device's begins [us]) and ``drift``.

        Raises:
            OSError: on a system without pseudo-terminals, or if it does not start.
        """
        if os.name != "posix":
            raise OSError("the simulated glove needs pseudo-terminals, which this system has not: Linux and macOS do")
        self._folder = tempfile.TemporaryDirectory(prefix="jaxgrasp-glove-")
        self.port = str(options.setdefault("port", str(Path(self._folder.name) / "glove")))
        self.events: list[dict[str, Any]] = []
        """What it said of itself: a torque that fell to zero, when and why."""
        self._said: list[dict[str, Any]] = []
        self._news = threading.Condition()
        command = [sys.executable, "-m", "jaxgrasp.glove.simulator_process", json.dumps(options)]
        self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        self._reader = threading.Thread(target=self._listen, daemon=True)
        self._reader.start()
        try:
            self._wait(lambda: len(self._said) > 0)
        except OSError:
            self.close()
            raise

    def order(self, **what: Any) -> dict[str, Any]:
        """Tell it something; its report right after.

        Args:
            what: ``bend`` (angles to go to [rad]) and ``lasts`` [s]; ``cut`` or ``unplug`` [s]; ``spoil`` (share of
                what passes) and ``seed``; ``stuck`` (encoders, yes or no); ``slack`` (a channel, or None); ``fault``
                (the device's own); ``report``.

        Raises:
            OSError: if it has ended, or does not answer.
        """
        assert self.process.stdin is not None
        before = len(self._said)
        self.process.stdin.write(json.dumps(what) + "\n")
        self.process.stdin.flush()
        self._wait(lambda: len(self._said) > before)
        return self._said[before]["report"]

    def zeros(self, since: float) -> list[dict[str, Any]]:
        """The times at which its torque fell to zero, from a moment on."""
        return [event for event in list(self.events) if event["at"] >= since]

    def close(self) -> None:
        """End it, and its port."""
        if self.process.stdin is not None and not self.process.stdin.closed:
            self.process.stdin.close()
        try:
            self.process.wait(PATIENCE)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
        self._reader.join()
        if self.process.stdout is not None:
            self.process.stdout.close()
        self._folder.cleanup()

    def __enter__(self) -> "Simulator":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _listen(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            said = json.loads(line)
            with self._news:
                (self.events if "event" in said else self._said).append(said)
                self._news.notify_all()

    def _wait(self, holds: Callable[[], bool]) -> None:
        end = time.monotonic() + PATIENCE
        with self._news:
            while not holds():
                self._news.wait(0.1)
                if self.process.poll() is not None and not self._reader.is_alive() and not holds():
                    raise OSError(f"the simulated glove ended with {self.process.returncode}")
                if time.monotonic() > end:
                    raise OSError(f"the simulated glove did not answer in {PATIENCE:.0f} s")


def read_record(path: Path, channels: int = 14) -> dict[str, np.ndarray]:
    """What a simulator wrote: ``time`` [s], ``state``, ``counts``, ``angles`` [rad] and ``tensions`` [N]."""
    raw = np.fromfile(path, np.float64)
    width = 2 + 14 + 2 * channels
    rows = raw[: len(raw) // width * width].reshape(-1, width)
    counts, angles, tensions = np.split(rows[:, 2:], [14, 14 + channels], axis=1)
    return {"time": rows[:, 0], "state": rows[:, 1], "counts": counts, "angles": angles, "tensions": tensions}
