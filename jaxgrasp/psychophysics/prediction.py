"""Predictions before an experiment: precision by trials and persons, recovery of thresholds, rendering errors.

Just noticeable differences to expect through a device, from its rendering errors.

Answers of simulated observers, counted, for many experiments at once.

Recovery of known thresholds by an analysis: bias of its estimates and coverage of its intervals.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Real
from scipy.optimize import brentq
from scipy.special import chdtri, fdtri, ncfdtr, ndtr

from jaxgrasp.psychophysics.analysis.likelihood import Likelihood, Model
from jaxgrasp.psychophysics.analysis.threshold import line_estimates, percentile_interval
from jaxgrasp.psychophysics.psychometric import QUARTILE, Observer
from jaxgrasp.psychophysics.trial import intensity
from jaxgrasp.validation.checked import checked

Values = Float[np.ndarray, "..."] | float


@dataclass(frozen=True)
class RenderingError:
    """Errors of a device that renders stimuli, taken for noise that each of the two stimuli of a trial has anew.

    ``quantum``, ``pretension``, ``stiction`` and ``limit`` are in the stimulus' unit; ``friction`` and ``lag`` are
    shares of the stimulus, and ``motions`` a number.

    Raises:
        ValueError: for numbers that are negative or not finite, but an infinite limit.
    """

    quantum: float = 0.0
    """Step of what can be rendered: an even error of half of it either way."""
    friction: float = 0.0
    """Friction of the cables: coefficient times angle of wrap, by which the tension grows or falls as exp(+-friction)
    with the direction of the motion. What both directions have in common is in both stimuli alike, and is not felt."""
    pretension: float = 0.0
    """Tension that keeps cables taut and is pulled at besides: friction changes it with the direction too, even for no
    stimulus."""
    stiction: float = 0.0
    """Standard deviation of any other error that does not grow with the stimulus."""
    lag: float = 0.0
    """Delay times the stimulus' own relative rate of change: late by that share, with the sign of the motion."""
    limit: float = np.inf
    """Largest stimulus that can be rendered."""
    motions: float = 7.0
    """Motions over which a person averages what depends on the direction, as if each had a direction at random: the
    paper's three to four liftings, up and down."""

    def __post_init__(self):
        for name in ("quantum", "friction", "pretension", "stiction", "lag"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value >= 0):
                raise ValueError(f"{name} is {value}: expected a finite number, 0 or more")
        for name in ("limit", "motions"):
            if not getattr(self, name) > 0:
                raise ValueError(f"{name} is {getattr(self, name)}: expected a positive number")

    def deviation(self, intensity: Values) -> Values:
        """Compute the standard deviation of the rendered stimulus at an intensity, in the stimulus' unit."""
        stimulus = np.asarray(intensity)
        by_direction = np.hypot(np.sinh(self.friction) * (stimulus + self.pretension), self.lag * stimulus)
        return np.sqrt(self.quantum**2 / 12 + self.stiction**2 + by_direction**2 / self.motions)


def hit_probability_through(observer: Observer, error: RenderingError, reference: Values, comparison: Values) -> Values:
    """Compute the chance of a right answer where both stimuli come through a device."""
    felt_comparison, felt_reference = (np.minimum(np.asarray(x, float), error.limit) for x in (comparison, reference))
    observer_noise = np.asarray(observer.jnd(np.minimum(felt_comparison, felt_reference))) / QUARTILE
    # sigma^2 = sigma_observer^2 + sigma_device(comparison)^2 + sigma_device(reference)^2.
    noise = np.sqrt(observer_noise**2 + error.deviation(felt_comparison) ** 2 + error.deviation(felt_reference) ** 2)
    distance = (felt_comparison - felt_reference) / noise
    hit_share = 0.5 * (ndtr(distance + observer.bias) + ndtr(distance - observer.bias))
    return observer.lapse + (1 - 2 * observer.lapse) * hit_share


