"""Seeded grasp problems, ordinary and nasty, for tests and benchmarks; NumPy, and Clarabel for the limit kinds.

A feasible wrench is made as G f with f well inside the cones (eighty per cent of the friction), so that rounding of
the wrench cannot push the problem over the edge. The ``limit`` kinds lie at a given share of the largest wrench that
the grasp can exert in some direction, as ``jaxgrasp.testing.reachable_limits`` finds and proves it.

Share of ``ordinary`` problems whose optimum has an active cone, measured over 4,000 problems at n = 3/5/8/10/20:
0.43/0.49/0.50/0.48/0.46 for method B, 0.48/0.60/0.64/0.63/0.63 for method A.
"""

from collections.abc import Callable

import numpy as np
from numpy.random import Generator

from jaxgrasp.testing.reachable_limits import reachable_limit
from jaxgrasp.testing.references import Contacts, Problems

INSIDE = 0.8
"""Part of the friction that the forces behind a feasible wrench use at most."""
AWAY = (0.2, 3.0)
"""Range of the spread of log(normal force / squeeze); tuned so that half of the ordinary problems have active cones."""
LIMIT_WIDTH = 1e-6
"""Relative distance of the bounds of a limit above which a problem is drawn again."""
LEAST_LIMIT = 1e-3
"""Smallest theta, d being as large as forces of the mean squeeze make it, below which a problem is drawn again."""


def problems(kind: str, n: int, count: int, seed: int) -> Problems:
    """Generate ``count`` problems of ``n`` contacts; the same arguments give the same problems on every machine.

    Raises:
        ValueError: for a kind that does not exist, or that needs more contacts.
        ImportError: for a limit kind, if Clarabel is missing.
    """
    if kind not in KINDS:
        raise ValueError(f"kind is {kind!r}: expected one of {', '.join(KINDS)}")
    if n < LEAST_CONTACTS.get(kind, 1):
        raise ValueError(f"n is {n}: {kind} problems need at least {LEAST_CONTACTS.get(kind, 1)} contacts")
    rng = np.random.default_rng([seed, n, KINDS_IN_ORDER.index(kind)])
    return KINDS[kind](rng, kind, n, count)


def exact_wrench(points: np.ndarray, forces: np.ndarray) -> np.ndarray:
    """Compute G f ``(B, 6)``, summed in extended precision and rounded once."""
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
    """Draw contacts on an ellipsoid of a few centimetres, with perturbed normals and the friction of skin."""
    outward = _directions(rng, count, n)
    axes = rng.uniform(0.02, 0.06, (count, 1, 3))
    centre = rng.normal(0, 0.1, (count, 1, 3))
    normals = unit(-outward / axes + rng.normal(0, 4.0, (count, n, 3)))
    friction = rng.uniform(0.3, 1.0, (count, n))
    squeeze = rng.uniform(1.0, 8.0, (count, n))
    return Contacts(centre + axes * outward, normals, friction, squeeze)


def allowed_forces(rng: Generator, contacts: Contacts, press: np.ndarray) -> np.ndarray:
    """Draw forces of normal part ``press`` ``(B, n)`` inside the cones, up to ``INSIDE`` of the friction."""
    across = _directions(rng, *press.shape)
    across -= np.sum(across * contacts.normals, -1, keepdims=True) * contacts.normals
    across = unit(across) * (INSIDE * contacts.friction * np.sqrt(rng.uniform(size=press.shape)))[..., None]
    return press[..., None] * (contacts.normals + across)


def _inner_forces(rng: Generator, contacts: Contacts) -> np.ndarray:
    """Draw forces ``(B, n, 3)`` inside the contacts' cones, near the squeezing forces or far from them."""
    count, n = contacts.squeeze.shape
    # How far the load is from the squeezing forces decides how often a cone is active at the optimum.
    away = _log_uniform(rng, *AWAY, (count, 1))
    press = contacts.squeeze * np.exp(away * rng.uniform(-1.5, 1.5, (count, n)))
    near = allowed_forces(rng, contacts, press)
    # Less tangential force where the load is close to the squeezing, or no closed form would be inside.
    return contacts.normals * press[..., None] + np.minimum(away, 1)[..., None] * (
        near - contacts.normals * press[..., None]
    )


