"""Numbers of trials and persons for a wanted precision."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from jaxgrasp.psychophysics.analysis.likelihood import Likelihood, Model
from jaxgrasp.psychophysics.observer import Observer
from jaxgrasp.psychophysics.prediction.simulated_answers import simulated_hits
from jaxgrasp.validation.checked import checked

SMALLEST = 1e-9


@dataclass(frozen=True)
class Precision:
    """Precision with which a design estimates a mean threshold."""

    trials: int
    """Trials at each level, of each person."""
    subjects: int
    within: float
    """Standard deviation of one person's estimated threshold about its own truth."""
    standard_error: float
    """Standard error of the mean over persons."""
    outside: float
    """Share of single persons' estimates that lie outside the levels: these experiments would say so, and not count."""

    def total(self, levels: int) -> int:
        """Return the number of trials of all persons together."""
        return self.trials * self.subjects * levels


@checked
def precision(
    observer: Observer,
    reference: float,
    levels: Float[np.ndarray, "L"],
    trials: int,
    subjects: int,
    *,
    between: float = 0.0,
    model: Model | None = None,
    experiments: int = 500,
    seed: int = 0,
) -> Precision:
    """Compute the precision of the persons' mean threshold, by simulated experiments.

    Args:
        observer: sensitivity of an average person.
        reference: of the comparisons; 0 for detection.
        levels: of the comparisons.
        trials: at each level, of each person.
        subjects: number of persons.
        between: standard deviation of the persons' own thresholds, in the levels' unit.
        model: by which each person's answers are fitted.
        experiments: simulated.
        seed: of the answers.
    """
    rng = np.random.default_rng(seed)
    hits = simulated_hits(observer, reference, levels, trials, experiments, rng)
    model = Model() if model is None else model
    estimates = Likelihood(levels, model).estimates(hits, np.full(len(levels), float(trials)))
    low, high = np.quantile(estimates, [0.1587, 0.8413])
    within = float(high - low) / 2
    outside = np.mean((estimates > levels.max()) | (model.shape.has_width & (estimates < levels.min())))
    return Precision(trials, subjects, within, float(np.sqrt((within**2 + between**2) / subjects)), float(outside))


@checked
def cheapest(
    target_error: float,
    observer: Observer,
    reference: float,
    levels: Float[np.ndarray, "L"],
    *,
    between: float = 0.0,
    most_subjects: int = 100,
    trials: tuple[int, ...] = (10, 20, 40, 80, 160, 320),
    max_outside: float = 0.1,
    **options: object,
) -> list[Precision]:
    """Return designs that reach a standard error, one for each number of trials a level, by their total of trials.

    Args:
        target_error: standard error of the mean threshold.
        observer: sensitivity of an average person.
        reference: of the comparisons.
        levels: of the comparisons.
        between: standard deviation of the persons' own thresholds.
        most_subjects: that can be had.
        trials: at each level of each person, to be tried.
        max_outside: largest share of persons' estimates outside the levels.
        options: of ``precision``.

    Raises:
        ValueError: for a wanted precision that is not positive, or a negative deviation.
    """
    if not (np.isfinite(target_error) and target_error > SMALLEST):
        raise ValueError(f"target_error is {target_error}: expected a positive number")
    if not 0 <= between < 1 / SMALLEST:
        raise ValueError(f"between is {between}: expected a finite number, 0 or more")
    designs = []
    for count in trials:
        estimate = precision(observer, reference, levels, count, 1, between=between, **options)  # type: ignore[arg-type]
        needed = estimate.standard_error / target_error
        if needed**2 <= most_subjects and estimate.outside <= max_outside:
            subjects = max(2, int(np.ceil(needed**2)))
            error = estimate.standard_error / np.sqrt(subjects)
            designs.append(Precision(count, subjects, estimate.within, float(error), estimate.outside))
    return sorted(designs, key=lambda design: design.total(len(levels)))