@checked
def jnd_through(observer: Observer, error: RenderingError, reference: float, criterion: float = 0.75) -> float:
    """Compute the difference that is noticed as often as the criterion says; infinite beyond the device's limit.

    Raises:
        ValueError: for a criterion that lapses make impossible, or that guesses reach; a reference that is negative,
            or zero for an observer who notices anything there.
    """
    if not (np.isfinite(reference) and reference >= 0):
        raise ValueError(f"reference is {reference}: expected a finite number, 0 or more")
    if not observer.jnd(reference) > 0:
        raise ValueError(
            f"reference is {reference}, where this observer notices any difference: expected a positive number"
        )
    if not 0.5 < criterion < 1 - observer.lapse:
        raise ValueError(f"criterion is {criterion}: expected more than 0.5 and less than {1 - observer.lapse:g}")

    def beyond(difference: float) -> float:
        return float(hit_probability_through(observer, error, reference, reference + difference)) - criterion

    far = max(float(observer.jnd(reference)), 1e-12)
    for _ in range(60):
        if beyond(far) > 0:
            return float(brentq(beyond, 0.0, far, xtol=1e-14, rtol=1e-12))
        far *= 2
        if reference + far > 4 * error.limit:
            break
    return np.inf


def shares_of_device(observer: Observer, error: RenderingError, reference: float) -> dict[str, float]:
    """Compute the JND through a device with each of its errors alone, with all, and without any (``none``)."""
    parts = {"none": RenderingError(motions=error.motions)}
    for name in ("quantum", "friction", "stiction", "lag"):
        if value := getattr(error, name):
            parts[name] = RenderingError(**{name: value}, motions=error.motions)
    if error.pretension and error.friction:
        cable_errors = {"friction": error.friction, "pretension": error.pretension}
        parts["friction and pretension"] = RenderingError(**cable_errors, motions=error.motions)
    if np.isfinite(error.limit):
        parts["limit"] = RenderingError(limit=error.limit)
    parts["all"] = error
    return {name: jnd_through(observer, part, reference) for name, part in parts.items()}


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


@dataclass(frozen=True)
class Recovery:
    """Bias, spread and coverage of one method, over many experiments."""

    bias: float
    """Median of the estimates less the truth, by the truth."""
    spread: float
    """Half the distance between the quantiles that a normal distribution has at one standard deviation, by the
    truth."""
    coverage: float
    """Share of the intervals that hold the truth."""
    outside: float
    """Share of the estimates that lie outside the levels, or are none."""


def by_likelihood(
    hits: Real[np.ndarray, "E L"], trials: int, levels: Float[np.ndarray, "L"], model: Model, truth: float
) -> dict[str, Recovery]:
    """Compute the recovery by largest likelihood with profile intervals, and by the posterior's median, at 95 %."""
    grid = Likelihood(levels, model)
    counts = np.full(len(levels), float(trials))
    truth_coordinate = float(grid.axis.coordinate(truth))
    profiles = grid.profiles(hits, counts)
    at_truth = np.array([np.interp(truth_coordinate, grid.coordinates, profile) for profile in profiles])
    covered = 2 * (profiles.max(1) - at_truth) <= chdtri(1, 0.05)
    recoveries = {"likelihood": summed(grid.peaks(profiles), covered, levels, truth)}
    weights = grid.posteriors(hits, counts)
    below = np.cumsum(weights, 1) - 0.5 * weights
    medians = grid.axis.level(np.array([np.interp(0.5, row, grid.coordinates) for row in below]))
    at_truth = np.array([np.interp(truth_coordinate, grid.coordinates, row) for row in below])
    recoveries["posterior"] = summed(medians, np.abs(at_truth - 0.5) <= 0.475, levels, truth)
    return recoveries


