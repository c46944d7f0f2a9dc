"""Postures to test with."""

import numpy as np

from jaxgrasp.hand import Hand, Pose, Posture


def rotations(count: int, rng: np.random.Generator) -> np.ndarray:
    turns, _ = np.linalg.qr(rng.normal(size=(count, 3, 3)))
    return turns * np.linalg.det(turns)[:, None, None]


def random_posture(hand: Hand, count: int, seed: int = 0) -> Posture:
    """Return postures anywhere within a metre, with angles anywhere within their limits."""
    rng = np.random.default_rng(seed)
    lower, upper = np.asarray(hand.lower), np.asarray(hand.upper)
    angles = lower + rng.uniform(size=(count, len(lower))) * (upper - lower)
    return Posture(Pose(rng.uniform(-1, 1, (count, 3)), rotations(count, rng)), angles)
