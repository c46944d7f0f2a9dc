"""Judgement of answers and proofs in extended precision, from the definitions alone."""

from typing import NamedTuple

import numpy as np

from tests.fuzz.sampled import Sample

Wide = np.longdouble


class Worth(NamedTuple):
    """Errors and bounds of each problem, all ``(B,)``."""

    residual: np.ndarray
    """What the forces leave of the wrench [N]; torques about the contacts' middle, over their distance from it."""
    load: np.ndarray
    """The wrench's own size, likewise."""
    size: np.ndarray
    """Sum of the forces' sizes [N]."""
    outside: np.ndarray
    """Distance of the forces from their cones, beside the largest of them."""
    gap: np.ndarray
    """Objective less the dual's value at the multiplier, beside the objective or that of no force."""
    rounding: np.ndarray
    """How far, on the scale of the gap, the optimum moves when every number of the data moves by a part of 1 of it."""
    proven: np.ndarray
    """Total of normal forces that the certificate proves to be needed at least [N]; inf where there are none at all."""


def worth(problem: Sample, weights: np.ndarray, forces: np.ndarray, multiplier: np.ndarray, certificate) -> Worth:
    """Judge forces and a multiplier as an optimum, and a certificate as a proof."""
    p, a, mu, s, w = (np.asarray(array, Wide) for array in problem)
    f, k = np.asarray(forces, Wide), np.asarray(weights, Wide)
    middle = p.mean(1, keepdims=True)
    reach = np.sqrt(np.mean(_square(p - middle), -1))
    reach = np.where(reach > 0, reach, 1)
    torque = w[:, 3:] - np.cross(middle[:, 0], w[:, :3])
    left = w[:, :3] - f.sum(1), torque - np.cross(p - middle, f).sum(1)
    residual, load = (np.sqrt(_square(x) + _square(y) / reach**2) for x, y in (left, (w[:, :3], torque)))
    size = np.sqrt(_square(f))
    largest = np.where(size.max(-1) > 0, size.max(-1), 1)
    objective = _cost(f, a, s, k).sum(-1)
    velocity = _velocity(multiplier, p)
    best = _projected(s[..., None] * a + k[..., None] * velocity, a, mu)
    contact_costs = _cost(best, a, s, k) - np.sum(velocity * best, -1)
    dual = np.sum(np.asarray(multiplier, Wide) * w, -1) + contact_costs.sum(-1)
    idle = _cost(np.zeros_like(f), a, s, k).sum(-1)
    scale = np.maximum(objective, np.where(idle > 0, idle, 1e-300))
    apart = np.sqrt(_square(f - _projected(f, a, mu))).max(-1) / largest
    linear, angular = (np.sqrt(_square(np.asarray(part, Wide))) for part in (multiplier[:, :3], multiplier[:, 3:]))
    lever = linear[:, None] + angular[:, None] * np.sqrt(_square(p))
    moved = np.sum(lever * size, -1) + linear * np.sqrt(_square(w[:, :3])) + angular * np.sqrt(_square(w[:, 3:]))
    needed = _needed(certificate, p, a, mu, k, w)
    values = residual, load, size.sum(-1), apart, (objective - dual) / scale, moved / scale, needed
    return Worth(*(np.asarray(array, float) for array in values))


def _square(x: np.ndarray) -> np.ndarray:
    return np.sum(x * x, -1)


def _cost(f: np.ndarray, a: np.ndarray, s: np.ndarray, k: np.ndarray) -> np.ndarray:
    return np.where(k > 0, _square(f - s[..., None] * a) / (2 * np.where(k > 0, k, 1)), 0)


def _velocity(twist: np.ndarray, p: np.ndarray) -> np.ndarray:
    twist = np.asarray(twist, Wide)[:, None]
    return twist[..., :3] + np.cross(twist[..., 3:], p)


def _projected(u: np.ndarray, a: np.ndarray, mu: np.ndarray) -> np.ndarray:
    """Return the nearest force inside the cone of each contact."""
    along = np.sum(u * a, -1)
    across = u - along[..., None] * a
    size = np.sqrt(_square(across))
    height = np.maximum((along + mu * size) / (1 + mu**2), 0)
    tangent = across / np.where(size > 0, size, 1)[..., None]
    onto = height[..., None] * (a + mu[..., None] * tangent)
    return np.where((size <= mu * along)[..., None], u, onto)


def _needed(certificate, p: np.ndarray, a: np.ndarray, mu: np.ndarray, k: np.ndarray, w: np.ndarray) -> np.ndarray:
    """Return the work of the wrench along the certificate over the most work of a unit of normal force."""
    velocity = _velocity(certificate, p)
    along = np.sum(velocity * a, -1)
    push = along + mu * np.sqrt(_square(velocity - along[..., None] * a))
    most = np.where(k > 0, np.maximum(push, 0), 0).max(-1)
    work = np.sum(np.asarray(certificate, Wide) * w, -1)
    return np.where(work > 0, np.where(most > 0, work / np.where(most > 0, most, 1), np.inf), 0)
