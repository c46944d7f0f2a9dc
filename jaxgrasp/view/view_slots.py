"""Data from a haptic loop to a page through a slot in shared memory: only the latest frame, without waiting.

Haptic loop's handle on the process that shows it: the process skips frames that it does not read in time.
"""

import math
import pickle
import secrets
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from jaxgrasp.glove.loop.child import WorkerProcess
from jaxgrasp.glove.loop.exchange import WORDS_SIZE, GloveState, Slot, TorqueLaw, pack_words, unpack_words
from jaxgrasp.hand.to_grasp import GripType
from jaxgrasp.lab.haptic_loop import Followed
from jaxgrasp.model.hand import Pose
from jaxgrasp.report.surfaces import pose_matrix
from jaxgrasp.view.viewer_server import HOST, check_free, is_loopback, page_address, quiet_viser

TRIAL = 9
"""Numbers of a [`TrialState`][]."""


class Carried(NamedTuple):
    """Poses and wrenches of hand and objects, as numbers."""

    wrist: Float[np.ndarray, "3 4"]
    followed: Followed

    @staticmethod
    def at(wrist: Pose, followed: Followed) -> "Carried":
        """Build the state of a hand from the wrist's pose and the followed objects."""
        return Carried(pose_matrix(wrist), followed)

    @staticmethod
    def size(n_bodies: int, links: int) -> int:
        """Return the length of the vector."""
        return 14 + 18 * n_bodies + links

    def vector(self) -> Float[np.ndarray, "size"]:
        """Pack all fields into a vector."""
        placed, wrenches, contributions, time, grip = self.followed
        head = [time, np.nan if grip is None else float(grip)]
        return np.concatenate([head, self.wrist.ravel(), pose_matrix(placed).ravel(), wrenches.ravel(), contributions])

    @staticmethod
    def of(vector: Float[np.ndarray, "size"], n_bodies: int) -> "Carried":
        """Unpack the state from a vector, with this number of objects."""
        head, wrist, placed, wrenches, contributions = np.split(vector, np.cumsum([2, 12, 12 * n_bodies, 6 * n_bodies]))
        poses = placed.reshape(n_bodies, 3, 4)
        grip = None if np.isnan(head[1]) else GripType(int(head[1]))
        poses_of_bodies = Pose(poses[..., 3], poses[..., :3])
        followed = Followed(poses_of_bodies, wrenches.reshape(n_bodies, 6), contributions, float(head[0]), grip)
        return Carried(wrist.reshape(3, 4), followed)


class TrialState(NamedTuple):
    """Current state of an experiment, as numbers: NaN for a missing value."""

    phase: float = 0.0
    """A [`Phase`][jaxgrasp.view.viewed_person.Phase]."""
    number: float = math.nan
    most: float = math.nan
    interval: float = math.nan
    first: float = math.nan
    second: float = math.nan
    setting: float = math.nan
    answered: float = 0.0
    """Number of choices since the program began."""
    right: float = 0.0
    """Number of right choices."""

    def vector(self) -> Float[np.ndarray, "9"]:
        """Pack all fields into a vector."""
        return np.array(self, float)

    @staticmethod
    def of(vector: Float[np.ndarray, "9"]) -> "TrialState":
        """Unpack the state of the trial from a vector."""
        return TrialState(*vector.tolist())


