"""Judge of the suite's references in exact and in decimal arithmetic: Python's ``fractions`` and ``decimal`` alone.

It shares no code with the solver, nor with the code that computed the references. By weak duality the pair of forces
and multiplier proves itself: allowed, balancing forces bound the optimum from above, and any multiplier from below.
"""

import decimal
from decimal import Decimal
from fractions import Fraction
from typing import NamedTuple

import numpy as np

from jaxgrasp.testing.suite_problem import SuiteProblem

DIGITS = 100


class ReferenceErrors(NamedTuple):
    """Errors of a reference; each is relative."""

    balance: float
    """|w - G f| over the load: squeeze, force, and torque over the contacts' radius."""
    violation: float
    """Largest distance of a force from its cone over the largest force, and of a torque over its bound."""
    gap: float
    """Difference of the objective and the dual's value over the larger of the objective and that of no force."""


def judge(problem: SuiteProblem) -> ReferenceErrors:
    """Return the errors of the reference of a feasible problem, computed in 100 digits."""
    with decimal.localcontext(decimal.Context(prec=DIGITS)):
        return _judge(problem)


def _judge(problem: SuiteProblem) -> ReferenceErrors:
    n = len(problem.friction)
    points, wrench = _decimals(problem.points), _decimals(problem.wrench)
    normals = [_unit(a) for a in _decimals(problem.normals)]
    mu, s, k = (_decimals(x) for x in (problem.friction, problem.squeeze, problem.weights))
    gamma = _decimals(np.zeros(n) if problem.torsion is None else problem.torsion)
    radius = [g / m if m > 0 else Decimal(0) for g, m in zip(gamma, mu, strict=True)]
    forces, moments = _pair(problem.forces), _pair(problem.moments)
    twist, torque_multiplier = _pair(problem.multiplier), _pair(problem.torque_multiplier)
    centre = sum(k[:, None] * points) / sum(k)
    arms = points - centre
    length = (sum(k * np.array([a @ a for a in arms])) / sum(k)).sqrt() or Decimal(1)
    exerted = sum(forces)
    torque = sum(_cross(r, f) + m * a for r, f, m, a in zip(arms, forces, moments, normals, strict=True))
    about = wrench[3:] - _cross(centre, wrench[:3])
    load = sum(s) + _norm(wrench[:3]) + _norm(about) / length or Decimal(1)
    balance = (_norm(wrench[:3] - exerted) + _norm(about - torque) / length) / load
    largest = max(_norm(f) for f in forces) or Decimal(1)
    violation, primal, idle, dual = Decimal(0), Decimal(0), Decimal(0), twist @ wrench
    rows = None if problem.torque_map is None else _decimals(problem.torque_map)
    for i in range(n):
        velocity = twist[:3] + _cross(twist[3:], points[i])
        if rows is not None:
            velocity = velocity - rows[i] @ torque_multiplier
        spin_rate = radius[i] * (twist[3:] @ normals[i])
        spin = moments[i] / radius[i] if radius[i] > 0 else Decimal(0)
        if radius[i] == 0:
            violation = max(violation, abs(moments[i]) / length / largest)
        held = s[i] * normals[i]
        if k[i] == 0:
            violation = max(violation, _norm(forces[i] - held) / largest)
            dual -= velocity @ held
            continue
        vector, normal = _extended(forces[i], spin), _extended(normals[i], Decimal(0))
        nearest = _project(vector, normal, mu[i])
        violation = max(violation, _norm(vector - nearest) / largest)
        deviation = vector - s[i] * normal
        primal += deviation @ deviation / (2 * k[i])
        idle += s[i] * s[i] / (2 * k[i])
        rates = _extended(velocity, spin_rate)
        best = _project(s[i] * normal + k[i] * rates, normal, mu[i])
        dual += (best - s[i] * normal) @ (best - s[i] * normal) / (2 * k[i]) - best @ rates
    if rows is not None and problem.torque_max is not None:
        most = _decimals(problem.torque_max)
        for j, bound in enumerate(most):
            torque_of_joint = sum(forces[i] @ rows[i][:, j] for i in range(n))
            violation = max(violation, (abs(torque_of_joint) - bound) / bound)
            dual -= bound * abs(torque_multiplier[j])
    scale = max(primal, idle) or Decimal(1)
    return ReferenceErrors(float(balance), float(violation), float(abs(primal - dual) / scale))


def proves(problem: SuiteProblem, certificate: np.ndarray | None = None) -> bool:
    """Return whether a twist proves that no forces exist, in rational arithmetic: without any rounding.

    Args:
        problem: one without torque limits, since these only make forces fewer, and whose contacts can all move.
        certificate: pair of twists ``(2, 6)``, whose sum counts; the problem's own where not given.
    """
    pair = problem.certificate if certificate is None else certificate
    if (problem.weights == 0).any():
        raise ValueError("weights hold a zero: expected contacts that can all move")
    d = [Fraction(float(high)) + Fraction(float(low)) for high, low in zip(*pair, strict=True)]
    if not sum(x * Fraction(float(y)) for x, y in zip(d, problem.wrench, strict=True)) > 0:
        return False
    return all(_cannot_push(problem, i, d) for i in range(len(problem.friction)))


def _cannot_push(problem: SuiteProblem, i: int, d: list[Fraction]) -> bool:
    """Return whether no allowed force of contact i does work along d: v.a + mu |v_t| <= 0, by squares."""
    p, a = ([Fraction(float(x)) for x in row] for row in (problem.points[i], problem.normals[i]))
    mu = Fraction(float(problem.friction[i]))
    turned = (d[4] * p[2] - d[5] * p[1], d[5] * p[0] - d[3] * p[2], d[3] * p[1] - d[4] * p[0])
    v = [x + y for x, y in zip(d[:3], turned, strict=True)]
    along = sum(x * y for x, y in zip(v, a, strict=True))
    size2 = sum(x * x for x in a)
    across2 = sum(x * x for x in v) * size2 - along * along
    spin2 = Fraction(0)
    if problem.torsion is not None and mu > 0:
        spin2 = (Fraction(float(problem.torsion[i])) * sum(x * y for x, y in zip(d[3:], a, strict=True))) ** 2
    return along <= 0 and mu * mu * across2 + spin2 <= along * along


def _decimals(values: np.ndarray) -> np.ndarray:
    flat = [Decimal(float(x)) for x in np.asarray(values, float).ravel()]
    return np.array(flat, dtype=object).reshape(np.shape(values))


def _pair(pair: np.ndarray) -> np.ndarray:
    return _decimals(pair[0]) + _decimals(pair[1])


def _norm(vector: np.ndarray) -> Decimal:
    return sum((x * x for x in vector), Decimal(0)).sqrt()


def _extended(vector: np.ndarray, last: Decimal) -> np.ndarray:
    return np.array([*vector, last], dtype=object)


def _unit(vector: np.ndarray) -> np.ndarray:
    return vector / _norm(vector)


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]], dtype=object)


def _project(u: np.ndarray, normal: np.ndarray, mu: Decimal) -> np.ndarray:
    """Project onto the cone of vectors whose part across the normal is at most mu times the part along it."""
    along = u @ normal
    across = u - along * normal
    size = _norm(across)
    if size <= mu * along:
        return u
    height = (along + mu * size) / (1 + mu * mu)
    if height <= 0:
        return 0 * u
    return height * (normal + mu / size * across) if size > 0 else height * normal
