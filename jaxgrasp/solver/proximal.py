"""The robust optimum: a proximal term makes the dual strongly concave, and shrinks stage by stage (continuation).

At each stage the term holds the multiplier near that of the stage before, so that Newton's method starts close to its
goal however degenerate the cones are. Where no forces exist the multiplier runs off instead, and the residual tends to
the shortest wrench out of reach: the proof. Source: the proximal point algorithm, Rockafellar 1976.

With a strength of zero, and one stage, the same code is Newton's method on the dual itself: the Newton phases.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, lax

from jaxgrasp.numerics.fused_cpu_kernel import fused_cpu_kernel
from jaxgrasp.numerics.iterate import iterate, varying_like
from jaxgrasp.problem import contact_vec
from jaxgrasp.problem.contact_vec import ContactVec
from jaxgrasp.solver.newton import ConcaveObjective, LineSearchNewton, NewtonState, ProximalTerm
from jaxgrasp.solver.optimality import OptimalityCheck
from jaxgrasp.solver.result import Certificate, no_certificate

FIRST_STRENGTH = 1e-2
NEAR_STRENGTH = 1e-4
"""Strength of the first stage where the Newton phases came near."""
STEPS_PER_STAGE = 40
STEPS_PER_CHECK = 3
"""Evaluations after which the robust search checks which problems have reached the end of their stage. Each goes
through the stages by itself, so that few of a tile wait for others; a check costs about two evaluations."""
UNLIMITED_CHECKS = 2**30


class ProximalState(NamedTuple):
    """State of the search in each problem; masks and numbers ``(1, B)``."""

    point: Array
    """Multiplier ``(k, B)``."""
    forces: ContactVec
    optimal: Array
    infeasible: Array
    """Proven by the certificate."""
    steps: Array
    certificate: Certificate
    """With as many rows as the point."""
    decided: Array
    """Optimal, infeasible, or left out of the search."""
    loosely_optimal: Array
    """The point is the optimum within ``LOOSE_FACTOR`` times the tolerances."""
    stalled: Array
    """Newton's method was unable to move on."""
    relative_residual: Array
    """Size of w - G f relative to the load."""
    strength: Array
    """Strength of the proximal term where the search goes on; 0 where it has ended."""


class PhaseSettings(NamedTuple):
    """Settings of one phase as scalars, so that all phases are one compiled program."""

    is_robust: Array
    """Stage by stage, with a proximal term; else the dual without it, once."""
    steps: Array
    """Evaluations at each stage."""
    proves: Array
    """Look for proofs of infeasibility, which the displacement of the multiplier gives once it is large enough."""
    with_squeeze: Array
    """The user's objective; else no squeeze and equal sharing, which asks only whether allowed forces exist."""
    restarts: Array
    """Start anew, whatever the last phase found; else where it stopped."""
    checks: Array
    """Checks for problems at the end of a stage, before the unfinished problems are gathered again."""
    min_proximal_weight: Array
    """Strength of the proximal term below which there are no more stages."""


def robust_settings(dtype: jnp.dtype) -> PhaseSettings:
    """Return the settings of a robust phase without limits on its work."""
    yes = jnp.asarray(True)
    last = jnp.asarray(min_proximal_weight(dtype), dtype)
    return PhaseSettings(yes, jnp.int32(STEPS_PER_STAGE), yes, yes, yes, jnp.int32(UNLIMITED_CHECKS), last)


def min_proximal_weight(dtype: jnp.dtype) -> float:
    """Return the least strength of a proximal term that makes a difference, unless friction is next to nothing."""
    return 4 * float(jnp.finfo(dtype).eps)


def initial_state(
    point: Array, forces: ContactVec, infeasible: Array, frozen: Array, strength: Array | float = FIRST_STRENGTH
) -> ProximalState:
    """Return the state before the first step; ``frozen`` problems stay as they are."""
    # A grasp that many wrenches share has one column; each problem has its own multiplier.
    frozen = jnp.broadcast_to(frozen, point[:1].shape)
    no = jnp.zeros_like(frozen)
    forces = contact_vec.scale(jnp.ones_like(point[:1]), forces)
    return ProximalState(
        point=point,
        forces=forces,
        optimal=no,
        infeasible=frozen & infeasible,
        steps=jnp.zeros_like(frozen, jnp.int32),
        certificate=no_certificate(point),
        decided=frozen,
        loosely_optimal=no,
        stalled=no,
        relative_residual=0 * point[:1],
        strength=strength + 0 * point[:1],
    )


