"""Probability that a hand holds a load if friction, the places of its contacts and the load are uncertain."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array
from jax.scipy.special import ndtri

from jaxgrasp.force.margin import wrench_margin
from jaxgrasp.model.arguments import check_arguments, check_sign
from jaxgrasp.model.arrays import AnyArray, Float
from jaxgrasp.model.grasp import Grasp, Limits
from jaxgrasp.numerics.geometry import tangents
from jaxgrasp.validation.checked import checked


class HoldProbability(NamedTuple):
    """The share of the drawn cases that a hand holds, and what that says."""

    probability: Float[Array, "*batch"]
    """The share."""
    low: Float[Array, "*batch"]
    """Wilson's interval of the probability behind it, by the confidence asked for."""
    high: Float[Array, "*batch"]
    margin: Float[Array, "*batch"]
    """Mean of the cases' margins: by which share of itself each load could grow, below zero where it is not held."""
    margins: Float[Array, "samples *batch"]
    """The margin of each case."""


@checked
def hold_probability(
    grasp: Grasp,
    wrench: Float[AnyArray, "*#batch 6"],
    sharing: str = "squeeze",
    *,
    limits: Limits | None = None,
    friction_spread: Float[AnyArray, "..."] | float = 0.0,
    place_spread: Float[AnyArray, "..."] | float = 0.0,
    load_spread: Float[AnyArray, "... 6"] | None = None,
    samples: int = 1000,
    seed: int = 0,
    confidence: float = 0.95,
) -> HoldProbability:
    """Estimate the probability that a hand holds a load from random cases, with its confidence interval.

    In each case every contact has a friction of its own, log-normal about the one given (torsional friction moves with
    it); a place of its own, moved in its tangent plane by a normal distribution, with its normal and its torque map as
    they were; and the load is drawn from a normal distribution. A case is held where forces inside the cones and the
    limits exert its load. All grasps of a batch meet the same draws, so that they can be compared.

    The interval is Wilson's for a binomial share (Wilson 1927; Brown, Cai and DasGupta, Interval estimation for a
    binomial proportion, Statistical Science 16, 2001): it holds what the draws leave open, not whether the
    distributions are right. The probability has no useful derivative, being a count; ``margin`` has one, by the grasp,
    the load, the limits and the spreads, for the draws held fast. Without ``limits`` it says little: loads that are
    held can then grow for ever.

    Works under ``jit``, ``vmap`` and ``grad``.

    Args:
        grasp: contacts ``(..., n)``; leading axes broadcast against the wrench's.
        wrench: what the contacts must exert ``(..., 6)`` [N, N.m], at the middle of what may come.
        sharing: as for [`jaxgrasp.wrench_margin`][].
        limits: of the hand, as for [`jaxgrasp.constrained_optimum`][].
        friction_spread: standard deviation of the logarithm of friction, about its relative one; ``(..., n)`` or one.
        place_spread: standard deviation of places along each of two tangents [m]; ``(..., n)`` or one.
        load_spread: standard deviation of each component of the load ``(..., 6)`` [N, N.m].
        samples: how many cases.
        seed: of the draws, which are the same for the same seed, sizes and precision.
        confidence: of the interval, between 0 and 1.

    Raises:
        ValueError: for a spread below zero, options that cannot be used, or shapes that do not fit.
        NotImplementedError: when differentiated twice.
    """
    _check(samples, confidence)
    check_arguments(
        grasp,
        {"wrench": (wrench, (6,)), "friction_spread": (friction_spread, ()), "place_spread": (place_spread, ())},
        {"load_spread": (load_spread, (6,))},
    )
    spreads = {"friction_spread": friction_spread, "place_spread": place_spread, "load_spread": load_spread}
    for name, spread in spreads.items():
        if spread is not None:
            check_sign(name, spread)
    cases, loads = _drawn(grasp, wrench, friction_spread, place_spread, load_spread, samples, seed)
    margins = wrench_margin(cases, loads, loads, sharing, limits=limits)
    share = jnp.mean(margins >= 0, 0, dtype=margins.dtype)
    return HoldProbability(share, *_wilson(share, samples, confidence), jnp.mean(margins, 0), margins)


def _check(samples: int, confidence: float) -> None:
    if samples < 1:
        raise ValueError(f"samples is {samples}: expected a number of cases, 1 or more")
    if not 0 < confidence < 1:
        raise ValueError(f"confidence is {confidence}: expected a number between 0 and 1")


def _drawn(
    grasp: Grasp,
    wrench: AnyArray,
    friction_spread: AnyArray | float,
    place_spread: AnyArray | float,
    load_spread: AnyArray | None,
    samples: int,
    seed: int,
) -> tuple[Grasp, Array]:
    """Draw the grasps of all cases and their loads, with the samples as first axis."""
    points, normals, friction, load = map(jnp.asarray, (grasp.points, grasp.normals, grasp.friction, wrench))
    dtype = jnp.result_type(points, load)
    keys = jax.random.split(jax.random.key(seed), 3)
    depth = (1,) * (max(points.ndim - 2, load.ndim - 1))
    n = friction.shape[-1]
    of_friction = jax.random.normal(keys[0], (samples, *depth, n), dtype)
    of_places = jax.random.normal(keys[1], (samples, *depth, n, 2), dtype)
    of_loads = jax.random.normal(keys[2], (samples, *depth, 6), dtype)
    factor = jnp.exp(jnp.asarray(friction_spread, dtype) * of_friction)
    first, second = tangents(normals)
    moves = jnp.asarray(place_spread, dtype)[..., None] * of_places
    places = points + moves[..., :1] * first + moves[..., 1:] * second
    cases = eqx.tree_at(lambda g: (g.points, g.friction), grasp, (places, friction * factor))
    if grasp.torsion is not None:
        cases = eqx.tree_at(lambda g: g.torsion, cases, jnp.asarray(grasp.torsion) * factor)
    loads = load + jnp.zeros_like(of_loads) if load_spread is None else load + jnp.asarray(load_spread) * of_loads
    return cases, loads


def _wilson(share: Array, samples: int, confidence: float) -> tuple[Array, Array]:
    """Compute Wilson's interval of a share of ``samples`` cases."""
    quantile = ndtri(jnp.asarray((1 + confidence) / 2, share.dtype))
    extra = quantile**2 / samples
    centre = (share + extra / 2) / (1 + extra)
    half = jnp.sqrt(extra) / (1 + extra) * jnp.sqrt(share * (1 - share) + extra / 4)
    # At its ends it is what rounding of the difference would miss.
    return jnp.where(share > 0, centre - half, 0), jnp.where(share < 1, centre + half, 1)
