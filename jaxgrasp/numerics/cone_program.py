"""Small cone programs, a batch at a time, by a primal-dual interior-point method.

    minimise  x.P x / 2 + c.x   subject to   A x = b   and   h - G x in a product of second-order cones,

each cone {(t, u): |u| <= t}, of one dimension the nonnegative numbers. A cone may give like a spring: then
h - G x + R z is in it, z its dual, at the price z.R z / 2. Nesterov and Todd's scaling makes both sides
one; Mehrotra's corrector follows his predictor (Andersen, Dahl and Vandenberghe, "Interior-point methods for
large-scale cone programming", 2011). Programs should be feasible, of order one, and bounded in the directions that
cost nothing.
"""

from typing import NamedTuple, TypeVar

import jax
import jax.numpy as jnp
from jax import Array, lax

from jaxgrasp.numerics.iterate import varying_like
from jaxgrasp.numerics.tiling import beside, merged

Parts = TypeVar("Parts")
STEPS = 60
NEAR = 0.995
"""Part of the way to the cones' surface that a step may go."""
GAP_EXPONENT = 0.6
"""The gap asked for, as an exponent of the machine epsilon."""
REFINED = 2
"""Times that a step's equations are solved again for what they leave."""
SHORTEST = 1e-7
"""A step so short is none."""
HALVED = 4
"""Times that a step is halved which rounding would lead out of its cones."""


class Cones(NamedTuple):
    """Second-order cones of one dimension."""

    rows: Array
    """G ``(B, m, d, k)``."""
    offset: Array
    """h ``(B, m, d)``."""
    giving: Array | None = None
    """``(B, m)``: the first entry of R of each cone, whose other entries are 0; all cones are rigid where not given."""


class ConeProgram(NamedTuple):
    """A batch of programs in k variables with e equations."""

    quadratic: Array
    """P ``(B, k, k)``, positive semidefinite."""
    linear: Array
    """c ``(B, k)``."""
    equations: Array
    """A ``(B, e, k)``; rows may depend on each other, or be zero."""
    right: Array
    """b ``(B, e)``."""
    cones: tuple[Cones, ...]


class ConeOptimum(NamedTuple):
    """State of each program, strictly inside its cones."""

    point: Array
    """x ``(B, k)``."""
    equality: Array
    """y ``(B, e)``: P x + c + A^T y + sum of G^T z = 0."""
    slack: tuple[Array, ...]
    """s = h - G x + R z ``(B, m, d)`` of each kind of cones."""
    duals: tuple[Array, ...]
    """z ``(B, m, d)`` likewise."""
    gap: Array
    """``(B,)``: sum of s.z."""
    error: Array
    """``(B,)``: largest entry of what these equations leave, and those of the program."""
    residual: Array
    """``(B,)``: likewise of the program's alone."""
    steps: Array
    solved: Array
    """Whether gap and error are as small as rounding lets them be told."""


MOVING = ("point", "equality", "slack", "duals")


class _Scaling(NamedTuple):
    """W of one kind of cones, with W z = W^-1 s."""

    unit: Array
    """``(B, m, d)``: of determinant one."""
    size: Array
    """``(B, m, 1)``."""
    middle: Array
    """W z ``(B, m, d)``."""


class _Softness(NamedTuple):
    """W^-1 R W^-1 of one kind of cones that give: r w w^T."""

    along: Array
    """w = W^-1 e_1 ``(B, m, d)``."""
    giving: Array
    """r ``(B, m, 1)``."""


class _Move(NamedTuple):
    point: Array
    equality: Array
    slack: list[Array]
    """W^-1 ds."""
    duals: list[Array]
    """W dz."""


