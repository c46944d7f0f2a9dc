"""A margin of a grasp and its load that is positive exactly where allowed forces exert the load: a reward."""

from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jax.custom_batching import custom_vmap

from jaxgrasp.force.margin import bound_along
from jaxgrasp.force.reachable import closest_of
from jaxgrasp.model.arguments import check_arguments
from jaxgrasp.model.arrays import AnyArray, Float
from jaxgrasp.model.grasp import Grasp
from jaxgrasp.model.solution import Solution, Verdict, is_balanced, is_held
from jaxgrasp.numerics import vec3
from jaxgrasp.numerics.no_derivative import refusing
from jaxgrasp.numerics.tiling import merged, over_chosen
from jaxgrasp.numerics.vec3 import Vec3
from jaxgrasp.problem import contact_vec
from jaxgrasp.problem.batch_last import ContactData, ProblemBatch, to_batch_last_unfused
from jaxgrasp.problem.cone_problem import restrict_to
from jaxgrasp.problem.contact_vec import ContactVec
from jaxgrasp.problem.flatten import Sharing
from jaxgrasp.problem.scaling import Placement, place_contacts
from jaxgrasp.solver import transforms
from jaxgrasp.solver.dispatch import dispatch
from jaxgrasp.solver.wrench_boundary import BoundaryPoint, work_along
from jaxgrasp.validation.checked import checked

TILE = 32
FULL_DEPTH = 0.1
"""Depth inside the reachable wrenches, in units of the contacts' normal forces, beyond which more does not count."""
TEMPERATURE = 0.02
"""Temperature of the smooth minimum over contacts; it lies below the minimum by at most this times log(n)."""
INTERNAL_DEPTH = 1e-3
"""Least depth of the internal forces in their cones that counts as proof that the depth has no end."""
MOST_SQUEEZING = 1e3
"""Largest multiple of the internal forces for which it counts so, in units of ``1 / INTERNAL_DEPTH``."""


@checked
def hold_margin(
    grasp: Grasp, wrench: Float[AnyArray, "*#batch 6"], sharing: Sharing = "squeeze"
) -> Float[Array, "..."]:
    r"""Compute a margin that is positive where forces inside the friction cones exert a wrench, negative elsewhere.

    A number between -1 and 2, without unit. Let u_i = s_i + k_i |w| / sum k be the normal force that squeeze and load
    intend for contact i, with |w| as below. Then

    - **no allowed forces exert the wrench**: minus the distance of the wrench from the reachable ones, divided by sum
      s + |w|. -1: nothing of the load is carried. Lengths are those of [`jaxgrasp.reachable_wrench`][], |w|^2 =
      |force|^2 + |torque|^2 / L^2 about the weighted centroid of the contacts.
    - **some do**: y (2 - y) b. The depth y is the largest share t, from 0 to 1, for which a wrench with t / 10 of the
      normal forces u_i a_i taken away is still reachable: 0 at the limit of what the contacts can exert. The factor
      b = 1 + x, or 1 / (1 - x) for x < 0, is the closed form's: x is the distance of its forces to the surface of their
      cones, in units of u_i, as a smooth minimum over the contacts. Above 1, the closed form's forces lie inside their
      cones. Between 0 and 1, other forces are needed than the squeeze asks for, or the load is near the limit.

    The sign is that of the verdict of [`jaxgrasp.constrained_optimum`][]: held, or INFEASIBLE or NO_CONTACTS. Where
    that is NOT_CONVERGED, the sign of the depth. Zero itself does not occur: at the limit it is the rounding of the
    precision, with the verdict's sign.

    Continuous in the load within the range of the grasp matrix, and in the grasp but where the verdict itself jumps:
    where the rank of the grasp matrix changes (a pinch by two hard fingers resists no torque about its line, however
    small), where a grasp becomes force-closed (it then resists loads that were far out of reach, by forces without
    bound), and where a contact begins or ends to exist (``present``, a weight of zero).

    Differentiable once by the fields of the grasp, the wrench and weights, with a finite gradient everywhere: at the
    limit one of both sides', and along edges of the reachable wrenches of several sides one. Contacts that are absent,
    and friction of zero where the load is out of reach, have a derivative of zero.

    Cost: the closed form, where that lies inside the cones by a tenth of u_i or more; else the constrained optimum.
    Where that does not settle the depth, near the limit of what is reachable, a search along a line as by
    [`jaxgrasp.wrench_margin`][] follows. Works under ``jit``, ``vmap`` and ``grad``.

    Args:
        grasp: contacts ``(..., n)``; leading axes broadcast against the wrench's.
        wrench: what the contacts must exert ``(..., 6)`` [N, N.m].
        sharing: as for [`jaxgrasp.closed_form`][].

    Returns:
        ``(...)``; NaN, with a gradient of zero, where the data are invalid.

    Example:
        Two fingers squeeze a box from its sides and lift it. From one side, both push it away:

        >>> import numpy as np
        >>> from jaxgrasp import Grasp, quality
        >>> points, inward = np.array([[-1.0, 0, 0], [1.0, 0, 0]]), np.array([[1.0, 0, 0], [-1.0, 0, 0]])
        >>> aside, same_side = np.array([[-1.0, 0.5, 0], [-1.0, -0.5, 0]]), np.tile([1.0, 0, 0], (2, 1))
        >>> lift = np.array([0.0, 0, 2, 0, 0, 0])
        >>> pinch = Grasp(points, inward, friction=[0.5, 0.5], squeeze=[4.0, 4.0])
        >>> straddle = Grasp(aside, same_side, friction=[0.5, 0.5], squeeze=[4.0, 4.0])
        >>> [round(float(quality.hold_margin(grasp, lift)), 2) for grasp in (pinch, straddle)]
        [1.17, -0.35]

    Raises:
        ValueError: for a sharing that cannot be used, or shapes that do not fit.
        NotImplementedError: when differentiated twice.
    """
    check_arguments(grasp, {"wrench": (wrench, (6,))}, {})
    return dispatch(_margin, grasp, wrench, sharing)


