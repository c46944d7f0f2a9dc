"""Least total normal force with which a grasp holds its load.

Least factor on the squeezing forces for method B alone to hold the load.
"""

import jax
import jax.numpy as jnp
from jax import Array, lax

from jaxgrasp.force.distribution import closed_form, split_forces
from jaxgrasp.model.arguments import check_arguments
from jaxgrasp.model.arrays import AnyArray, Float
from jaxgrasp.model.grasp import Grasp
from jaxgrasp.model.solution import is_balanced, is_held
from jaxgrasp.numerics import vec3
from jaxgrasp.numerics.no_derivative import nan_tangents_where, nondifferentiable_where, refusing
from jaxgrasp.numerics.tiling import over_tiles
from jaxgrasp.numerics.vec3 import Vec3
from jaxgrasp.problem.batch_last import ProblemBatch
from jaxgrasp.problem.flatten import Sharing
from jaxgrasp.solver import reach, transforms
from jaxgrasp.solver.dispatch import dispatch
from jaxgrasp.solver.wrench_boundary import BoundaryPoint, boundary_point, with_unit_weights, work_along

TILE = 32
PROVEN_EXPONENT = 0.38
"""Relative distance of the bounds of a total that count as one, as an exponent of the machine epsilon. Of 8,000 totals
that were compared with ``quality.largest_wrench``, none that passed was wrong; at 0.35 some were."""


def least_squeeze(
    grasp: Grasp, wrench: Float[AnyArray, "*#batch 6"], sharing: Sharing = "squeeze"
) -> Float[Array, "..."]:
    """Compute the least total of normal forces with which forces inside the friction cones exert the wrench.

    How the forces are shared, and how hard the contacts mean to squeeze, matters only for contacts of weight zero,
    which hold their squeezing force; it counts.

    Each total is checked from both sides, to a millionth of itself (2e-3 in single precision): a twist along which the
    wrench does more work than any smaller total can, and forces of that total that exert the wrench. Where the two do
    not meet there is no answer (NaN) rather than one that may be too small.

    Differentiable once, by everything but the sharing: the total moves with the work of the forces and of the wrench
    along the twist that bounds it. Where several twists do, the derivative is that of one.

    Args:
        grasp: contacts ``(..., n)``; leading axes broadcast against the wrench's.
        wrench: what the contacts must exert ``(..., 6)`` [N, N.m].
        sharing: as for [`jaxgrasp.closed_form`][].

    Returns:
        ``(...)`` [N]; +inf where no forces exist, the data are invalid or
        [`jaxgrasp.constrained_optimum`][] did not converge; NaN where the total was not proven. Neither has a
        derivative (NaN).

    Example:
        Two fingers of friction 0.5 lift 2 N: each has to press with 2 N.

        >>> import numpy as np
        >>> from jaxgrasp import Grasp, least_squeeze
        >>> points, normals = np.array([[1.0, 0, 0], [-1.0, 0, 0]]), np.array([[-1.0, 0, 0], [1.0, 0, 0]])
        >>> grasp = Grasp(points, normals, friction=np.full(2, 0.5), squeeze=np.full(2, 4.0))
        >>> round(float(least_squeeze(grasp, np.array([0.0, 0, 2, 0, 0, 0]))), 6)
        4.0

    Raises:
        ValueError: for a sharing that cannot be used, or shapes that do not fit.
        NotImplementedError: when differentiated twice.
    """
    check_arguments(grasp, {"wrench": (wrench, (6,))}, {})
    return dispatch(least_total, grasp, wrench, sharing)


@jax.custom_jvp
def least_total(problem: ProblemBatch) -> Array:
    """Compute the least totals of a flat batch ``(B,)``."""
    return bounded_total(problem)[0]


@least_total.defjvp
def _least_total_tangent(primals, tangents):
    """Differentiate by the envelope theorem: the total - normal.(G f - wrench) is stationary at the least."""
    (problem,), (moved,) = primals, tangents
    total, boundary = bounded_total(problem)
    tangent = total_tangent(problem, moved, total, boundary)
    return total, nan_tangents_where(~jnp.isfinite(total), tangent, problem, moved)


