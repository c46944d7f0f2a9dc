"""Importance of a glove's joints over whole trials: the part of what is felt that each joint renders.

One posture says which joints bear a grip at rest; a trial has reaching, lifting, carrying, collisions and release. The
share of a joint is the integral of its squared torque over all joints' together; a glove without that joint would lose
this part of what is felt.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.stats import kendalltau

from jaxgrasp.validation.checked import checked

RESAMPLES = 2000


class JointRanking(NamedTuple):
    """Importance of each joint over several trials, the most important first, and how stable the order is."""

    joints: tuple[str, ...]
    shares: Float[np.ndarray, "channels"]
    """Mean shares of the trials; they sum to 1."""
    low: Float[np.ndarray, "channels"]
    """Lower ends of the 95 % intervals of the shares, by bootstrap over the trials."""
    high: Float[np.ndarray, "channels"]
    tau: float
    """Mean Kendall tau-b of the order in each trial with that of the mean of all others."""
    tau_low: float
    """Lower end of the 95 % interval of that mean, by bootstrap over the trials."""
    tau_high: float


@checked
def rank_joints(
    joints: Sequence[str], trials: Sequence[Float[np.ndarray, "_ channels"]], seed: int = 0
) -> JointRanking:
    """Rank a glove's joints by what they render over trials.

    Args:
        joints: names of the channels.
        trials: torques against flexion of each trial at equal steps of time ``(T, channels)`` [N.m].
        seed: of the bootstrap.

    Raises:
        ValueError: for fewer than three trials, a trial of another number of channels, or one without torque.
    """
    if len(trials) < 3:
        raise ValueError(f"trials has {len(trials)} entries: expected 3 or more, to tell how stable the order is")
    rows = []
    for k, torques in enumerate(trials):
        if np.ndim(torques) != 2 or np.shape(torques)[1] != len(joints):
            raise ValueError(f"trials[{k}] has shape {np.shape(torques)}: expected (T, {len(joints)})")
        squares = np.sum(np.square(torques), 0)
        if not (np.isfinite(squares).all() and squares.sum() > 0):
            raise ValueError(f"trials[{k}] has no torque, or one that is not finite")
        rows.append(squares / squares.sum())
    shares = np.array(rows)
    taus = np.array([_tau(row, np.delete(shares, k, 0).mean(0)) for k, row in enumerate(shares)])
    picks = np.random.default_rng(seed).integers(0, len(rows), (RESAMPLES, len(rows)))
    low, high = np.quantile(shares[picks].mean(1), [0.025, 0.975], axis=0)
    tau_low, tau_high = np.quantile(taus[picks].mean(1), [0.025, 0.975])
    order = np.argsort(-shares.mean(0), kind="stable")
    return JointRanking(
        tuple(joints[k] for k in order),
        shares.mean(0)[order],
        low[order],
        high[order],
        float(taus.mean()),
        float(tau_low),
        float(tau_high),
    )


def _tau(first: Float[np.ndarray, "channels"], second: Float[np.ndarray, "channels"]) -> float:
    return float(kendalltau(first, second).statistic)