def _feasible(rng: Generator, kind: str, contacts: Contacts, feasible: bool | None = True) -> Problems:
    return _loaded(kind, contacts, _inner_forces(rng, contacts), feasible)


def _loaded(kind: str, contacts: Contacts, forces: np.ndarray, feasible: bool | None) -> Problems:
    return Problems(kind, *contacts, exact_wrench(contacts.points, forces), feasible, forces)


def _ordinary(rng: Generator, kind: str, n: int, count: int) -> Problems:
    return _feasible(rng, kind, _ordinary_contacts(rng, n, count))


def _on_a_line(rng: Generator, contacts: Contacts, low: float = 1e-7, high: float = 1e-2) -> Contacts:
    """Move the contacts near an oblique line, with a spread across it of ``low`` to ``high`` of the spread along it."""
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
    return _loaded(kind, contacts, np.zeros((count, n, 3)), True)


def _one_sided(rng: Generator, n: int, count: int) -> tuple[Contacts, np.ndarray]:
    """Draw contacts that all push against a common motion; return them and the velocity ``(B, n, 3)`` of the motion."""
    contacts = _ordinary_contacts(rng, n, count)
    middle = contacts.points.mean(-2, keepdims=True)
    linear, angular = _directions(rng, count, 1), _directions(rng, count, 1) / 0.05
    # Half of the escapes are pure translations.
    angular *= (np.arange(count) % 2)[:, None, None]
    velocity = linear + np.cross(angular, contacts.points - middle)
    away = unit(velocity)
    # Tilted by at most atan(0.5), and friction at most 1: no force in a cone works along the escape.
    across = rng.normal(size=away.shape)
    across = unit(across - np.sum(across * away, -1, keepdims=True) * away)
    normals = unit(-away + rng.uniform(0, 0.5, (count, n, 1)) * across)
    return contacts._replace(normals=normals), velocity


def _infeasible(rng: Generator, kind: str, n: int, count: int) -> Problems:
    """Draw problems whose contacts all push against a common motion, and whose wrench needs work along the motion."""
    contacts, velocity = _one_sided(rng, n, count)
    forces = _inner_forces(rng, contacts)
    # Pulling forces, so that the wrench is one of the grasp's range, however few its contacts.
    speed2 = np.sum(velocity**2, (-2, -1), keepdims=True)
    strength = rng.uniform(0.05, 1.0, (count, 1)) * contacts.squeeze.sum(-1, keepdims=True)
    target_work = strength[..., None] * np.sqrt(speed2 / n)
    pull = (target_work - np.sum(forces * velocity, (-2, -1), keepdims=True)) / speed2
    return _loaded(kind, contacts, forces + pull * velocity, feasible=False)._replace(witness=None)


def _at_limit(share: float) -> Callable[..., Problems]:
    """Return a generator of problems with the wrench w0 + share theta d.

    The wrench w0 lies well inside the wrenches that the grasp can exert; theta is the largest reachable multiple of d.
    """

    def make(rng: Generator, kind: str, n: int, count: int) -> Problems:
        batches: list[Problems] = []
        while sum(len(batch.wrench) for batch in batches) < count:
            batches.append(_near_limit(rng, kind, n, count, share))

        def joined(name: str) -> np.ndarray:
            return np.concatenate([getattr(batch, name) for batch in batches])[:count]

        contacts = Contacts(*(joined(name) for name in Contacts._fields))
        return Problems(kind, *contacts, joined("wrench"), share < 1, joined("witness") if share < 1 else None)

    return make