def solve(program: ConeProgram) -> ConeOptimum:
    """Solve each program; where it is not ``solved``, return the best iterate."""
    size = program.right.shape[:1]
    start = _with_residual(program, _start(program), jnp.zeros(size, jnp.int32))

    def unfinished(carry):
        count, _, _, over = carry
        return (count < STEPS) & ~jnp.all(over)

    def advance(carry):
        count, current, best, over = carry
        moved, length = _advance(program, current)
        candidate = _with_residual(program, moved, current.steps + 1)
        sound = jnp.isfinite(candidate.gap + candidate.error) & _inside(candidate)
        best = merged(~over & sound & (_merit(candidate) < _merit(best)), candidate, best)
        current = merged(~over & sound, candidate, current)
        return count + 1, current, best, over | ~sound | candidate.solved | (length < SHORTEST)

    start = varying_like(start, program)
    carry = (jnp.int32(0), start, start, start.solved)
    return lax.while_loop(unfinished, advance, carry)[2]


def _merit(iterate: ConeOptimum) -> Array:
    return jnp.maximum(iterate.gap, iterate.error)


def _with_residual(program: ConeProgram, iterate: ConeOptimum, steps: Array) -> ConeOptimum:
    """With gap and errors of where it stands."""
    dual, equal, *cones = _residuals(program, iterate)
    residual = jnp.zeros_like(dual[:, 0])
    for left in (equal, *cones):
        residual = jnp.maximum(residual, jnp.max(jnp.abs(left), tuple(range(1, left.ndim)), initial=0))
    error = jnp.maximum(residual, jnp.max(jnp.abs(dual), -1))
    gap = jnp.zeros_like(error)
    for s, z in zip(iterate.slack, iterate.duals, strict=True):
        gap = gap + jnp.sum(s * z, (1, 2))
    worth = (
        jnp.abs(_dot(program.linear, iterate.point)) + _dot(iterate.point, _times(program.quadratic, iterate.point)) / 2
    )
    for kind, z in zip(program.cones, iterate.duals, strict=True):
        worth = worth + jnp.sum(_injected(kind, z) * z, (1, 2)) / 2
    close = float(jnp.finfo(gap.dtype).eps) ** GAP_EXPONENT
    solved = (gap <= close * worth) & (error <= close)
    return iterate._replace(gap=gap, error=error, residual=residual, steps=steps, solved=solved)


def _residuals(program: ConeProgram, iterate: ConeOptimum) -> list[Array]:
    """Return the residuals of stationarity, of the equations, and of each kind of cones."""
    dual = _times(program.quadratic, iterate.point) + program.linear + _pulled(program.equations, iterate.equality)
    for cones, z in zip(program.cones, iterate.duals, strict=True):
        dual = dual + _back(cones, z)
    beyond = [
        s + _scaled_by(cones, iterate.point) - _injected(cones, z) - cones.offset
        for cones, s, z in zip(program.cones, iterate.slack, iterate.duals, strict=True)
    ]
    return [dual, _times(program.equations, iterate.point) - program.right, *beyond]


def _start(program: ConeProgram) -> ConeOptimum:
    """Return the least-squares solutions with unit scaling, moved into the cones."""
    identities = [_identity(cones.offset) for cones in program.cones]
    scalings = [_Scaling(identity, identity[..., :1], identity) for identity in identities]
    zero = jnp.zeros_like(program.right[:, 0])
    system = _system(program, scalings)
    offsets = [cones.offset for cones in program.cones]
    point, equality, cone_parts = system.solve(-program.linear, program.right, offsets)
    slack = [_into(-z, identity) for z, identity in zip(cone_parts, identities, strict=True)]
    duals = [_into(z, identity) for z, identity in zip(cone_parts, identities, strict=True)]
    return ConeOptimum(
        point,
        equality,
        tuple(slack),
        tuple(duals),
        zero,
        zero,
        zero,
        zero.astype(jnp.int32),
        jnp.zeros_like(zero, bool),
    )


def _into(vector: Array, identity: Array) -> Array:
    """Move a vector along the cone's axis into its interior."""
    short = jnp.max(_length(vector[..., 1:]) - vector[..., :1], (1, 2), keepdims=True)
    return jnp.where(short < 0, vector, vector + (1 + jnp.maximum(short, 0)) * identity)


