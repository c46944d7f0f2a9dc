"""A simulated DOGlove behind two pseudo-terminals, moved by a person or not."""

import threading
import time
from collections.abc import Callable

import numpy as np

from jaxgrasp.glove.other_devices.doglove import BOARD_BAUD, SERVO_BAUD
from jaxgrasp.glove.simulated.simulator_process import PseudoTerminal
from tests.glove import simulated_doglove as published
from tests.hand.test_doglove_hand import READINGS, to_urdf


class Hardware(threading.Thread):
    """Board and servos behind their ports."""

    def __init__(self, folder, stops: str):
        super().__init__(daemon=True)
        self.glove = published.Glove(stops=stops)
        self.glove.bend(30.0)
        self.servos = PseudoTerminal(folder / "servos", SERVO_BAUD)
        self.board = PseudoTerminal(folder / "board", BOARD_BAUD)
        self.is_over, self.held_at = False, 0.0
        self.moves: Callable[[float], None] = lambda timestamp: None
        for terminal in (self.servos, self.board):
            terminal.plug()

    def pose_linkage(self, angles) -> None:
        """Set what encoders and servos read to the angles of the linkage's joints [rad]."""
        for finger, urdf_angles in to_urdf(angles).items():
            for (sensor, zero, sign), angle in zip(READINGS[finger], urdf_angles):
                degrees = zero + sign * float(np.degrees(angle))
                if sensor < 16:
                    self.glove.board.degrees[sensor] = degrees
                else:
                    self.glove.chain.servos[sensor - 16].degrees = degrees

    def run(self) -> None:
        while not self.is_over:
            timestamp = time.perf_counter()
            self.moves(timestamp)
            for terminal, device in ((self.servos, self.glove.chain), (self.board, self.glove.board)):
                terminal.queue(device.exchange(timestamp, terminal.read(timestamp)))
                terminal.write(timestamp)
            if self.glove.held():
                self.held_at = timestamp
            time.sleep(0.0005)
        self.servos.unplug()
        self.board.unplug()