class _Terms(NamedTuple):
    """Terms of the margins of a flat batch."""

    verdict: Array
    has_closed: Array
    """``(B,)``: whether there is a closed form, with derivatives."""
    room: Array
    """``(B,)``: x, the smooth least distance of the closed form's forces to the surface of their cones."""
    depth: Array
    """``(B,)``: y, not cut off at 0 and 1."""
    boundary: BoundaryPoint
    """Point of the boundary that ends the depth; zeros where none was looked for."""
    forces: Array
    """``(B, n, 3)``: forces that exert the nearest wrench, and their ``moments``."""
    moments: Array | None
    miss: Array
    """``(B,)``: distance to it, over squeeze and load."""


@jax.custom_jvp
def _margin(problem: ProblemBatch) -> Array:
    return _margin_of(_terms(problem))


@_margin.defjvp
def _margin_tangent(primals, tangents):
    """Differentiate each term where it counts; depth and distance by the envelope theorem."""
    (problem,), (moved,) = primals, tangents
    terms = _terms(problem)
    carried = _is_carried(terms)
    inside = carried & (terms.depth > 0) & (terms.depth < 1)
    depth = jnp.where(inside, terms.depth, 0)

    def moving(problem: ProblemBatch) -> tuple[Array, Array, Array]:
        everywhere = _everywhere(problem)
        closed = transforms.closed_form()(restrict_to(everywhere, carried & terms.has_closed))
        shortened = everywhere.wrench + depth[:, None] * _inward(everywhere)
        # The hyperplane n.(G f - w - y d) = 0 bounds what is in reach, with n.d = 1.
        return (
            _room(everywhere, closed),
            work_along(everywhere, shortened, terms.boundary),
            _miss(everywhere, terms.forces, terms.moments),
        )

    _, (room_moved, depth_moved, miss_moved) = jax.jvp(moving, (problem,), (moved,))
    y = jnp.clip(terms.depth, 0, 1)
    by_depth = jnp.where(inside, 2 * (1 - y), 0) * _factor(terms.room) * depth_moved
    by_room = y * (2 - y) * jnp.minimum(_factor(terms.room), 1) ** 2 * room_moved
    is_missed = ~carried & (terms.verdict != Verdict.INVALID_DATA)
    tangent = jnp.where(carried, by_depth + by_room, jnp.where(is_missed, -miss_moved, 0))
    return _margin_of(terms), tangent


def _margin_of(terms: _Terms) -> Array:
    eps = float(jnp.finfo(terms.room.dtype).eps)
    y = jnp.clip(terms.depth, 0, 1)
    positive = jnp.maximum(y * (2 - y) * _factor(terms.room), eps)
    margin = jnp.where(_is_carried(terms), positive, -jnp.maximum(terms.miss, eps))
    return jnp.where(terms.verdict == Verdict.INVALID_DATA, jnp.nan, margin)


def _is_carried(terms: _Terms) -> Array:
    return is_held(terms.verdict) | ((terms.verdict == Verdict.NOT_CONVERGED) & (terms.depth > 0))


def _factor(room: Array) -> Array:
    """Return 1 + x for x >= 0 and 1 / (1 - x) below, whose slopes agree at 0."""
    return jnp.where(room >= 0, 1 + room, 1 / (1 + jnp.abs(room)))


