"""What is asked of a grasp and its wrench, by which method: outputs of sensitivity trajectories."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxgrasp.force.distribution import closed_form, constrained_optimum
from jaxgrasp.force.least_friction import least_friction
from jaxgrasp.force.slip import friction_margin, slip_angle, stability_margin
from jaxgrasp.model.arrays import AnyArray, Bool, Float
from jaxgrasp.model.compared_methods import methods_named
from jaxgrasp.model.grasp import Grasp
from jaxgrasp.model.solution import Solution
from jaxgrasp.numerics.no_derivative import nondifferentiable_where
from jaxgrasp.validation.checked import checked

QUANTITIES: dict[str, Callable[[Grasp, Solution], Array]] = {
    "forces": lambda grasp, solution: solution.forces,
    "slip_angle": lambda grasp, solution: slip_angle(grasp, solution.forces),
    "stability_margin": lambda grasp, solution: stability_margin(grasp, solution.forces),
    "friction_margin": lambda grasp, solution: friction_margin(grasp, solution.forces, solution.moments),
    "objective": lambda grasp, solution: solution.objective,
}


class FrictionReserve(NamedTuple):
    """How much friction a grasp has in reserve."""

    reserve: Float[Array, "*batch"]
    """How many times less friction would do; below 1 the friction does not do, +inf where hardly any is needed."""


@checked
def friction_reserve(grasp: Grasp, wrench: Float[AnyArray, "*batch 6"]) -> FrictionReserve:
    """How many times less friction would do, with the normal forces that the hand means to exert in total.

    What ranks an optimum, whose active contacts have no margin left however much they have in reserve: the inverse of
    [`jaxgrasp.least_friction`][]. Below 1 the friction does not do; +inf where hardly any is needed, and 0 where no
    friction would do. Neither moves with the data; that of 0 has no derivative (NaN).
    """
    share = least_friction(grasp, wrench)
    bounded = (share > 0) & jnp.isfinite(share)
    reserve = jnp.where(bounded, 1 / jnp.where(bounded, share, 1), jnp.where(share > 0, 0, jnp.inf))
    return FrictionReserve(nondifferentiable_where(jnp.isinf(share), reserve, share))


@dataclass(frozen=True)
class Output:
    """Function of (grasp, wrench) that returns one quantity by one method, for any leading axes.

    Equal ones are compiled once.

    Args:
        quantity: ``"forces"`` ``(n, 3)`` [N]; ``"slip_angle"``, ``"stability_margin"`` or ``"friction_margin"``
            ``(n,)`` [rad]; or ``"objective"``, one number, F_2 [N^2] (eq. 5) of A and F_3 [N] (eq. 13) of B.
        method: ``"A"`` or ``"B"`` for the closed form, ``"A-optimum"`` or ``"B-optimum"`` for the constrained optimum
            by the same sharing.

    Raises:
        ValueError: for a quantity or a method that is none.
    """

    quantity: str
    """``forces`` [N], ``slip_angle``, ``stability_margin`` or ``friction_margin`` [rad], or ``objective``."""
    method: str = "B"
    """A or B for the closed form, A-optimum or B-optimum for the constrained optimum by the same sharing."""

    def __post_init__(self):
        if self.quantity not in QUANTITIES:
            raise ValueError(f"quantity {self.quantity!r} is unknown: expected one of {', '.join(QUANTITIES)}")
        methods_named((self.method,))

    def __call__(self, grasp: Grasp, wrench: Float[AnyArray, "*batch 6"]) -> dict[str, Any]:
        """The quantity, by its name."""
        (method,) = methods_named((self.method,))
        solve = constrained_optimum if method.constrained else closed_form
        return {self.quantity: QUANTITIES[self.quantity](grasp, solve(grasp, wrench, method.sharing))}


class SlipAngles(eqx.Module):
    """(grasp, wrench) -> slip angles, for any leading axes; both sharings are one program."""

    by_squeeze: Bool[AnyArray, ""]
    """Whether squeezing forces are the weights, or 1."""
    constrained: bool = eqx.field(static=True)

    @classmethod
    def by(cls, method: str) -> "SlipAngles":
        """Those of a method's forces."""
        (named,) = methods_named((method,))
        return cls(np.asarray(named.sharing == "squeeze"), named.constrained)

    def __call__(self, grasp: Grasp, wrench: Float[AnyArray, "*batch 6"]) -> dict[str, Array]:
        """``slip_angle`` [rad]."""
        squeeze = jnp.asarray(grasp.squeeze)
        weights = jnp.where(self.by_squeeze, squeeze, jnp.ones_like(squeeze))
        solve = constrained_optimum if self.constrained else closed_form
        return {"slip_angle": slip_angle(grasp, solve(grasp, wrench, weights).forces)}