def _near_limit(rng: Generator, kind: str, n: int, count: int, share: float) -> Problems:
    """Draw ``count`` problems; return those with a limit above ``LEAST_LIMIT``, proven to ``LIMIT_WIDTH``."""
    contacts, velocity = _one_sided(rng, n, count)
    inner = _inner_forces(rng, contacts)
    pushes = rng.normal(size=(count, n, 3)) * contacts.squeeze.mean(-1)[:, None, None]
    # Of d and -d the one that works along the escape has an end for certain.
    pushes *= np.sign(np.sum(pushes * velocity, (-2, -1), keepdims=True))
    problem = _loaded(kind, contacts, inner, True)
    limit = reachable_limit(problem, contacts.squeeze, exact_wrench(contacts.points, pushes))
    is_sharp = (limit.width < LIMIT_WIDTH) & (limit.lower > LEAST_LIMIT)
    theta = limit.upper[is_sharp][:, None, None]
    contacts = Contacts(*(x[is_sharp] for x in contacts))
    if share < 1:
        return _loaded(kind, contacts, inner[is_sharp] + share * (limit.forces[is_sharp] - inner[is_sharp]), True)
    return _loaded(kind, contacts, inner[is_sharp] + share * theta * pushes[is_sharp], False)._replace(witness=None)


def _scaled(contacts: Contacts, length: np.ndarray, force: np.ndarray) -> Contacts:
    return contacts._replace(points=contacts.points * length, squeeze=contacts.squeeze * force)


def _scales(rng: Generator, kind: str, n: int, count: int) -> Problems:
    """Draw ordinary problems scaled to sizes of 1e-3 to 1e3 m and loads of 1e-6 to 1e6 N."""
    length = _log_uniform(rng, 1e-3, 1e3, (count, 1, 1)) / 0.05
    force = _log_uniform(rng, 1e-6, 1e6, (count, 1)) / 5
    return _feasible(rng, kind, _scaled(_ordinary_contacts(rng, n, count), length, force))


def _far_frame(rng: Generator, kind: str, n: int, count: int) -> Problems:
    contacts = _ordinary_contacts(rng, n, count)
    frame = _directions(rng, count, 1) * _log_uniform(rng, 1.0, 100.0, (count, 1, 1))
    return _feasible(rng, kind, contacts._replace(points=contacts.points + frame))


def _combined(rng: Generator, kind: str, n: int, count: int) -> Problems:
    """Draw problems that combine a near line, extreme friction, uneven or no squeeze, any scale, and a far frame."""
    contacts = _on_a_line(rng, _ordinary_contacts(rng, n, count))
    # Draws up to 0.15 squeeze nothing, up to 0.3 have no friction, up to 0.4 a lot. Three contacts that squeeze, two of
    # them with friction, keep the wrench away from the limit by every sharing: here rounding is no small matter.
    draws = rng.uniform(np.array([0.3, 0.3, 0.15, *np.zeros(n)])[:n], 1.0, (count, n))
    idle, slick, sticky = draws < 0.15, (draws >= 0.15) & (draws < 0.3), (draws >= 0.3) & (draws < 0.4)
    friction = np.select([slick, sticky], [0.0, 10.0], rng.uniform(0.05, 0.1, (count, n)))
    squeeze = np.where(idle, 0.0, _log_uniform(rng, 1e-3, 1e2, (count, n)))
    contacts = contacts._replace(friction=friction, squeeze=squeeze)
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
    "limit_99": _at_limit(0.99),
    "limit_101": _at_limit(1.01),
    "limit_9999": _at_limit(0.9999),
    "limit_10001": _at_limit(1.0001),
}
KINDS_IN_ORDER = tuple(KINDS)
"""A kind's place seeds it: add new ones at the end."""
STRESS_KINDS = tuple(kind for kind in KINDS if kind != "ordinary")
LIMIT_KINDS = tuple(kind for kind in KINDS if kind.startswith("limit"))
LEAST_CONTACTS = {"near_collinear": 2, "coincident_some": 2, "coincident_all": 2}
"""Smallest number of contacts of a kind, 1 where not listed: a single contact has no line and no twin."""