def total_tangent(problem: ProblemBatch, moved: ProblemBatch, total: Array, boundary: BoundaryPoint) -> Array:
    """Compute the tangent of a known total as its problem moves; zero where it is not finite."""

    def lagrangian(problem: ProblemBatch) -> Array:
        return held_total(problem) - work_along(problem, problem.wrench, boundary)

    return jnp.where(jnp.isfinite(total), jax.jvp(lagrangian, (problem,), (moved,))[1], 0)


@jax.custom_jvp
def bounded_total(problem: ProblemBatch) -> tuple[Array, BoundaryPoint]:
    """Compute the least totals ``(B,)`` and the boundary point that bounds each.

    A total is +inf where no forces exist or none were found, NaN where it is not proven to be the least and enough.
    """
    # That forces exist is known first: where none do, they only grow.
    solved = is_held(transforms.optimum()(problem).verdict)
    return over_tiles(_least_of_tile, (problem, solved), problem.size, TILE, problem.count)


bounded_total.defjvp(refusing("least_squeeze and least_friction have first derivatives only"))


def held_total(problem: ProblemBatch) -> Array:
    """Sum the normal forces ``(B,)`` of contacts of weight zero, which hold their squeezing force."""
    fixed = problem.weights <= 0
    if problem.present is not None:
        fixed = fixed & (problem.present > 0.5)
    return jnp.sum(jnp.where(fixed, problem.squeeze, 0), 1)


def _least_of_tile(arguments: tuple[ProblemBatch, Array]) -> tuple[Array, BoundaryPoint]:
    problem, solved = arguments
    unit_weight = with_unit_weights(problem)
    is_feasible = solved[None] & unit_weight.valid
    least, path = reach.least_normal_force(unit_weight, ~is_feasible)
    last, previous = (
        reach.with_normal_cost(unit_weight.data, penalty) for penalty in (path.penalty, path.penalty_before)
    )
    boundary = boundary_point(unit_weight, last, previous, path, jnp.ones_like(path.penalty))
    proven = _is_proven(least, reach.floor(unit_weight, path), path.ceiling)
    total = (unit_weight.scaling.force_unit * jnp.where(proven, least, jnp.nan))[0] + held_total(problem)
    return jnp.where(is_feasible[0], total, jnp.inf), boundary


def _is_proven(total: Array, floor: Array, ceiling: Array) -> Array:
    """Return where the bounds of a total agree with it, and with each other, but for ``PROVEN_EXPONENT``.

    A ceiling below the floor is no proof either: its forces then miss more of the wrench than the multiplier tells.
    """
    eps = float(jnp.finfo(total.dtype).eps)
    allowed = eps**PROVEN_EXPONENT * total + 4 * eps
    return (jnp.abs(total - floor) <= allowed) & (jnp.abs(ceiling - floor) <= allowed)


NOISE = 64
"""Roundings that are nothing."""


def least_squeeze_factor(grasp: Grasp, wrench: Float[AnyArray, "*#batch 6"]) -> Float[Array, "..."]:
    """Compute the least factor on all squeezing forces with which method B's forces lie inside the friction cones.

    Method B's manipulation forces do not depend on the factor, and its squeezing forces grow with it (eq. 16). So each
    contact is inside its cone for the factors of one interval, whose ends are roots of a quadratic.

    Args:
        grasp: contacts ``(..., n)``; leading axes broadcast against the wrench's.
        wrench: what the contacts must exert ``(..., 6)`` [N, N.m].

    Returns:
        ``(...)``, 0 or more; below 1 the hand squeezes harder than it needs. +inf where no factor will do:
        where method B's forces balance nothing (out of range, no squeeze, bad data), too; there is no derivative there
        (NaN).

    Raises:
        ValueError: for soft fingers, or shapes that do not fit.
    """
    split, verdict = split_forces(grasp, wrench), closed_form(grasp, wrench).verdict
    balances = is_balanced(verdict)
    friction, normals = jnp.asarray(grasp.friction), jnp.asarray(grasp.normals)
    if grasp.present is not None:
        present = jnp.asarray(grasp.present) > 0.5
        friction, normals = jnp.where(present, friction, 0), jnp.where(present[..., None], normals, 0)
    inward = vec3.unit(vec3.from_axis(normals, -1))
    # Rounding of larger forces counts as zero: its sign would change the result, without friction its size too.
    # Forces that balance nothing have no derivative; not even zero times it may come in.
    external, internal = (
        jnp.where(balances[..., None, None], forces, 0) for forces in (split.external, split.internal)
    )
    size = jnp.max(jnp.abs(jnp.stack([external, internal])), (0, -2, -1))[..., None]
    noise = NOISE * jnp.finfo(size.dtype).eps * size
    outer, inner = _parts(external, inward, noise), _parts(internal, inward, noise)
    low, high = _interval(*outer, *inner, friction)
    least, most = jnp.maximum(jnp.max(low, -1), 0), jnp.min(high, -1)
    is_held = balances & (least <= most) & jnp.isfinite(least)
    friction = jnp.broadcast_to(friction, (*is_held.shape, friction.shape[-1]))
    return nondifferentiable_where(
        ~is_held, jnp.where(is_held, least, jnp.inf), (split.external, split.internal, friction)
    )