def by_bootstrap(
    hits: Real[np.ndarray, "E L"],
    trials: int,
    levels: Float[np.ndarray, "L"],
    model: Model,
    truth: float,
    method: str,
    resamples: int,
    rng: np.random.Generator,
) -> Recovery:
    """Compute the recovery by a method with percentile intervals of 95 % from answers drawn anew."""
    if method == "likelihood":
        grid, counts = Likelihood(levels, model), np.full(len(levels), float(trials))
        estimator = lambda drawn: grid.estimates(drawn, counts)  # noqa: E731
    else:
        estimator = lambda drawn: line_estimates(method, levels, drawn / trials, model)  # noqa: E731
    estimates = estimator(hits)
    covered = np.zeros(len(hits), bool)
    for k, row in enumerate(hits):
        drawn = estimator(rng.binomial(trials, row / trials, (resamples, len(levels))).astype(float))
        low, high = percentile_interval(drawn, 0.95)
        covered[k] = low <= truth <= high
    return summed(estimates, covered, levels, truth)


def summed(
    estimates: Float[np.ndarray, "E"], covered: np.ndarray, levels: Float[np.ndarray, "L"], truth: float
) -> Recovery:
    """Compute bias, spread and coverage of a method; missing estimates count as infinite."""
    finite_or_inf = np.where(np.isnan(estimates), np.inf, estimates)
    low, middle, high = np.quantile(finite_or_inf, [0.1587, 0.5, 0.8413], method="nearest")
    outside = np.mean(~((finite_or_inf >= levels.min()) & (finite_or_inf <= levels.max())))
    return Recovery(
        float(middle / truth - 1), float((high - low) / (2 * truth)), float(np.mean(covered)), float(outside)
    )


@checked
def within_power(
    effect: float,
    subjects: int,
    conditions: int,
    *,
    correlation: float = 0.5,
    sphericity: float = 1.0,
    alpha: float = 0.05,
) -> float:
    """Compute the power of a repeated-measures analysis of variance with one factor, by the noncentral F.

    The noncentrality is n k f^2 epsilon / (1 - rho), for (k - 1) epsilon and (k - 1)(n - 1) epsilon degrees of freedom
    (Muller and Barton, J. Am. Stat. Assoc. 84, 1989).

    Args:
        effect: Cohen's f: standard deviation of the conditions' means by that of persons within a condition.
        subjects: number n of persons, at least 2.
        conditions: number k of conditions, at least 2.
        correlation: rho of a person's values in any two conditions.
        sphericity: Greenhouse and Geisser's epsilon, from 1 / (k - 1) to 1.
        alpha: significance level.

    Raises:
        ValueError: for a number that is out of its range.
    """
    for name, count in (("subjects", subjects), ("conditions", conditions)):
        if count < 2:
            raise ValueError(f"{name} is {count}: expected at least 2")
    if not (np.isfinite(effect) and effect >= 0):
        raise ValueError(f"effect is {effect}: expected a finite number, 0 or more")
    for name, value in (("correlation", correlation), ("alpha", alpha)):
        if not (0 <= value < 1) or (name == "alpha" and value == 0):
            raise ValueError(f"{name} is {value}: expected {'more than 0' if name == 'alpha' else '0'} to below 1")
    if not 1 / (conditions - 1) - SMALLEST <= sphericity <= 1:
        raise ValueError(f"sphericity is {sphericity}: expected {1 / (conditions - 1):.3g} to 1")
    between = (conditions - 1) * sphericity
    within = between * (subjects - 1)
    # The F that is exceeded by chance alpha: of 1 - alpha, the inverse of fdtr.
    critical = fdtri(between, within, 1 - alpha)
    noncentrality = subjects * conditions * effect**2 * sphericity / (1 - correlation)
    return float(1 - ncfdtr(between, within, noncentrality, critical)) if noncentrality > 0 else alpha


@checked
def persons_for_power(effect: float, conditions: int, power: float = 0.8, *, most: int = 1000, **options: float) -> int:
    """Return the smallest number of persons whose analysis has a power; ``options`` are those of ``within_power``.

    Raises:
        ValueError: for a power that ``most`` persons do not reach, or that is not between 0 and 1.
    """
    if not 0 < power < 1:
        raise ValueError(f"power is {power}: expected more than 0 and less than 1")
    for subjects in range(2, most + 1):
        if within_power(effect, subjects, conditions, **options) >= power:
            return subjects
    raise ValueError(f"effect is {effect}: {most} persons do not reach a power of {power:g}")


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
