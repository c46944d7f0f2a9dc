"""Just noticeable differences to expect through a device, from its rendering errors."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.optimize import brentq
from scipy.special import ndtr

from jaxgrasp.psychophysics.observer import QUARTILE, Observer
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
