"""The least factor on their friction with which contacts exert a load by a total of normal forces.

    minimise  sigma   subject to   G f = w,   sum of n_i <= 1,   |(t_i / mu_i, sigma m_i / gamma_i)| <= sigma n_i

for forces of normal parts n, tangential parts t and, of soft fingers, moments m, in units of the total.

An answer proves itself. Forces that balance the load, inside the cones of some factor, show that the least is no more.
And a twist lambda with w.lambda = 1 bounds it from below: no forces of that total do as much work along it, unless some
contact's v_n + sigma mu |v_t| reaches 1, by the velocities v that it gives to the contacts.
"""

from functools import reduce
from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from jaxgrasp.numerics import quasiconvex, vec3
from jaxgrasp.numerics.fused_cpu_kernel import fused_cpu_kernel
from jaxgrasp.numerics.quasiconvex import InteriorPoint, QuasiconvexProgram, Rows
from jaxgrasp.numerics.vec3 import Vec3
from jaxgrasp.problem.batch_last import ContactData
from jaxgrasp.problem.coordinates import ScaledAxes
from jaxgrasp.solver.dual import DualProblem

LARGEST_FACTOR = 1e4
"""Shares beyond this, or below its inverse, are not looked for."""
HEAVY = 10.0
"""How many times as large a factor a search begins with for loads as large as the total: larger than the answers mostly
are, since a factor that has to grow leads along the surfaces of cones."""
BALANCE_EXPONENT = 0.4
"""By how much forces may miss their load beside it, as an exponent of the machine epsilon."""
GAP_EXPONENT = 0.6
"""How far apart the bounds of a factor may be, relative to it, as an exponent of the machine epsilon."""


class FrictionFactor(NamedTuple):
    """The least factor with its bounds, ``(B,)`` each."""

    factor: Array
    lower: Array
    """A factor that was proven to be no more than enough."""
    proven: Array
    """Whether both are one but for rounding, or beyond what is looked for."""
    spent: Array
    """Whether the total is what holds the factor; else less friction would balance the load by no forces at all."""


def least_friction_factor(problem: DualProblem, total: Array, frozen: Array, first: Array) -> FrictionFactor:
    """Find the least factors of problems ``with_unit_weights``, whose normal forces may total ``total (1, B)`` > 0.

    Problems that are ``frozen (1, B)`` are left out. The search begins with a factor of ``first``, for small loads.
    """
    assert isinstance(problem.coordinates, ScaledAxes)
    program = _program(problem.data, problem.coordinates, total)
    state = quasiconvex.minimise(program, _start(program, frozen, first), _is_proven)
    return _to_factor(program, state)


@fused_cpu_kernel
def _program(data: ContactData, coordinates: ScaledAxes, total: Array) -> QuasiconvexProgram:
    present = (data.weights > 0).astype(data.friction.dtype)
    zero = jnp.zeros_like(present)
    first, second = _tangents(data.normals)

    def rows(direction: Vec3, size: Array) -> Rows:
        linear = vec3.scale(size, direction)
        return [*linear, *vec3.times(coordinates.scales, vec3.cross(data.points, linear))]

    grown = [[*rows(data.normals, present), -present]]
    if data.spin_radius is not None:
        turning = vec3.scale(present * data.friction * data.spin_radius, data.normals)
        grown.append([zero, zero, zero, *vec3.times(coordinates.scales, turning), zero])
    plain = [[*rows(tangent, present * data.friction), zero] for tangent in (first, second)]
    load = coordinates.wrench(data.force, data.torque) / total
    return QuasiconvexProgram(grown, plain, jnp.concatenate([load, -jnp.ones_like(total)]), present)


def _tangents(normal: Vec3) -> tuple[Vec3, Vec3]:
    """Two unit vectors across unit normals (Duff and others, "Building an orthonormal basis, revisited", 2017)."""
    sign = jnp.where(normal.z < 0, -1, 1).astype(normal.z.dtype)
    a = -1 / (sign + normal.z)
    b = normal.x * normal.y * a
    first = Vec3(1 + sign * normal.x**2 * a, sign * b, -sign * normal.x)
    return first, Vec3(b, sign + normal.y**2 * a, -normal.y)