@dataclass(frozen=True, eq=False)
class ViewFrame:
    """State of the glove and torques in a tick of a haptic loop."""

    angles_at: float
    """Time at which the angles were read [s]."""
    link: int
    guard: int
    angles: Float[np.ndarray, "channels"]
    """Joint angles [rad]."""
    torques: Float[np.ndarray, "channels"]
    """Computed torques against flexion [N.m]."""
    measured: Float[np.ndarray, "channels"]
    """Torques measured by the cables' tension [N.m]."""
    extra: Float[np.ndarray, "more"]
    """Vector of a [`Carried`][] or a [`TrialState`][]."""
    given: Float[np.ndarray, "channels"] = None  # type: ignore[assignment]
    """Torques that the glove was told to exert, which the person feels [N.m]; NaN where they are not known."""
    cut_s: Float[np.ndarray, "channels"] = None  # type: ignore[assignment]
    """Time for which each torque was cut [s]; NaN where it is not known."""
    cause: str = ""
    """Reason why no torque flows."""
    ticked_at: float = math.nan
    """Time at which the engine computed the torques [s]."""

    def __post_init__(self) -> None:
        for name in ("given", "cut_s"):
            if getattr(self, name) is None:
                object.__setattr__(self, name, np.full(len(self.angles), np.nan))

    @staticmethod
    def size(channels: int, extra: int) -> int:
        """Return the length of the vector."""
        return 4 + 5 * channels + WORDS_SIZE + extra

    @staticmethod
    def ticked(state: GloveState, law: TorqueLaw, extra: Float[np.ndarray, "more"]) -> "ViewFrame":
        """Build the frame from the glove's state and the torques of a tick."""
        arrays = (law.angles, law.torques, state.measured, extra, state.torques, state.cut_s)
        return ViewFrame(state.angles_at, state.link, state.guard, *arrays, state.cause, law.computed_at)

    def vector(self) -> Float[np.ndarray, "size"]:
        """Pack all fields into a vector."""
        head = [self.angles_at, float(self.link), float(self.guard), self.ticked_at]
        arrays = (self.angles, self.torques, self.measured, self.given, self.cut_s)
        return np.concatenate([head, *arrays, pack_words(self.cause), self.extra])

    @staticmethod
    def of(vector: Float[np.ndarray, "size"], channels: int) -> "ViewFrame":
        """Unpack the frame from a vector, with this number of channels."""
        (at, link, guard, ticked_at), *arrays, rest = np.split(vector, 4 + channels * np.arange(6))
        angles, torques, measured, given, cut_s = arrays
        words, extra = np.split(rest, [WORDS_SIZE])
        shown = (angles, torques, measured, extra, given, cut_s, unpack_words(words), float(ticked_at))
        return ViewFrame(float(at), int(link), int(guard), *shown)


SLOT, SHOWN = "frames", "shown.pickle"
"""Files in the folder that both processes share, which is this user's alone."""
TOKEN_BYTES = 16
"""Random bytes of a token, which nobody guesses."""
COMPILES = 600.0
"""Longest time until the process listens [s]: minutes on a machine with an empty compilation cache."""


class ViewFeed:
    """Page in its own process; a context manager that ends it. If the process is killed, the loop goes on."""

    def __init__(
        self, channels: int, more: int, shown: dict[str, Any], ports: tuple[int, ...], host: str = HOST
    ) -> None:
        """Start the process of the page and wait until it listens.

        Args:
            channels: of the glove.
            more: numbers of each frame beside those of the channels.
            shown: what [`view_process`][jaxgrasp.view.view_process] shows, by its names.
            ports: of the page, or of the subject's and the experimenter's.
            host: address to listen at. A page that others than this machine can open needs the token in its address,
                which is drawn anew each time, one for each page.

        Raises:
            OSError: for a port that is taken, or if it does not come to listen.
            ImportError: viser is not installed.
        """
        quiet_viser()
        for port in ports:
            check_free(host, port, "--view-port")
        tokens = ["" if is_loopback(host) else secrets.token_urlsafe(TOKEN_BYTES) for _ in ports]
        self._folder = tempfile.TemporaryDirectory(prefix="jaxgrasp-view-")
        folder = Path(self._folder.name)
        self._slot = Slot(folder / SLOT, ViewFrame.size(channels, more), create=True)
        (folder / SHOWN).write_bytes(pickle.dumps(jax.device_get(shown) | {"tokens": tokens}))
        options = {"folder": str(folder), "channels": channels, "more": more, "ports": ports, "host": host}
        self._child = WorkerProcess("jaxgrasp.view.view_process", options)
        try:
            message = self._child.wait_for(
                lambda message: "listens" in message or "failed" in message, patience=COMPILES
            )
            if "failed" in message:
                raise OSError(message["failed"])
        except BaseException:
            self.close()
            raise
        self.addresses = [
            page_address(host, port, token) for port, token in zip(message["listens"], tokens, strict=True)
        ]

    @property
    def process_id(self) -> int:
        """Number of the process that shows the page."""
        return self._child.process.pid

    def write(self, frame: ViewFrame) -> None:
        """Copy a frame to the slot for the page to show; this does not wait."""
        self._slot.write(frame.vector())

    def close(self) -> None:
        """End the page."""
        self._child.close()
        self._slot.close()
        self._folder.cleanup()

    def __enter__(self) -> "ViewFeed":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
