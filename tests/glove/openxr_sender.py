"""A client of an OpenXR runtime in a process of its own: a hand that opens, closes and rises, as its input says.

    python -m tests.glove.openxr_sender OPTIONS

Options are a JSON object: ``ports`` of this machine, and the angles ``open`` and ``closed`` by joint [rad].
"""

import json
import socket
import sys
import threading
import time

import numpy as np

from tests.glove import simulated_openxr as client

RATE = 90.0
SPEED = {"share": 0.8, "height": 0.05}
"""Shares of the way between open and closed in a second, and height [m] in a second."""
TARGETS = {"open": (0.0, 0.0), "close": (1.0, 0.0), "lift": (1.0, 0.05)}


def main() -> None:
    """Send records until the standard input ends."""
    options = json.loads(sys.argv[1])
    target, is_over = [TARGETS["open"]], threading.Event()

    def listen() -> None:
        for line in sys.stdin:
            target[0] = TARGETS[line.strip()]
        is_over.set()

    threading.Thread(target=listen, daemon=True).start()
    share = height = 0.0
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp:
        while not is_over.is_set():
            steps = SPEED["share"] / RATE, SPEED["height"] / RATE
            share += float(np.clip(target[0][0] - share, -steps[0], steps[0]))
            height += float(np.clip(target[0][1] - height, -steps[1], steps[1]))
            angles = {
                joint: angle + share * (options["closed"][joint] - angle) for joint, angle in options["open"].items()
            }
            record = client.line(time.perf_counter(), client.joints(angles, place=(0.0, 1.2 + height, -0.3)))
            for port in options["ports"]:
                udp.sendto(record, ("127.0.0.1", port))
            time.sleep(1 / RATE)


if __name__ == "__main__":
    main()