def _advance(program: ConeProgram, iterate: ConeOptimum) -> tuple[ConeOptimum, Array]:
    """Predictor and corrector; the length of the step."""
    scalings = [_scaling(s, z) for s, z in zip(iterate.slack, iterate.duals, strict=True)]
    system = _system(program, scalings)
    dual, equal, *cones = _residuals(program, iterate)
    degree = sum(s.shape[1] for s in iterate.slack)
    mean = iterate.gap / degree

    def move(aim: list[Array]) -> _Move:
        """Towards lambda o lambda = -aim, in the scaled cones."""
        targets = [_divide(s.middle, a) for s, a in zip(scalings, aim, strict=True)]
        right = [_scaled(s, u) - left for s, u, left in zip(scalings, targets, cones, strict=True)]
        point, equality, duals = system.solve(-dual, -equal, right)
        slack = [-u - z for u, z in zip(targets, duals, strict=True)]
        return _Move(point, equality, slack, duals)

    squares = [_product(s.middle, s.middle) for s in scalings]
    foreseen = move(squares)
    centring = (1 - _reach(scalings, foreseen)) ** 3
    corrected = [
        square + _product(ds, dz) - (centring * mean)[:, None, None] * _identity(square)
        for square, ds, dz in zip(squares, foreseen.slack, foreseen.duals, strict=True)
    ]
    step = move(corrected)
    length = jnp.minimum(1, NEAR * _reach(scalings, step))
    # Not by their scaled moves, whose rounding the equations would see.
    duals = [_unscaled(w, dz) for w, dz in zip(scalings, step.duals, strict=True)]
    slack = [
        _injected(c, dz) - left - _scaled_by(c, step.point)
        for left, c, dz in zip(cones, program.cones, duals, strict=True)
    ]
    full_step = iterate._replace(point=step.point, equality=step.equality, slack=tuple(slack), duals=tuple(duals))
    for _ in range(HALVED):
        length = jnp.where(_inside(_moved(iterate, full_step, length)), length, length / 2)
    return _moved(iterate, full_step, length), length


def _moved(iterate: ConeOptimum, step: ConeOptimum, length: Array) -> ConeOptimum:
    def move(x: Array, dx: Array) -> Array:
        return x + beside(length, x) * dx

    moves = {name: jax.tree.map(move, getattr(iterate, name), getattr(step, name)) for name in MOVING}
    return iterate._replace(**moves)


def _inside(iterate: ConeOptimum) -> Array:
    """Return whether all slack and duals are inside their cones ``(B,)``."""
    inside = jnp.ones_like(iterate.gap, bool)
    for part in (*iterate.slack, *iterate.duals):
        inside = inside & jnp.all(part[..., :1] > _length(part[..., 1:]), (1, 2))
    return inside


def _reach(scalings: list[_Scaling], move: _Move) -> Array:
    """Return the largest step along the move that stays inside the cones."""
    least = jnp.zeros_like(move.point[:, 0])
    for scaling, *moves in zip(scalings, move.slack, move.duals, strict=True):
        for moved in moves:
            least = jnp.maximum(least, jnp.max(_crossing(scaling.middle, moved), (1, 2)))
    return 1 / jnp.maximum(least, jnp.finfo(least.dtype).tiny ** 0.5)


def _crossing(inside: Array, moved: Array) -> Array:
    """Inverse of the number of times ``moved`` leads from a point inside the cone to its surface; below 0 if never."""
    root = _root(inside)
    unit = inside / root
    along = unit[..., :1] * moved[..., :1] - _dot(unit[..., 1:], moved[..., 1:])[..., None]
    across = moved[..., 1:] - (along + moved[..., :1]) / (unit[..., :1] + 1) * unit[..., 1:]
    return (_length(across) - along) / root