@jax.custom_jvp
def _terms(problem: ProblemBatch) -> _Terms:
    return _flat_terms(problem)


_terms.defjvp(refusing("hold_margin has first derivatives only"))


@custom_vmap
def _flat_terms(problem: ProblemBatch) -> _Terms:
    closed, best = transforms.closed_form_and_optimum()(problem)
    everywhere = _everywhere(problem)
    closest = closest_of(problem, best)
    depth, boundary = _depth(everywhere, closed, best.verdict)
    return _Terms(
        verdict=best.verdict,
        has_closed=is_balanced(closed.verdict) & (closed.verdict != Verdict.FEASIBLE),
        room=_room(everywhere, closed),
        depth=depth,
        boundary=boundary,
        forces=closest.forces,
        moments=closest.moments,
        miss=jnp.where(is_held(best.verdict), 0, _miss(everywhere, closest.forces, closest.moments)),
    )


@_flat_terms.def_vmap
def _mapped_terms(axis_size: int, in_batched, problem: ProblemBatch):
    merged, size = transforms.merge_mapped_axis(axis_size, in_batched[0], problem)
    split = jax.tree.map(lambda x: x.reshape(axis_size, size, *x.shape[1:]), _flat_terms(merged))
    return split, jax.tree.map(lambda _: True, split)


def _everywhere(problem: ProblemBatch) -> ProblemBatch:
    """Return the batch with its own copy of a shared grasp for each problem."""

    def spread(leaf: Array) -> Array:
        return jnp.broadcast_to(leaf, (problem.size, *leaf.shape[1:])) if leaf.ndim else leaf

    return jax.tree.map(spread, problem)


class _Intended(NamedTuple):
    """Contacts ``(n, B)`` with the normal forces that squeeze and load intend for them."""

    data: ContactData
    placement: Placement
    normal_forces: Array
    """``(n, B)`` [N]: u_i, of contacts that can be adjusted; the squeeze of others."""
    total: Array
    """``(1, B)`` [N]: squeeze and load added up."""


def _intended(problem: ProblemBatch) -> _Intended:
    data, _ = to_batch_last_unfused(problem)
    placed, placement = place_contacts(data)
    load = _size(data.force, data.torque, placement)
    # u_i = s_i + k_i / sum k |w|
    normal_forces = data.squeeze + placed.weights * load
    return _Intended(data, placement, normal_forces, jnp.sum(data.squeeze, 0, keepdims=True) + load)


def _size(force: Vec3, torque: Vec3, placement: Placement) -> Array:
    """Return the length of a wrench about the contacts' centroid, in units of force."""
    moved = vec3.scale(1 / placement.length, vec3.sub(torque, vec3.cross(placement.centre, force)))
    # Its derivative at zero is zero, which spatial.length does not have.
    return vec3.safe_sqrt(vec3.dot(force, force) + vec3.dot(moved, moved))


def _inward(problem: ProblemBatch) -> Array:
    """Return the wrench ``(B, 6)`` that takes ``FULL_DEPTH`` of each adjustable contact's normal force away."""
    intended = _intended(problem)
    data = intended.data
    push = jnp.where(data.weights > 0, -FULL_DEPTH * intended.normal_forces, 0)
    force = vec3.scale(push, data.normals)
    return jnp.stack(vec3.totals(*force, *vec3.cross(data.points, force)))[:, 0].T


def _contact_forces(data: ContactData, forces: Array, moments: Array | None) -> tuple[Array, ContactVec]:
    """Return the normal forces ``(n, B)``, and the tangential forces with the moments in units of friction."""
    linear = Vec3(*forces.transpose(2, 1, 0))
    normal_force = vec3.dot(linear, data.normals)
    spin = None if moments is None or data.spin_radius is None else vec3.safe_divide(moments.T, data.spin_radius)
    return normal_force, ContactVec(vec3.sub(linear, vec3.scale(normal_force, data.normals)), spin)


def _room(problem: ProblemBatch, closed: Solution) -> Array:
    """Return x ``(B,)``; 0 where no contact can be adjusted."""
    intended = _intended(problem)
    data = intended.data
    normal_force, tangential = _contact_forces(data, closed.forces, closed.moments)
    mu = data.friction
    # (mu f_n - |f_t|) / sqrt(1 + mu^2), or f_n
    to_surface = jnp.minimum((mu * normal_force - contact_vec.norm(tangential)) / jnp.sqrt(1 + mu**2), normal_force)
    share = vec3.safe_divide(to_surface, intended.normal_forces)
    adjustable = data.weights > 0
    exponent = jnp.where(adjustable, -share / TEMPERATURE, -jnp.inf)
    has_contact = jnp.any(adjustable, 0)
    least = -TEMPERATURE * jax.nn.logsumexp(jnp.where(has_contact, exponent, 0), 0)
    return jnp.where(has_contact, least, 0)


