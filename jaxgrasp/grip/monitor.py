"""Whether a grasp holds: the paper's conditions (2) and (3), monitored on closed form and optimum.

The paper applies the closed form and watches whether it slips. Where it does although other forces would hold, the
grasp was given up too early: the two laws disagree, and that is said.
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
from jaxgrasp.grip.slipping import Exerted, applied_forces
from jaxgrasp.model.arrays import AnyArray, Float, Int
from jaxgrasp.model.grasp import Grasp
from jaxgrasp.model.solution import Solution, Verdict, is_held
from jaxgrasp.problem.flatten import Sharing, read_sharing
from jaxgrasp.validation.checked import checked

Law = Literal["closed-form", "optimum"]


class Hold(IntEnum):
    """What becomes of the object. The codes are stable in files."""

    STABLE = 0
    """Every contact obeys (2) and (3), and together they balance the wrench."""
    SLIPPING = 1
    """The applied law breaks a condition, or balances nothing."""
    LOST = 2
    """Nothing touches."""


class Touch(IntEnum):
    """What a contact does under the applied law. The codes are stable in files."""

    HOLDS = 0
    SLIDES = 1
    """Condition (2) is broken: the force leaves the friction cone."""
    PULLS = 2
    """Condition (3) is broken: the force points out of the object."""
    ABSENT = 3


class Assessment(eqx.Module):
    """One instant of a grasp, or a batch of them."""

    closed: Solution
    optimum: Solution
    hold: Int[Array, "*batch"]
    """Code of a [`jaxgrasp.grip.Hold`][], by the applied law."""
    touches: Int[Array, "*batch n"]
    """Codes of a [`jaxgrasp.grip.Touch`][], by the applied law."""
    forces: Float[Array, "*batch n 3"]
    """Contact forces by the applied law, on the object [N]; zero where the object is lost. Where they balance nothing
    their derivative is that of forces that stay as they are."""
    moments: Float[Array, "*batch n"] | None
    """What soft fingers exert about their normals, likewise [N.m]; None where all contacts are hard."""
    disagrees: Array
    """``(...)`` Whether the closed form slips while the optimum shows forces that hold."""

    @property
    def exerted(self) -> Exerted:
        """Forces and moments by the applied law."""
        return Exerted(self.forces, self.moments)


@checked
def monitor(
    grasp: Grasp,
    wrench: Float[AnyArray, "*#batch 6"],
    sharing: Sharing = "squeeze",
    *,
    free: Float[AnyArray, "*#batch 6 k"] | None = None,
    law: Law = "closed-form",
) -> Assessment:
    """Whether a grasp is stable, slipping or lost, and why.

    Args:
        grasp: contacts ``(..., n)``.
        wrench: what the contacts must exert ``(..., 6)`` [N, N.m].
        sharing: as for [`jaxgrasp.closed_form`][].
        free: of an object that a guide holds, the twists left to it, as for [`jaxgrasp.closed_form`][].
        law: which forces the hand applies: the closed form, as in the paper, or the optimum (the default of the
            command ``jaxgrasp grip``). The closed form often slips where other forces would hold.

    Returns:
        An Assessment: what becomes of the object, what each contact does, and whether the two laws disagree.

    Raises:
        ValueError: for another law, or as [`jaxgrasp.closed_form`][] does.
    """
    name, weights = read_sharing(sharing)
    return _assessed(grasp, wrench, weights, free, sharing=name, law=law)


@partial(jax.jit, static_argnames=("sharing", "law"))
def _assessed(
    grasp: Grasp, wrench: AnyArray, weights: AnyArray | None, free: AnyArray | None, *, sharing: str, law: Law
) -> Assessment:
    closed, optimum = closed_form_and_optimum(grasp, wrench, sharing if weights is None else weights, free=free)
    return judged(grasp, closed, optimum, law)


def judged(grasp: Grasp, closed: Solution, optimum: Solution, law: Law) -> Assessment:
    """What both answers say of a grasp."""
    applied = closed if law == "closed-form" else optimum
    normals = jnp.asarray(grasp.normals)
    there = jnp.ones(normals.shape[:-1], bool) if grasp.present is None else jnp.asarray(grasp.present) > 0.5
    # What cannot be told from the data is not lost: the verdicts say INVALID_DATA.
    lost = ~jnp.any(there, -1) & (closed.verdict != Verdict.INVALID_DATA)
    holds = is_held(applied.verdict)
    exerted = applied_forces(applied)
    state = jnp.where(lost, Hold.LOST, jnp.where(holds, Hold.STABLE, Hold.SLIPPING))
    return Assessment(
        closed=closed,
        optimum=optimum,
        hold=state.astype(jnp.int32),
        touches=_touches(grasp, applied, there, holds),
        forces=exerted.forces,
        moments=exerted.moments,
        disagrees=is_held(optimum.verdict) & ~is_held(closed.verdict),
    )


def _touches(grasp: Grasp, applied: Solution, there: Array, holds: Array) -> Array:
    """Which condition each contact breaks; none does in a distribution that was found to hold."""
    forces = applied.forces
    along = jnp.sum(forces * grasp.normals, -1)
    across = jnp.linalg.norm(forces - along[..., None] * grasp.normals, axis=-1)
    spin = spin_force(grasp, applied.moments)
    if spin is not None:
        across = jnp.sqrt(across**2 + spin**2)
    broken = jnp.where(along < 0, Touch.PULLS, jnp.where(across > grasp.friction * along, Touch.SLIDES, Touch.HOLDS))
    touches = jnp.where(holds[..., None], Touch.HOLDS, broken)
    return jnp.where(there, touches, Touch.ABSENT).astype(jnp.int32)
