"""Seeded grasp problems, ordinary and nasty, for tests and benchmarks; NumPy only.

A feasible wrench is made as G f with f well inside the cones (eighty per cent of the friction), so that rounding of
the wrench cannot push the problem over the edge. Wrenches at a given share of the reachable limit need a solver to
find that limit and do not belong here.

Share of ``ordinary`` problems whose optimum has an active cone, measured over 4,000 problems at n = 3/5/8/10/20:
0.43/0.49/0.50/0.48/0.46 for method B, 0.48/0.60/0.64/0.63/0.63 for method A.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.random import Generator

INSIDE = 0.8
"""Part of the friction that the forces behind a feasible wrench use at most."""
AWAY = (0.2, 3.0)
"""How far loads lie from the squeezing forces, in logarithms: tuned for about half of the ordinary problems active."""


class Problems(NamedTuple):
    """A batch of problems of one kind, in float64."""

    kind: str
    points: np.ndarray
    normals: np.ndarray
    friction: np.ndarray
    squeeze: np.ndarray
    wrench: np.ndarray
    feasible: bool | None
    """True or False where the construction decides it for every sharing; None where it depends on the sharing."""

    def cast(self, dtype: type) -> "Problems":
        """The same problems rounded to ``dtype``: other problems, strictly speaking."""
        arrays = {name: getattr(self, name).astype(dtype) for name in self._fields if name not in ("kind", "feasible")}
        return self._replace(**arrays)

    def weights(self, sharing: str) -> np.ndarray:
        """The sharing weights k of a named method."""
        return {"squeeze": self.squeeze, "uniform": np.ones_like(self.squeeze)}[sharing]


class Contacts(NamedTuple):
    """Contacts before a wrench is chosen."""

    points: np.ndarray
    normals: np.ndarray
    friction: np.ndarray
    squeeze: np.ndarray


def problems(kind: str, n: int, count: int, seed: int) -> Problems:
    """``count`` problems of ``n`` contacts; the same arguments give the same problems on every machine."""
    rng = np.random.default_rng([seed, n, KINDS_IN_ORDER.index(kind)])
    return KINDS[kind](rng, kind, n, count)


def exact_wrench(points: np.ndarray, forces: np.ndarray) -> np.ndarray:
    """G f summed in extended precision and rounded once."""
    wide, points = forces.astype(np.longdouble), points.astype(np.longdouble)
    torque = np.cross(points, wide).sum(-2)
    return np.concatenate([wide.sum(-2), torque], -1).astype(float)


def unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def _directions(rng: Generator, *shape: int) -> np.ndarray:
    return unit(rng.normal(size=(*shape, 3)))


def _log_uniform(rng: Generator, low: float, high: float, shape: tuple[int, ...]) -> np.ndarray:
    return np.exp(rng.uniform(np.log(low), np.log(high), shape))


def _ordinary_contacts(rng: Generator, n: int, count: int) -> Contacts:
    """Contacts on an ellipsoid of a few centimetres, normals a little off its own, friction of skin on things."""
    outward = _directions(rng, count, n)
    axes = rng.uniform(0.02, 0.06, (count, 1, 3))
    centre = rng.normal(0, 0.1, (count, 1, 3))
    normals = unit(-outward / axes + rng.normal(0, 4.0, (count, n, 3)))
    friction = rng.uniform(0.3, 1.0, (count, n))
    squeeze = rng.uniform(1.0, 8.0, (count, n))
    return Contacts(centre + axes * outward, normals, friction, squeeze)


def allowed_forces(rng: Generator, contacts: Contacts, press: np.ndarray) -> np.ndarray:
    """Random forces of normal part ``press`` inside the cones, up to ``INSIDE`` of the friction."""
    across = _directions(rng, *press.shape)
    across -= np.sum(across * contacts.normals, -1, keepdims=True) * contacts.normals
    across = unit(across) * (INSIDE * contacts.friction * np.sqrt(rng.uniform(size=press.shape)))[..., None]
    return press[..., None] * (contacts.normals + across)


def _feasible(rng: Generator, kind: str, contacts: Contacts, feasible: bool | None = True) -> Problems:
    """Contacts and the wrench of forces inside their cones, near the squeezing forces or far from them."""
    count, n = contacts.squeeze.shape
    # How far the load is from the squeezing forces decides how often a cone is active at the optimum.
    away = _log_uniform(rng, *AWAY, (count, 1))
    press = contacts.squeeze * np.exp(away * rng.uniform(-1.5, 1.5, (count, n)))
    near = allowed_forces(rng, contacts, press)
    # Less tangential force where the load is close to the squeezing, or no closed form would be inside.
    forces = contacts.normals * press[..., None] + np.minimum(away, 1)[..., None] * (
        near - contacts.normals * press[..., None]
    )
    return Problems(kind, *contacts, exact_wrench(contacts.points, forces), feasible)


def _ordinary(rng: Generator, kind: str, n: int, count: int) -> Problems:
    return _feasible(rng, kind, _ordinary_contacts(rng, n, count))


def _on_a_line(rng: Generator, contacts: Contacts, low: float = 1e-7, high: float = 1e-2) -> Contacts:
    """The contacts moved to an oblique line, with a spread across it of ``low`` to ``high`` of their spread along."""
    count, n = contacts.squeeze.shape
    along = _directions(rng, count, 1)
    place = rng.uniform(-1, 1, (count, n, 1))
    spread = _log_uniform(rng, low, high, (count, 1, 1))
    across = rng.normal(size=(count, n, 3))
    across -= np.sum(across * along, -1, keepdims=True) * along
    middle = contacts.points.mean(-2, keepdims=True)
    return contacts._replace(points=middle + 0.05 * (place * along + spread * across))


def _near_collinear(rng: Generator, kind: str, n: int, count: int) -> Problems:
    return _feasible(rng, kind, _on_a_line(rng, _ordinary_contacts(rng, n, count)))


def _coincident_some(rng: Generator, kind: str, n: int, count: int) -> Problems:
    contacts = _ordinary_contacts(rng, n, count)
    together = np.arange(n) < max(2, n // 2)
    points = np.where(together[:, None], contacts.points[:, :1], contacts.points)
    # Every other problem has the same normals there too: one contact written twice.
    twins = (np.arange(count) % 2 == 0)[:, None, None] & together[:, None]
    normals = np.where(twins, contacts.normals[:, :1], contacts.normals)
    return _feasible(rng, kind, contacts._replace(points=points, normals=normals))


def _coincident_all(rng: Generator, kind: str, n: int, count: int) -> Problems:
    contacts = _ordinary_contacts(rng, n, count)
    return _feasible(rng, kind, contacts._replace(points=np.repeat(contacts.points[:, :1], n, 1)))


def _with_friction(low: float, high: float) -> Callable[..., Problems]:
    def make(rng: Generator, kind: str, n: int, count: int) -> Problems:
        contacts = _ordinary_contacts(rng, n, count)
        return _feasible(rng, kind, contacts._replace(friction=rng.uniform(low, high, (count, n))))

    return make


def _wide_squeeze(rng: Generator, kind: str, n: int, count: int) -> Problems:
    contacts = _ordinary_contacts(rng, n, count)
    return _feasible(rng, kind, contacts._replace(squeeze=_log_uniform(rng, 1e-3, 1e2, (count, n))))


def _some_zero_squeeze(rng: Generator, kind: str, n: int, count: int) -> Problems:
    contacts = _ordinary_contacts(rng, n, count)
    idle = rng.uniform(size=(count, n)) < 0.4
    idle[:, 0] = False
    # The wrench comes from contacts that squeeze, so method B can give it too.
    return _feasible(rng, kind, contacts._replace(squeeze=np.where(idle, 0.0, contacts.squeeze)))


def _zero_squeeze(rng: Generator, kind: str, n: int, count: int) -> Problems:
    # Method B has no contact left here; method A can still give the wrench.
    loaded = _feasible(rng, kind, _ordinary_contacts(rng, n, count), feasible=None)
    return loaded._replace(squeeze=np.zeros_like(loaded.squeeze))


def _zero_wrench(rng: Generator, kind: str, n: int, count: int) -> Problems:
    contacts = _ordinary_contacts(rng, n, count)
    return Problems(kind, *contacts, np.zeros((count, 6)), True)


def _infeasible(rng: Generator, kind: str, n: int, count: int) -> Problems:
    """Every contact pushes against a common twist, and the wrench works along it: nothing balances that."""
    contacts = _ordinary_contacts(rng, n, count)
    middle = contacts.points.mean(-2, keepdims=True)
    linear, angular = _directions(rng, count, 1), _directions(rng, count, 1) / 0.05
    # Half of the escapes are pure translations.
    angular *= (np.arange(count) % 2)[:, None, None]
    away = unit(linear + np.cross(angular, contacts.points - middle))
    # Tilted by at most atan(0.5), and friction at most 1: no force in a cone works along the escape.
    across = rng.normal(size=away.shape)
    across = unit(across - np.sum(across * away, -1, keepdims=True) * away)
    normals = unit(-away + rng.uniform(0, 0.5, (count, n, 1)) * across)
    contacts = contacts._replace(normals=normals)
    part = _feasible(rng, kind, contacts, feasible=False)
    escape = np.concatenate([linear - np.cross(angular, middle), angular], -1)[:, 0]
    lost = np.sum(part.wrench * escape, -1, keepdims=True) / np.sum(escape**2, -1, keepdims=True)
    strength = rng.uniform(0.05, 1.0, (count, 1)) * contacts.squeeze.sum(-1, keepdims=True)
    wrench = part.wrench - lost * escape + strength * escape / np.linalg.norm(escape, axis=-1, keepdims=True)
    return part._replace(wrench=wrench)


def _scaled(contacts: Contacts, length: np.ndarray, force: np.ndarray) -> Contacts:
    return contacts._replace(points=contacts.points * length, squeeze=contacts.squeeze * force)


def _scales(rng: Generator, kind: str, n: int, count: int) -> Problems:
    """Sizes of 1e-3 to 1e3 m and loads of 1e-6 to 1e6 N."""
    length = _log_uniform(rng, 1e-3, 1e3, (count, 1, 1)) / 0.05
    force = _log_uniform(rng, 1e-6, 1e6, (count, 1)) / 5
    return _feasible(rng, kind, _scaled(_ordinary_contacts(rng, n, count), length, force))


def _far_frame(rng: Generator, kind: str, n: int, count: int) -> Problems:
    contacts = _ordinary_contacts(rng, n, count)
    frame = _directions(rng, count, 1) * _log_uniform(rng, 1.0, 100.0, (count, 1, 1))
    return _feasible(rng, kind, contacts._replace(points=contacts.points + frame))


def _combined(rng: Generator, kind: str, n: int, count: int) -> Problems:
    """Near a line, slippery, unevenly squeezed, of any size, in a frame metres away."""
    contacts = _on_a_line(rng, _ordinary_contacts(rng, n, count))
    contacts = contacts._replace(
        friction=rng.uniform(0.05, 0.1, (count, n)), squeeze=_log_uniform(rng, 1e-3, 1e2, (count, n))
    )
    length = _log_uniform(rng, 1e-2, 1e2, (count, 1, 1)) / 0.05
    force = _log_uniform(rng, 1e-4, 1e4, (count, 1))
    contacts = _scaled(contacts, length, force)
    return _feasible(rng, kind, contacts._replace(points=contacts.points + 2 * _directions(rng, count, 1)))


KINDS: dict[str, Callable[[Generator, str, int, int], Problems]] = {
    "ordinary": _ordinary,
    "near_collinear": _near_collinear,
    "coincident_some": _coincident_some,
    "coincident_all": _coincident_all,
    "low_friction": _with_friction(0.05, 0.1),
    "zero_friction": _with_friction(0.0, 0.0),
    "high_friction": _with_friction(10.0, 10.0),
    "wide_squeeze": _wide_squeeze,
    "some_zero_squeeze": _some_zero_squeeze,
    "zero_squeeze": _zero_squeeze,
    "zero_wrench": _zero_wrench,
    "infeasible": _infeasible,
    "scales": _scales,
    "far_frame": _far_frame,
    "combined": _combined,
}
KINDS_IN_ORDER = tuple(KINDS)
"""A kind's place seeds it: add new ones at the end."""
STRESS_KINDS = tuple(kind for kind in KINDS if kind != "ordinary")
