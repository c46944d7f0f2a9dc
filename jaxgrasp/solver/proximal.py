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
from jaxgrasp.solver import dual
from jaxgrasp.solver.infeasibility import find_certificate
from jaxgrasp.solver.newton import (
    ConcaveObjective,
    DualObjective,
    NewtonState,
    OptimalityCheck,
    ProximalTerm,
    check_optimality,
    maximise,
)
from jaxgrasp.solver.result import Certificate, no_certificate

STRONGEST = 1e-2
STEPS_PER_LEVEL = 40


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
    missed: Array
    """The part of the load that the forces miss."""


class PassSettings(NamedTuple):
    """How one pass works, in scalars, so that all passes are one compiled code."""

    careful: Array
    """Level by level; else the dual as it is, once."""
    steps: Array
    """Evaluations at each level."""
    proves: Array
    """With proofs that no forces exist, which the way of the multiplier gives once it has run far enough."""
    squeezed: Array
    """The problem as it is; else without squeezing and with equal sharing, which asks only for allowed forces."""


@runtime_checkable
class ProximalProblem(Protocol):
    """What the search needs of a problem: an objective, a check of optimality, and proofs."""

    def with_proximal_term(self, proximal: ProximalTerm) -> ConcaveObjective:
        """The objective with a proximal term."""
        ...

    def check_optimality(self, point: Array) -> OptimalityCheck:
        """The forces of a point, and whether they are the optimum."""
        ...

    def proof(self, point: Array, before: Array) -> Certificate:
        """What a point, or the way to it, proves of forces that do not exist."""
        ...


class UnlimitedProblem(NamedTuple):
    """Problems without limits that tie their contacts together."""

    problem: ScaledProblem

    def with_proximal_term(self, proximal: ProximalTerm) -> ConcaveObjective:
        return DualObjective(self.problem, proximal)

    def check_optimality(self, point: SpatialVec) -> OptimalityCheck:
        return check_optimality(self.problem, point)

    def proof(self, point: SpatialVec, before: SpatialVec) -> Certificate:
        forces = dual.candidate_forces(self.problem, point).forces
        return find_certificate(self.problem, dual.residual(self.problem, forces), point - before)


def careful_settings() -> PassSettings:
    """The settings of the careful pass, which does all that can be done."""
    return PassSettings(jnp.asarray(True), jnp.int32(STEPS_PER_LEVEL), jnp.asarray(True), jnp.asarray(True))


def initial_state(point: Array, forces: ContactVec, verdict: Array | Verdict, decided: Array) -> ProximalState:
    """Before the first step; what is ``decided`` keeps its verdict."""
    # A grasp that many wrenches share has one column; where each problem stands is its own.
    decided = jnp.broadcast_to(decided, point[:1].shape)
    no, none = jnp.zeros_like(decided), jnp.zeros_like(decided, jnp.int32)
    verdict = jnp.where(decided, verdict, Verdict.NOT_CONVERGED) + none
    forces = contact_vec.scale(jnp.ones_like(point[:1]), forces)
    return ProximalState(point, forces, verdict, none, no_certificate(point), decided, no, no, 0 * point[:1])


def proximal_search(proximal_problem: ProximalProblem, search: ProximalState, settings: PassSettings) -> ProximalState:
    """The optimum of the problems that are not decided, or a proof that there is none."""
    weakest = 4 * float(jnp.finfo(search.point.dtype).eps)

    def unfinished(carry):
        strength, first, search = carry
        return (first | (strength >= weakest)) & ~jnp.all(search.decided)

    def one_level(carry):
        """Maximise, then ask whether the point is the optimum, or what is left a proof."""
        strength, _, search = carry
        objective = proximal_problem.with_proximal_term(ProximalTerm(strength, search.point))
        reached = maximise(objective, search.point, search.decided, settings.steps)
        return strength / 10, jnp.asarray(False), _decide(proximal_problem, settings, search, reached)

    strongest = jnp.where(settings.careful, STRONGEST, 0).astype(search.point.dtype)
    search = varying_like(search, proximal_problem)
    *_, search = lax.while_loop(unfinished, one_level, (strongest, jnp.asarray(True), search))
    good = settings.careful & ~search.decided & search.loosely_optimal
    return search._replace(verdict=jnp.where(good, Verdict.OPTIMAL, search.verdict))


@fused_cpu_kernel
def _decide(
    proximal_problem: ProximalProblem, settings: PassSettings, search: ProximalState, reached: NewtonState
) -> ProximalState:
    forces, optimal, loosely_optimal, missed = proximal_problem.check_optimality(reached.point)

    def unproven(point: Array, before: Array) -> Certificate:
        return no_certificate(point)

    asked = settings.proves & jnp.any(~(search.decided | optimal))
    certificate = lax.cond(asked, proximal_problem.proof, unproven, reached.point, search.point)
    infeasible = ~optimal & (certificate.force > 0)
    open_ = ~search.decided
    verdict = jnp.where(optimal, Verdict.OPTIMAL, jnp.where(infeasible, Verdict.INFEASIBLE, Verdict.NOT_CONVERGED))
    return ProximalState(
        point=jnp.where(open_, reached.point, search.point),
        forces=contact_vec.where(open_, forces, search.forces),
        verdict=jnp.where(open_, verdict, search.verdict),
        steps=search.steps + jnp.where(open_, reached.steps, 0),
        certificate=jax.tree.map(partial(jnp.where, open_ & infeasible), certificate, search.certificate),
        decided=search.decided | optimal | infeasible,
        loosely_optimal=jnp.where(open_, loosely_optimal, search.loosely_optimal),
        stalled=jnp.where(open_, reached.stalled, search.stalled),
        missed=jnp.where(open_, missed, search.missed),
    )
