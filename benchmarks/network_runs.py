"""A person's motion against walls far away, over a random network: energy that the network takes in at both ports."""

import numpy as np

from jaxgrasp.glove.passivity import MotionPort, TorquePort
from jaxgrasp.teleop.network import NetworkModel, SimulatedLink

STEP = 0.002
"""Time of a step [s]."""


def play(
    seed: int,
    *,
    channels: int = 3,
    steps: int = 400,
    network: NetworkModel | None = None,
    is_controlled: bool = True,
) -> tuple[list[np.ndarray], float]:
    """Play a person against walls far away, over a network that is late and loses messages.

    Args:
        seed: of motion, walls and network.
        channels: joints of the person.
        steps: number of steps.
        network: faults of the network; random ones where not given.
        is_controlled: whether the ports control what leaves by them.

    Returns:
        Over time: the person's angles [rad], the torques at the person [N.m], the desired angles and the torques at the
        robot; and the least net energy into the network [J].
    """
    rng = np.random.default_rng(seed)
    if network is None:
        network = NetworkModel(rng.choice([0, 0.02, 0.05, 0.1, 0.2]), rng.choice([0, 0.02]), rng.choice([0, 0.05, 0.3]))
    there, back = SimulatedLink(network, rng), SimulatedLink(network, rng)
    frequencies = rng.uniform(0.2, 4, (3, channels))
    sizes, phases = rng.uniform(0, 0.5, (3, channels)) / frequencies, rng.uniform(0, 6.3, (3, channels))
    walls, stiffness = rng.uniform(-0.3, 0.5, channels), rng.uniform(0.1, 2, channels)

    def angles_at(timestamp: float) -> np.ndarray:
        return (sizes * np.sin(2 * np.pi * frequencies * timestamp + phases)).sum(0)

    near, far = TorquePort(), MotionPort(angles_at(0.0))
    nothing, least = np.zeros(channels), 0.0
    history: list[tuple[np.ndarray, ...]] = []
    net = {"near": 0.0, "far": 0.0}
    torques = nothing
    for k in range(steps):
        timestamp = k * STEP
        angles, reply = angles_at(timestamp), back.receive(timestamp)
        requested, sent = (nothing, 0.0) if reply is None else (reply[:channels], reply[channels])
        # The energies, counted here and not by the ports.
        net["near"] += torques @ (angles - (history[-1][0] if history else angles))
        limited = near.step(angles, requested, sent)
        torques = limited if is_controlled else requested
        there.send(timestamp, np.append(angles, near.tank.sent))
        message, before = there.receive(timestamp), far.angles
        measured = np.clip(stiffness * (before - walls), 0, 0.12)
        if message is not None:
            if is_controlled:
                far.step(message[:channels], measured, message[channels])
            else:
                far.angles = message[:channels]
            net["far"] -= measured @ (far.angles - before)
        back.send(timestamp, np.append(measured, far.tank.sent))
        least = min(least, net["near"] + net["far"])
        history.append((angles, torques, far.angles, measured))
    return [np.array(column) for column in zip(*history, strict=True)], float(least)