@fused_cpu_kernel
def _start(program: QuasiconvexProgram, frozen: Array, first: Array) -> InteriorPoint:
    """Return the central point of no load."""
    # A grasp that many wrenches share has one column; where each problem stands is its own.
    zeros = jnp.zeros_like(frozen, program.right.dtype)
    count = zeros + jnp.sum(program.present, 0, keepdims=True)
    share = 1 / (count + 1)
    size = jnp.sqrt(jnp.sum(program.right[:6] ** 2, 0, keepdims=True))
    first = first * jnp.maximum(1, HEAVY * size)
    share, zero = 0 * program.present + share, 0 * program.present + zeros
    grown, plain = [share] + [zero] * (len(program.grown) - 1), [zero] * len(program.plain)
    price = (count + 1) / jnp.maximum(count, 1)
    return InteriorPoint(
        parameter=first,
        entries=grown + plain,
        slack=[first * x for x in grown] + plain,
        duals=[zero + price] + [zero] * (len(grown) - 1) + plain,
        twist=jnp.zeros_like(program.right[:6]) + zeros,
        spare=1 / (count + 1),
        prices=first * price,
        base=first,
        reference=grown,
        gap=zeros + jnp.inf,
        owed=zeros,
        residual=zeros + jnp.inf,
        steps=jnp.zeros_like(frozen, jnp.int32),
        done=frozen,
    )


@fused_cpu_kernel
def _to_factor(program: QuasiconvexProgram, state: InteriorPoint) -> FrictionFactor:
    # The one of the total's two parts that vanishes is next to nothing beside the other.
    spent = state.spare * state.parameter <= state.prices
    parts = state.parameter + state.owed, _lower(program, state), _is_proven(program, state), spent
    return FrictionFactor(*(part[0] for part in parts))


def _is_proven(program: QuasiconvexProgram, state: InteriorPoint) -> Array:
    eps = float(jnp.finfo(state.parameter.dtype).eps)
    lower, upper = _lower(program, state), state.parameter + state.owed
    # What is owed is known to first order: what is left of it is a square.
    balanced = (
        jnp.maximum(jnp.abs(state.owed), state.residual * state.parameter) <= eps**BALANCE_EXPONENT * state.parameter
    )
    is_narrow = (jnp.abs(upper - lower) <= eps**GAP_EXPONENT * upper) | (upper <= 1 / LARGEST_FACTOR)
    return (balanced & is_narrow) | (lower >= LARGEST_FACTOR)


def _lower(program: QuasiconvexProgram, state: InteriorPoint) -> Array:
    """Return the lower bound on the factor that the twist proves."""
    twist = [state.twist[i : i + 1] for i in range(6)]
    work = sum(t * program.right[i : i + 1] for i, t in enumerate(twist))
    along, *spins = (_power(rows, twist) for rows in program.grown)
    across = [_power(rows, twist) for rows in program.plain]
    lead = work - along
    spin = jnp.abs(spins[0]) if spins else jnp.zeros_like(lead)
    slide = vec3.safe_sqrt(across[0] ** 2 + across[1] ** 2)
    # A contact can do the work where (factor slide)^2 + spin^2 >= lead^2.
    room = jnp.sqrt(jnp.maximum((lead - spin) * (lead + spin), 0))
    factor = jnp.where(slide > 0, room / jnp.where(slide > 0, slide, 1), jnp.inf)
    factor = jnp.where(program.present > 0, jnp.where(lead >= spin, factor, 0), jnp.inf)
    return jnp.where(work > 0, jnp.min(factor, 0, keepdims=True), 0)


def _power(rows: Rows, twist: list[Array]) -> Array:
    """Power of a unit of force along a twist, the total left out."""
    return reduce(jnp.add, (r * t for r, t in zip(rows, twist, strict=False)))