def _depth(problem: ProblemBatch, closed: Solution, verdict: Array) -> tuple[Array, BoundaryPoint]:
    """Return the depths ``(B,)`` and where each ends.

    A depth is 1 or more where the closed form, multiples of the internal forces beside it, or the optimum of a
    shortened load show it. Only for other problems the depth is searched for.
    """
    may_hold = is_held(verdict) | (verdict == Verdict.NOT_CONVERGED)
    unloaded = transforms.closed_form()(replace(problem, wrench=jnp.zeros_like(problem.wrench)))
    closed_depth, internal = _normal_depth(problem, closed), _normal_depth(problem, unloaded)
    # f + t h lies in the cones by depth(f) + t depth(h) or more.
    answered = is_balanced(closed.verdict) & is_balanced(unloaded.verdict)
    has_no_end = answered & (internal >= INTERNAL_DEPTH) & (closed_depth >= -MOST_SQUEEZING)
    is_deep = has_no_end | (is_balanced(closed.verdict) & (closed_depth >= FULL_DEPTH))
    shortened = replace(problem, wrench=problem.wrench + _inward(problem))
    is_deep = is_deep | is_held(transforms.optimum()(restrict_to(shortened, may_hold & ~is_deep)).verdict)
    zeros = BoundaryPoint(
        centre=jnp.zeros_like(problem.points[:, 0]),
        normal=jnp.zeros_like(problem.wrench),
        normal_force=jnp.zeros_like(problem.friction),
        friction_use=jnp.zeros_like(problem.points),
        spin_use=None if problem.torsion is None else jnp.zeros_like(problem.friction),
    )

    def search(problem: ProblemBatch, prior: tuple[Array, BoundaryPoint]) -> tuple[Array, BoundaryPoint]:
        direction = _inward(problem)
        theta, boundary = bound_along(problem, direction)
        # Without squeeze and load nothing can be taken away.
        theta = jnp.where(jnp.any(direction != 0, -1), theta, 0)
        return theta, merged(jnp.isfinite(theta), boundary, prior[1])

    return over_chosen(search, problem, (jnp.ones_like(closed_depth), zeros), may_hold & ~is_deep, TILE)


def _normal_depth(problem: ProblemBatch, solution: Solution) -> Array:
    """Return the largest share of the intended normal forces ``(B,)`` that can be taken off each force in its cone."""
    intended = _intended(problem)
    data = intended.data
    normal_force, tangential = _contact_forces(data, solution.forces, solution.moments)
    needed = contact_vec.norm(tangential) / jnp.where(data.friction > 0, data.friction, 1)
    needed = jnp.where(data.friction > 0, needed, jnp.inf)
    room = vec3.safe_divide(normal_force - needed, intended.normal_forces)
    return jnp.min(jnp.where(data.weights > 0, room, jnp.inf), 0, initial=jnp.inf)


def _miss(problem: ProblemBatch, forces: Array, moments: Array | None) -> Array:
    """Return |w - G f| / (sum s + |w|) ``(B,)``, the forces turning with the normals and growing with friction."""
    intended = _intended(problem)
    data = intended.data
    fixed_data, _ = to_batch_last_unfused(jax.lax.stop_gradient(problem))
    normal_force, tangential = _contact_forces(fixed_data, forces, moments)
    # f_t / (mu f_n), of length 1 at most in spite of rounding
    largest = jnp.maximum(fixed_data.friction * normal_force, contact_vec.norm(tangential))
    use = ContactVec(
        Vec3(*(vec3.safe_divide(c, largest) for c in tangential.linear)),
        None if tangential.spin is None else vec3.safe_divide(tangential.spin, largest),
    )
    normal_force = jnp.where(data.weights > 0, normal_force, data.squeeze)
    across = vec3.sub(use.linear, vec3.scale(vec3.dot(use.linear, data.normals), data.normals))
    drag = jnp.where(data.weights > 0, data.friction * normal_force, 0)
    force = vec3.add(vec3.scale(normal_force, data.normals), vec3.scale(drag, across))
    torque = vec3.cross(data.points, force)
    if use.spin is not None and data.spin_radius is not None:
        torque = vec3.add(torque, vec3.scale(drag * data.spin_radius * use.spin, data.normals))
    sums = vec3.totals(*force, *torque)
    missed = _size(vec3.sub(data.force, Vec3(*sums[:3])), vec3.sub(data.torque, Vec3(*sums[3:])), intended.placement)
    return vec3.safe_divide(missed, intended.total)[0]