class _System(NamedTuple):
    """The linear equations of a step: the scaled rows, the factors of H = P + sum of G^T (W^2 + R)^-1 G and of
    A H^-1 A^T."""

    program: ConeProgram
    rows: list[Cones]
    """W^-1 G."""
    scalings: list[_Scaling]
    softness: list[_Softness | None]
    factor: Array
    across: Array
    """H^-1 A^T."""
    small: Array

    def solve(self, dual: Array, equal: Array, cones: list[Array]) -> tuple[Array, Array, list[Array]]:
        """x, y and W z of P x + A^T y + G^T z = dual, A x = equal, G x - (W^2 + R) z = cones."""
        program = self.program
        held = [_unscaled(scaling, part) for scaling, part in zip(self.scalings, cones, strict=True)]

        def duals(point: Array) -> list[Array]:
            return [
                _softened(soft, _scaled_by(rows, point) - part)
                for rows, part, soft in zip(self.rows, held, self.softness, strict=True)
            ]

        point, equality = jnp.zeros_like(dual), jnp.zeros_like(equal)
        # H spans all magnitudes in the end: what it leaves, as the three equations see it, is solved for again.
        for _ in range(1 + REFINED):
            left = dual - _times(program.quadratic, point) - _pulled(program.equations, equality)
            for rows, z in zip(self.rows, duals(point), strict=True):
                left = left - _back(rows, z)
            correction, equality_correction = self._once(left, equal - _times(program.equations, point))
            point, equality = point + correction, equality + equality_correction
        return point, equality, duals(point)

    def _once(self, right: Array, equal: Array) -> tuple[Array, Array]:
        plain = _behind(self.factor, right)
        equality = _behind(self.small, _times(self.program.equations, plain) - equal)
        return plain - _times(self.across, equality), equality


def _system(program: ConeProgram, scalings: list[_Scaling]) -> _System:
    rows = [
        Cones(jnp.moveaxis(_unscaled(_wider(s), jnp.moveaxis(c.rows, 3, 1)), 1, 3), c.offset)
        for s, c in zip(scalings, program.cones, strict=True)
    ]
    softness = [_softness(s, c.giving) for s, c in zip(scalings, program.cones, strict=True)]
    matrix = program.quadratic
    for part, soft in zip(rows, softness, strict=True):
        stiff = jnp.moveaxis(_softened(_wider(soft), jnp.moveaxis(part.rows, 3, 1), root=True), 1, 3)
        flat = stiff.reshape(stiff.shape[0], -1, stiff.shape[-1])
        matrix = matrix + jnp.einsum("bik,bil->bkl", flat, flat, precision=lax.Precision.HIGHEST)
    factor = jnp.linalg.cholesky(_raised(matrix))
    across = lax.linalg.triangular_solve(factor, jnp.swapaxes(program.equations, 1, 2), left_side=True, lower=True)
    small = jnp.einsum("bke,bkf->bef", across, across, precision=lax.Precision.HIGHEST)
    across = lax.linalg.triangular_solve(factor, across, left_side=True, lower=True, transpose_a=True)
    return _System(program, rows, scalings, softness, factor, across, jnp.linalg.cholesky(_raised(small)))


def _raised(matrix: Array) -> Array:
    """With what rounding may have taken from its diagonal, so that it has a factor; solving again takes it back."""
    size = matrix.shape[-1]
    diagonal = jnp.einsum("bii->bi", matrix)
    floor = 4 * size * jnp.finfo(matrix.dtype).eps * diagonal + jnp.finfo(matrix.dtype).tiny
    return matrix + floor[..., None] * jnp.eye(size, dtype=matrix.dtype)


def _behind(factor: Array, right: Array) -> Array:
    """x with L L^T x = right."""
    half = lax.linalg.triangular_solve(factor, right[..., None], left_side=True, lower=True)
    return lax.linalg.triangular_solve(factor, half, left_side=True, lower=True, transpose_a=True)[..., 0]


def _scaling(s: Array, z: Array) -> _Scaling:
    roots = _root(s), _root(z)
    plain, mirrored = s / roots[0], _mirrored(z / roots[1])
    cosine = jnp.sqrt((1 + _dot(plain, _mirrored(mirrored))[..., None]) / 2)
    scaling = _Scaling((plain + mirrored) / (2 * cosine), jnp.sqrt(roots[0] / roots[1]), s)
    return scaling._replace(middle=_scaled(scaling, z))


