"""The careful optimum: a proximal term makes the dual strongly concave, and falls away level by level.

At each level the term holds the multiplier near the last level's, so that Newton's method starts close to
its goal however degenerate the cones are. Where no forces exist the multiplier runs off instead, and what
is left of the wrench tends to the shortest one out of reach: the proof.

With a strength of zero, and one level, the same code is Newton's method on the dual as it is: the fast passes.
"""

from functools import partial
from typing import NamedTuple, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
from jax import Array, lax

from jaxgrasp.model.solution import Verdict
from jaxgrasp.numerics.fused_cpu_kernel import fused_cpu_kernel
from jaxgrasp.numerics.shard_map_loop import varying_like
from jaxgrasp.problem import contact_vec
from jaxgrasp.problem.contact_vec import ContactVec
from jaxgrasp.problem.scaled_problem import ScaledProblem
from jaxgrasp.problem.spatial import SpatialVec
from jaxgrasp.solver.infeasibility import find_certificate
from jaxgrasp.solver.newton import (
    ConcaveObjective,
    DualObjective,
    NewtonState,
    OptimalityCheck,
    ProximalTerm,
    advance,
    at_start,
    check_optimality,
)
from jaxgrasp.solver.result import Certificate, no_certificate

STRONGEST = 1e-2
NEAR = 1e-4
"""Strength of the first level where the fast passes came near."""
STEPS_PER_LEVEL = 40
STEPS_PER_CHECK = 3
"""Evaluations after which the careful search checks which problems have reached the end of their level. Each goes
through the levels by itself, so that few of a tile wait for others; a check costs about two evaluations."""


UNLIMITED_CHECKS = 2**30
"""Checks: as many as it takes."""


class ProximalState(NamedTuple):
    """Where each problem stands."""

    point: Array
    forces: ContactVec
    verdict: Array
    """NOT_CONVERGED for those that are not decided."""
    steps: Array
    certificate: Certificate
    """It has as many rows as the point has."""
    decided: Array
    loosely_optimal: Array
    """Whether the point is the optimum within ``LOOSE_FACTOR`` times the tolerances."""
    stalled: Array
    """Whether Newton's method was unable to move on."""
    relative_residual: Array
    """The part of the load that the forces miss."""
    strength: Array
    """Strength of the proximal term where the search goes on; 0 where it has come to its end."""


class PassSettings(NamedTuple):
    """How one pass works, in scalars, so that all passes are one compiled code."""

    careful: Array
    """Level by level; else the dual as it is, once."""
    steps: Array
    """Evaluations at each level."""
    proves: Array
    """With proofs that no forces exist, which the displacement of the multiplier gives once it is large enough."""
    with_squeeze: Array
    """The problem as it is; else without squeezing and with equal sharing, which asks only for allowed forces."""
    restarts: Array
    """From the beginning, whatever the last pass found; else where it stopped."""
    checks: Array
    """How often to check which problems are at the end of a level, before the unfinished are gathered anew."""
    weakest: Array
    """Strength of the proximal term below which there are no more levels."""


@runtime_checkable
class ProximalProblem(Protocol):
    """What the search needs of a problem: an objective, a check of optimality, and proofs."""

    def with_proximal_term(self, proximal: ProximalTerm) -> ConcaveObjective:
        """The objective with a proximal term."""
        ...

    def check_optimality(self, point: Array) -> OptimalityCheck:
        """The forces of a point, and whether they are the optimum."""
        ...

    def proof(self, check: OptimalityCheck, displacement: Array) -> Certificate:
        """What a point, by its check, or the way that the multiplier went, proves of forces that do not exist."""
        ...


class ConeOnlyProblem(NamedTuple):
    """Problems whose contacts are limited one by one, without limits of joint torques."""

    problem: ScaledProblem

    def with_proximal_term(self, proximal: ProximalTerm) -> ConcaveObjective:
        return DualObjective(self.problem, proximal)

    def check_optimality(self, point: SpatialVec) -> OptimalityCheck:
        return check_optimality(self.problem, point)

    def proof(self, check: OptimalityCheck, displacement: SpatialVec) -> Certificate:
        return find_certificate(self.problem, check.residual, displacement)


def careful_settings(dtype: jnp.dtype) -> PassSettings:
    """The settings of the careful pass, which does all that can be done."""
    yes = jnp.asarray(True)
    last = jnp.asarray(weakest(dtype), dtype)
    return PassSettings(yes, jnp.int32(STEPS_PER_LEVEL), yes, yes, yes, jnp.int32(UNLIMITED_CHECKS), last)


