"""A robot in a process of its own that presses for ever: ``python robot_process.py``; prints its port."""

import time

import numpy as np

from jaxgrasp.glove.network.link import NetworkLink
from jaxgrasp.teleop.live import OLDEST
from jaxgrasp.teleop.session import PersonMessage, RobotMessage

link = NetworkLink("127.0.0.1", 0, PersonMessage.size(19), listens=True, oldest=OLDEST)
print(link.port, flush=True)
while True:
    now = time.perf_counter()
    link.receive(now)
    link.send(now, RobotMessage(np.full(14, 0.05), 1.0, True).vector())
    time.sleep(0.002)
