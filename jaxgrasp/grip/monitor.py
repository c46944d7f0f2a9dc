"""Monitoring of a grasp by the paper's conditions (2) and (3), on closed form and optimum.

The paper applies the closed form and monitors its slip. Where it slips although other forces would hold, the grasp was
given up too early: the two laws disagree, and the result says so.
"""

from enum import IntEnum
from functools import partial
from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array

from jaxgrasp.force.distribution import closed_form_and_optimum
from jaxgrasp.force.slip import spin_force
from jaxgrasp.grip.contact_forces import ContactForces, applied_forces
from jaxgrasp.model.arrays import AnyArray, Float, Int
from jaxgrasp.model.grasp import Grasp
from jaxgrasp.model.solution import Solution, Verdict, is_held
from jaxgrasp.problem.flatten import Sharing, read_sharing
from jaxgrasp.validation.checked import checked

Law = Literal["closed-form", "optimum"]


class Hold(IntEnum):
    """State of the grip on the object. The codes are stable in files."""

    STABLE = 0
    """Every contact obeys (2) and (3), and together they balance the wrench."""
    SLIPPING = 1
    """The applied law breaks a condition, or balances no wrench."""
    LOST = 2
    """No contact is present."""


class Touch(IntEnum):
    """State of a contact under the applied law. The codes are stable in files."""

    HOLDS = 0
    SLIDES = 1
    """Condition (2) is broken: the force leaves the friction cone."""
    PULLS = 2
    """Condition (3) is broken: the force points out of the object."""
    ABSENT = 3


class Assessment(eqx.Module):
    """Assessment of one instant of a grasp, or of a batch of them."""

    closed: Solution
    optimum: Solution
    hold: Int[Array, "*batch"]
    """Code of a [`jaxgrasp.grip.Hold`][], by the applied law."""
    touches: Int[Array, "*batch n"]
    """Codes of a [`jaxgrasp.grip.Touch`][], by the applied law."""
    forces: Float[Array, "*batch n 3"]
    """Contact forces by the applied law, on the object [N]; zero where the object is lost. Where they balance no wrench
    their derivative is zero, as of constant forces."""
    moments: Float[Array, "*batch n"] | None
    """Moments of soft fingers about their normals, likewise [N.m]; None where all contacts are hard."""
    disagrees: Array
    """``(...)`` True where the closed form slips while the optimum shows forces that hold."""

    @property
    def exerted(self) -> ContactForces:
        """Return forces and moments by the applied law."""
        return ContactForces(self.forces, self.moments)


@checked
def monitor(
    grasp: Grasp,
    wrench: Float[AnyArray, "*#batch 6"],
    sharing: Sharing = "squeeze",
    *,
    free: Float[AnyArray, "*#batch 6 k"] | None = None,
    law: Law = "closed-form",
) -> Assessment:
    """Decide whether a grasp is stable, slipping or lost, and which contacts break which condition.

    Args:
        grasp: contacts ``(..., n)``.
        wrench: wrench required of the contacts ``(..., 6)`` [N, N.m].
        sharing: as for [`jaxgrasp.closed_form`][].
        free: motion basis of an object on a guide, as for [`jaxgrasp.closed_form`][].
        law: force law of the hand: the closed form, as in the paper, or the optimum (the default of the
            command ``jaxgrasp grip``). The closed form often slips where other forces would hold.

    Returns:
        An Assessment: state of the grip and of each contact, and whether the two laws disagree.

    Raises:
        ValueError: for an unknown law, or as [`jaxgrasp.closed_form`][] does.
    """
    name, weights = read_sharing(sharing)
    return _monitored(grasp, wrench, weights, free, sharing=name, law=law)


@partial(jax.jit, static_argnames=("sharing", "law"))
def _monitored(
    grasp: Grasp, wrench: AnyArray, weights: AnyArray | None, free: AnyArray | None, *, sharing: str, law: Law
) -> Assessment:
    closed, optimum = closed_form_and_optimum(grasp, wrench, sharing if weights is None else weights, free=free)
    return assess(grasp, closed, optimum, law)


def assess(grasp: Grasp, closed: Solution, optimum: Solution, law: Law) -> Assessment:
    """Combine closed form and optimum of a grasp into an Assessment by the applied law."""
    applied = closed if law == "closed-form" else optimum
    normals = jnp.asarray(grasp.normals)
    is_present = jnp.ones(normals.shape[:-1], bool) if grasp.present is None else jnp.asarray(grasp.present) > 0.5
    # Invalid data do not count as lost: the verdicts say INVALID_DATA.
    is_lost = ~jnp.any(is_present, -1) & (closed.verdict != Verdict.INVALID_DATA)
    is_holding = is_held(applied.verdict)
    exerted = applied_forces(applied)
    state = jnp.where(is_lost, Hold.LOST, jnp.where(is_holding, Hold.STABLE, Hold.SLIPPING))
    return Assessment(
        closed=closed,
        optimum=optimum,
        hold=state.astype(jnp.int32),
        touches=_touches(grasp, applied, is_present, is_holding),
        forces=exerted.forces,
        moments=exerted.moments,
        disagrees=is_held(optimum.verdict) & ~is_held(closed.verdict),
    )


def _touches(grasp: Grasp, applied: Solution, is_present: Array, is_holding: Array) -> Array:
    """Determine the condition that each contact breaks; none in a distribution that holds."""
    forces = applied.forces
    along = jnp.sum(forces * grasp.normals, -1)
    across = jnp.linalg.norm(forces - along[..., None] * grasp.normals, axis=-1)
    spin = spin_force(grasp, applied.moments)
    if spin is not None:
        across = jnp.sqrt(across**2 + spin**2)
    # Eq. 3: f_n >= 0; eq. 2: |f_t| <= mu f_n.
    condition = jnp.where(along < 0, Touch.PULLS, jnp.where(across > grasp.friction * along, Touch.SLIDES, Touch.HOLDS))
    touches = jnp.where(is_holding[..., None], Touch.HOLDS, condition)
    return jnp.where(is_present, touches, Touch.ABSENT).astype(jnp.int32)