def weakest(dtype: jnp.dtype) -> float:
    """The least strength of a proximal term that makes a difference, unless friction is next to nothing."""
    return 4 * float(jnp.finfo(dtype).eps)


def initial_state(
    point: Array, forces: ContactVec, verdict: Array | Verdict, decided: Array, strength: Array | float = STRONGEST
) -> ProximalState:
    """Before the first step; what is ``decided`` keeps its verdict."""
    # A grasp that many wrenches share has one column; where each problem stands is its own.
    decided = jnp.broadcast_to(decided, point[:1].shape)
    no, none = jnp.zeros_like(decided), jnp.zeros_like(decided, jnp.int32)
    verdict = jnp.where(decided, verdict, Verdict.NOT_CONVERGED) + none
    forces = contact_vec.scale(jnp.ones_like(point[:1]), forces)
    strength = strength + 0 * point[:1]
    return ProximalState(point, forces, verdict, none, no_certificate(point), decided, no, no, 0 * point[:1], strength)


class _Level(NamedTuple):
    """A search, and how far each problem is within its level."""

    search: ProximalState
    newton: NewtonState
    unfinished: Array
    """Whether the pass still has levels to finish for this problem, the present one included."""
    checks: Array
    """So far, of all problems together ``()``."""


def proximal_search(proximal_problem: ProximalProblem, search: ProximalState, settings: PassSettings) -> ProximalState:
    """The optimum of the problems that are not decided, or a proof that there is none."""
    evaluations = jnp.where(settings.careful, STEPS_PER_CHECK, settings.steps)

    def keep_going(level: _Level) -> Array:
        return (level.checks < settings.checks) & ~jnp.all(level.search.decided | ~level.unfinished)

    def go_on(level: _Level) -> _Level:
        search = level.search
        objective = proximal_problem.with_proximal_term(ProximalTerm(search.strength, search.point))
        newton = advance(objective, level.newton, evaluations)
        return _end_levels(proximal_problem, settings, level._replace(newton=newton))

    unfinished = jnp.ones_like(search.decided)
    level = _Level(search, at_start(search.point, search.decided), unfinished, jnp.int32(0))
    level = lax.while_loop(keep_going, go_on, varying_like(level, proximal_problem))
    search = level.search
    good = settings.careful & ~search.decided & ~level.unfinished & search.loosely_optimal
    # An interrupted level is begun again, from the same centre: the way is the same as without interruption.
    interrupted = ~search.decided & level.unfinished
    return search._replace(
        verdict=jnp.where(good, Verdict.OPTIMAL, search.verdict),
        strength=jnp.where(interrupted, search.strength, 0),
    )


@fused_cpu_kernel
def _end_levels(proximal_problem: ProximalProblem, settings: PassSettings, level: _Level) -> _Level:
    """Ask of the problems at the end of a level whether they are solved, or what is left a proof; else the next level
    begins."""
    search, newton = level.search, level.newton
    ended = (
        ~search.decided & level.unfinished & (newton.done | ~settings.careful | (newton.steps >= settings.steps - 1))
    )
    check = proximal_problem.check_optimality(newton.point)

    def unproven(check: OptimalityCheck, displacement: Array) -> Certificate:
        return no_certificate(displacement)

    asked = settings.proves & jnp.any(ended & ~check.optimal)
    certificate = lax.cond(asked, proximal_problem.proof, unproven, check, newton.point - search.point)
    optimal = ended & check.optimal
    infeasible = ended & ~optimal & (certificate.force_bound > 0)
    verdict = jnp.where(optimal, Verdict.OPTIMAL, jnp.where(infeasible, Verdict.INFEASIBLE, Verdict.NOT_CONVERGED))
    decided = search.decided | optimal | infeasible
    strength = jnp.where(ended, search.strength / 10, search.strength)
    unfinished = level.unfinished & ~(ended & (strength < settings.weakest))
    found = ProximalState(
        point=jnp.where(ended, newton.point, search.point),
        forces=contact_vec.where(ended, check.forces, search.forces),
        verdict=jnp.where(ended, verdict, search.verdict),
        steps=search.steps + jnp.where(ended, newton.steps, 0),
        certificate=jax.tree.map(partial(jnp.where, infeasible), certificate, search.certificate),
        decided=decided,
        loosely_optimal=jnp.where(ended, check.loosely_optimal, search.loosely_optimal),
        stalled=jnp.where(ended, newton.stalled, search.stalled),
        relative_residual=jnp.where(ended, check.relative_residual, search.relative_residual),
        strength=strength,
    )
    begun = jax.tree.map(partial(jnp.where, ended), at_start(newton.point, decided | ~unfinished), newton)
    return _Level(found, begun, unfinished, level.checks + 1)