def _parts(forces: Array, normals: Vec3, noise: Array) -> tuple[Vec3, Array]:
    """Split forces into components across and along the normals; components within the noise are zero."""
    force = vec3.from_axis(forces, -1)
    along = vec3.dot(force, normals)
    across = vec3.sub(force, vec3.scale(along, normals))
    # A component that rounds to zero keeps its derivative: only its value is subtracted.
    *tangential, pressed = (
        part - lax.stop_gradient(jnp.where(jnp.abs(part) > noise, 0, part)) for part in (*across, along)
    )
    return Vec3(*tangential), pressed


def _interval(outer: Vec3, outer_press: Array, inner: Vec3, inner_press: Array, friction: Array) -> tuple[Array, Array]:
    """Compute the interval of factors x for which outer + x inner lies in its cone; low above high if empty.

    Across less than friction times along, squared, is a x^2 + 2 b x + c <= 0, a double cone; that outer_press + x
    inner_press is not negative chooses the nappe.
    """
    square = friction * friction
    a = vec3.dot(inner, inner) - square * inner_press * inner_press
    b = vec3.dot(outer, inner) - square * outer_press * inner_press
    c = vec3.dot(outer, outer) - square * outer_press * outer_press
    # Neither root loses its digits where the other is large.
    real = b * b - a * c >= 0
    lead = -b - jnp.where(b >= 0, 1, -1) * vec3.safe_sqrt(jnp.where(real, b * b - a * c, 0))
    # x = (-b -+ sqrt(b^2 - a c)) / a, the other root as c over the numerator of this one.
    first_root, second_root = vec3.safe_divide(lead, a), vec3.safe_divide(c, lead)
    first_root = jnp.where(a == 0, second_root, first_root)
    first, last = jnp.minimum(first_root, second_root), jnp.maximum(first_root, second_root)
    inf = jnp.full_like(a, jnp.inf)
    # Squeezing that leaves its own cone helps for a while at most; squeezing inside it helps in the end.
    within = [jnp.where(real, first, inf), jnp.where(real, last, -inf)]
    beyond = [jnp.where(inner_press > 0, last, -inf), jnp.where(inner_press > 0, inf, first)]
    along = [jnp.where(b < 0, last, -inf), jnp.where(b > 0, first, inf)]
    idle = [jnp.where(c <= 0, -inf, inf), jnp.where(c <= 0, inf, -inf)]
    low, high = (
        jnp.where(a > 0, convex, jnp.where(a < 0, concave, jnp.where(b != 0, linear, constant)))
        for convex, concave, linear, constant in zip(within, beyond, along, idle, strict=True)
    )
    edge = vec3.safe_divide(-outer_press, inner_press)
    never = (inner_press == 0) & (outer_press < 0)
    from_edge = jnp.where(never, inf, jnp.where(inner_press > 0, edge, -inf))
    return jnp.maximum(low, from_edge), jnp.minimum(high, jnp.where(inner_press < 0, edge, inf))