class _StageState(NamedTuple):
    """State of the search, and of Newton's method within each problem's stage."""

    search: ProximalState
    newton: NewtonState
    unfinished: Array
    """The phase still has stages to finish for this problem, the present one included."""


class _Continuation(NamedTuple):
    """The stages of the proximal term, as a ``Method`` of ``numerics/iterate.py``."""

    objective: ConcaveObjective
    settings: PhaseSettings

    @staticmethod
    def init(search: ProximalState) -> _StageState:
        newton = LineSearchNewton.init(search.point, search.decided)
        return _StageState(search, newton, jnp.ones_like(search.decided))

    def step(self, state: _StageState) -> _StageState:
        """Take some Newton steps in each problem's stage, then begin the next stage where one has ended."""
        search = state.search
        # q(x) - rho / 2 |x - c|^2, with c where the last stage ended.
        proximal = ProximalTerm(search.strength, search.point)
        method = LineSearchNewton(self.objective.with_proximal_term(proximal))
        evaluations = jnp.where(self.settings.is_robust, STEPS_PER_CHECK, self.settings.steps)
        newton = iterate(method, state.newton, evaluations)
        return _end_stages(self.objective, self.settings, state._replace(newton=newton))

    def terminate(self, state: _StageState) -> Array:
        return state.search.decided | ~state.unfinished


def proximal_search(objective: ConcaveObjective, search: ProximalState, settings: PhaseSettings) -> ProximalState:
    """Return the optimum of the problems that are not decided, or a proof that there is none."""
    method = _Continuation(objective, settings)
    state = iterate(method, varying_like(method.init(search), objective), settings.checks)
    search = state.search
    accepted = settings.is_robust & ~search.decided & ~state.unfinished & search.loosely_optimal
    # An interrupted stage is begun again, from the same centre: the iterates are the same as without interruption.
    interrupted = ~search.decided & state.unfinished
    return search._replace(
        optimal=search.optimal | accepted,
        strength=jnp.where(interrupted, search.strength, 0),
    )


@fused_cpu_kernel
def _end_stages(objective: ConcaveObjective, settings: PhaseSettings, state: _StageState) -> _StageState:
    """Check the problems at the end of a stage for optimality and infeasibility; else begin their next stage."""
    search, newton = state.search, state.newton
    ended = (
        ~search.decided & state.unfinished & (newton.done | ~settings.is_robust | (newton.steps >= settings.steps - 1))
    )
    check = objective.check_optimality(newton.point)

    def no_proof(check: OptimalityCheck, displacement: Array) -> Certificate:
        return no_certificate(displacement)

    needs_proof = settings.proves & jnp.any(ended & ~check.optimal)
    certificate = lax.cond(needs_proof, objective.find_certificate, no_proof, check, newton.point - search.point)
    optimal = ended & check.optimal
    infeasible = ended & ~optimal & (certificate.force_bound > 0)
    decided = search.decided | optimal | infeasible
    strength = jnp.where(ended, search.strength / 10, search.strength)
    unfinished = state.unfinished & ~(ended & (strength < settings.min_proximal_weight))
    search = ProximalState(
        point=jnp.where(ended, newton.point, search.point),
        forces=contact_vec.where(ended, check.forces, search.forces),
        optimal=search.optimal | optimal,
        infeasible=search.infeasible | infeasible,
        steps=search.steps + jnp.where(ended, newton.steps, 0),
        certificate=jax.tree.map(partial(jnp.where, infeasible), certificate, search.certificate),
        decided=decided,
        loosely_optimal=jnp.where(ended, check.loosely_optimal, search.loosely_optimal),
        stalled=jnp.where(ended, newton.stalled, search.stalled),
        relative_residual=jnp.where(ended, check.relative_residual, search.relative_residual),
        strength=strength,
    )
    next_stage = LineSearchNewton.init(newton.point, decided | ~unfinished)
    newton = jax.tree.map(partial(jnp.where, ended), next_stage, newton)
    return _StageState(search, newton, unfinished)
