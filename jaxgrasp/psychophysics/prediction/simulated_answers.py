"""Answers of simulated observers, counted, for many experiments at once."""

import numpy as np
from jaxtyping import Float, Real

from jaxgrasp.psychophysics.observer import Observer
from jaxgrasp.psychophysics.trial import intensity


def simulated_hits(
    observer: Observer,
    reference: float,
    levels: Float[np.ndarray, "L"],
    trials: int,
    experiments: int,
    rng: np.random.Generator,
) -> Real[np.ndarray, "E L"]:
    """Draw the right answers at each level, both orders equally often.

    Args:
        observer: who answers.
        reference: of the comparisons; 0 for detection.
        levels: of the comparisons.
        trials: at each level, in random order among all levels.
        experiments: how many times.
        rng: of the answers.
    """
    comparisons = np.array([intensity(reference, level) for level in levels])
    if not observer.learning:
        return rng.binomial(trials, hit_chances(observer, reference, comparisons, trials), (experiments, len(levels)))
    hits = np.zeros((experiments, len(levels)))
    level_indices = np.tile(np.arange(len(levels)), trials)
    for k in range(experiments):
        order = rng.permutation(level_indices)
        chances = observer.hit_probability(reference, comparisons[order], np.arange(len(order)))
        right = rng.random(len(order)) < chances
        hits[k] = np.bincount(order[right], minlength=len(levels))
    return hits


def hit_chances(
    observer: Observer, reference: float, comparisons: Float[np.ndarray, "L"], trials: int
) -> Float[np.ndarray, "L"]:
    """Compute the chances of a right answer at each level; their mean over a session while an observer learns."""
    if not observer.learning:
        return np.asarray(observer.hit_probability(reference, comparisons))
    numbers = np.arange(trials * len(comparisons))[:, None]
    return np.asarray(observer.hit_probability(reference, comparisons, numbers)).mean(0)