def _wider(parts: Parts) -> Parts:
    """With an axis for the columns of rows."""
    return jax.tree.map(lambda part: part[:, None], parts)


def _scaled(scaling: _Scaling, x: Array) -> Array:
    """W x."""
    first, others = scaling.unit[..., :1], scaling.unit[..., 1:]
    along = _dot(others, x[..., 1:])[..., None]
    tail = x[..., 1:] + others * (x[..., :1] + along / (1 + first))
    return scaling.size * jnp.concatenate([first * x[..., :1] + along, tail], -1)


def _unscaled(scaling: _Scaling, x: Array) -> Array:
    """W^-1 x."""
    inverse = _Scaling(_mirrored(scaling.unit), 1 / scaling.size, scaling.middle)
    return _scaled(inverse, x)


def _softness(scaling: _Scaling, giving: Array | None) -> _Softness | None:
    if giving is None:
        return None
    return _Softness(_unscaled(scaling, _identity(scaling.middle)), giving[..., None])


def _softened(soft: _Softness | None, x: Array, root: bool = False) -> Array:
    """(1 + W^-1 R W^-1)^-1 x, or its root's."""
    if soft is None:
        return x
    square = _dot(soft.along, soft.along)[..., None]
    scale = 1 + soft.giving * square
    # 1 - 1 / more, and 1 - 1 / sqrt(more), each over the square, without what would cancel.
    share = soft.giving / (jnp.sqrt(scale) * (1 + jnp.sqrt(scale)) if root else scale)
    return x - share * _dot(soft.along, x)[..., None] * soft.along


def _injected(cones: Cones, z: Array) -> Array:
    """Return R z."""
    if cones.giving is None:
        return jnp.zeros_like(z)
    return jnp.zeros_like(z).at[..., 0].set(cones.giving * z[..., 0])


def _identity(like: Array) -> Array:
    return jnp.zeros_like(like).at[..., 0].set(1)


def _mirrored(x: Array) -> Array:
    return jnp.concatenate([x[..., :1], -x[..., 1:]], -1)


def _product(x: Array, y: Array) -> Array:
    """Jordan's."""
    others = x[..., :1] * y[..., 1:] + y[..., :1] * x[..., 1:]
    return jnp.concatenate([_dot(x, y)[..., None], others], -1)


def _divide(x: Array, y: Array) -> Array:
    """u with x o u = y."""
    square = _root(x) ** 2
    first = (x[..., :1] * y[..., :1] - _dot(x[..., 1:], y[..., 1:])[..., None]) / square
    return jnp.concatenate([first, (y[..., 1:] - first * x[..., 1:]) / x[..., :1]], -1)


def _root(x: Array) -> Array:
    """Root of the determinant t^2 - |u|^2 ``(..., 1)``."""
    size = _length(x[..., 1:])
    return jnp.sqrt((x[..., :1] - size) * (x[..., :1] + size))


def _length(x: Array) -> Array:
    return jnp.sqrt(jnp.sum(x * x, -1, keepdims=True))


def _dot(x: Array, y: Array) -> Array:
    return jnp.sum(x * y, -1)


def _times(matrix: Array, x: Array) -> Array:
    return jnp.einsum("bij,bj->bi", matrix, x, precision=lax.Precision.HIGHEST)


def _pulled(matrix: Array, x: Array) -> Array:
    return jnp.einsum("bij,bi->bj", matrix, x, precision=lax.Precision.HIGHEST)


def _scaled_by(cones: Cones, x: Array) -> Array:
    """G x."""
    return jnp.einsum("bmdk,bk->bmd", cones.rows, x, precision=lax.Precision.HIGHEST)


def _back(cones: Cones, z: Array) -> Array:
    """G^T z."""
    return jnp.einsum("bmdk,bmd->bk", cones.rows, z, precision=lax.Precision.HIGHEST)
