"""Problems of the suite, drawn once from seeds; ``benchmarks.make_suite`` adds their references.

Where a wrench must lie in a range of rank below 6, the data have few bits, so that its float64 is exact: rounding would
make the problem infeasible.
"""

from collections.abc import Iterable
from fractions import Fraction

import numpy as np
from numpy.random import Generator

from benchmarks import suite_references
from jaxgrasp.testing import problems as P
from jaxgrasp.testing.references import Contacts, Problems
from jaxgrasp.testing.suite_problem import SuiteProblem

SEED = 62
SIZES = (3, 5, 10)
COUNT = 8
"""Problems of a kind and size, where the kind does not say otherwise."""


def draw() -> Iterable[SuiteProblem]:
    """Yield the problems of all kinds but those that were once undecided, without references."""
    for maker in MAKERS:
        yield from maker()


def _rng(kind: str, n: int) -> Generator:
    return np.random.default_rng([SEED, n, *kind.encode()])


def _named(kind: str, n: int, number: int, batch: Problems | Contacts, wrench: np.ndarray, **fields) -> SuiteProblem:
    """Return problem ``number`` of a batch, by method A if its number is odd."""
    squeeze = batch.squeeze[number]
    weights = np.ones_like(squeeze) if number % 2 and kind != "idle_contacts" else squeeze
    return SuiteProblem(
        f"{kind}_{n}_{number:02d}", kind, batch.points[number], batch.normals[number], batch.friction[number], squeeze,
        wrench, weights, **fields,
    )  # fmt: skip


def _from_kind(
    kind: str, drawn: str, *, feasible: bool = True, sizes: tuple[int, ...] = SIZES
) -> Iterable[SuiteProblem]:
    for n in sizes:
        batch = P.problems(drawn, n, COUNT, SEED)
        for number in range(COUNT):
            yield _named(kind, n, number, batch, batch.wrench[number], feasible=feasible)


def ordinary() -> Iterable[SuiteProblem]:
    yield from _from_kind("ordinary", "ordinary")
    yield from _from_kind("near_collinear", "near_collinear")
    yield from _from_kind("combined", "combined", sizes=(5, 10))


def changed() -> Iterable[SuiteProblem]:
    """Yield ordinary contacts with one quantity changed, and the wrench of allowed forces."""

    def log(rng: Generator, low: float, high: float, shape: tuple[int, ...]) -> np.ndarray:
        return 10 ** rng.uniform(low, high, shape)

    def friction(low: float, high: float):
        return lambda rng, c: c._replace(friction=log(rng, low, high, c.friction.shape))

    def mixed(rng: Generator, c: Contacts) -> Contacts:
        choice = rng.uniform(size=c.friction.shape)
        values = np.where(choice < 0.5, log(rng, -6, -2, choice.shape), log(rng, 0, 6, choice.shape))
        return c._replace(friction=np.where(choice < 0.15, 0.0, values))

    def squeeze(rng: Generator, c: Contacts) -> Contacts:
        return c._replace(squeeze=log(rng, -6, 6, c.squeeze.shape))

    def idle(rng: Generator, c: Contacts) -> Contacts:
        # At least three contacts squeeze, so that the rest is of full rank.
        is_idle = (rng.uniform(size=c.squeeze.shape) < 0.4) & (np.arange(c.squeeze.shape[1]) >= 3)
        is_idle[:, 3] = True
        return c._replace(squeeze=np.where(is_idle, 0.0, c.squeeze))

    def far(rng: Generator, c: Contacts) -> Contacts:
        away = P.unit(rng.normal(size=(COUNT, 1, 3))) * log(rng, 0, 6, (COUNT, 1, 1))
        return c._replace(points=c.points + away)

    def scales(rng: Generator, c: Contacts) -> Contacts:
        length, force = log(rng, -9, 9, (COUNT, 1, 1)), log(rng, -9, 9, (COUNT, 1))
        return c._replace(points=c.points * (length / 0.05), squeeze=c.squeeze * (force / 5))

    def twins(rng: Generator, c: Contacts) -> Contacts:
        together = np.arange(c.squeeze.shape[1]) < max(2, c.squeeze.shape[1] // 2)
        points = np.where(together[:, None], c.points[:, :1], c.points)
        alike = (np.arange(COUNT) % 4 < 2)[:, None, None] & together[:, None]
        return c._replace(points=points, normals=np.where(alike, c.normals[:, :1], c.normals))

    changes = {
        "tiny_friction": (friction(-6, -3), SIZES),
        "huge_friction": (friction(1, 6), SIZES),
        "mixed_friction": (mixed, (5, 10)),
        "wide_squeeze": (squeeze, SIZES),
        "idle_contacts": (idle, (5, 10)),
        "far_frame": (far, SIZES),
        "scales": (scales, SIZES),
        "twins": (twins, (5, 10)),
    }
    for kind, (change, sizes) in changes.items():
        for n in sizes:
            rng = _rng(kind, n)
            contacts = change(rng, P._ordinary_contacts(rng, n, COUNT))
            wrench = P.exact_wrench(contacts.points, P._inner_forces(rng, contacts))
            for number in range(COUNT):
                yield _named(kind, n, number, contacts, wrench[number])


def on_grid(values: np.ndarray, bits: int) -> np.ndarray:
    """Round to multiples of 2^-bits."""
    return np.round(values * 2.0**bits) / 2.0**bits


def exact_wrench(points: np.ndarray, forces: np.ndarray) -> np.ndarray:
    """Return the wrench ``(6,)`` of forces ``(n, 3)``, whose rounding must change nothing."""
    total = [Fraction(0)] * 6
    for p, f in zip(points, forces, strict=True):
        px, py, pz = (Fraction(float(x)) for x in p)
        fx, fy, fz = (Fraction(float(x)) for x in f)
        parts = (fx, fy, fz, py * fz - pz * fy, pz * fx - px * fz, px * fy - py * fx)
        total = [x + y for x, y in zip(total, parts, strict=True)]
    wrench = np.array([float(x) for x in total])
    assert [Fraction(float(x)) for x in wrench] == total, "the wrench is rounded"
    return wrench


def gridded() -> Iterable[SuiteProblem]:
    """Yield grasps whose wrenches must lie in a range of rank below 6."""
    for kind, sizes in (
        ("coincident", SIZES),
        ("two_fingers", (2,)),
        ("zero_wrench", SIZES),
        ("rank_deficient", (2, 3, 5)),
    ):
        for n in sizes:
            rng = _rng(kind, n)
            contacts = P._ordinary_contacts(rng, n, COUNT)
            if kind == "coincident":
                points = np.repeat(on_grid(contacts.points[:, :1], 14), n, 1)
                alike = (np.arange(COUNT) % 4 < 2)[:, None, None]
                contacts = contacts._replace(
                    points=points, normals=np.where(alike, contacts.normals[:, :1], contacts.normals)
                )
            elif kind in ("two_fingers", "rank_deficient"):
                axis = P.unit(rng.normal(size=(COUNT, 1, 3)))
                place = np.linspace(-1, 1, n)[:, None] * (1 + 0.2 * rng.uniform(size=(COUNT, n, 1)))
                middle = on_grid(rng.normal(0, 0.1, (COUNT, 1, 3)), 10)
                # Multiples of one vector, so that the points lie on a line exactly.
                points = middle + on_grid(place, 4) * on_grid(0.03 * axis, 12)
                normals = P.unit(-np.sign(place) * axis + 0.2 * rng.normal(size=(COUNT, n, 3)))
                contacts = contacts._replace(points=points, normals=normals)
            for number in range(COUNT):
                forces = on_grid(P._inner_forces(rng, contacts)[number], 14)
                if kind == "zero_wrench":
                    forces = 0 * forces
                wrench = exact_wrench(contacts.points[number], forces)
                feasible = kind != "rank_deficient"
                fields: dict = {"feasible": feasible}
                if not feasible:
                    line = contacts.points[number, -1] - contacts.points[number, 0]
                    wrench = wrench + np.concatenate([np.zeros(3), on_grid(line * 2.0 ** rng.integers(-6, 6), 20)])
                    twist = np.concatenate([np.cross(contacts.points[number, 0], line), line])
                    twist *= np.sign(wrench @ twist)
                    fields["certificate"] = np.stack([twist, 0 * twist])
                yield _named(kind, n, number, contacts, wrench, **fields)


def zero_friction() -> Iterable[SuiteProblem]:
    """Yield frictionless contacts on the faces of a box, whose wrench is exact."""
    for n in SIZES:
        rng = _rng("zero_friction", n)
        for number in range(COUNT):
            axis, sign = rng.integers(0, 3, n), rng.choice([-1.0, 1.0], n)
            normals = np.eye(3)[axis] * sign[:, None]
            points = on_grid(0.05 * rng.uniform(-1, 1, (n, 3)), 14)
            points[np.arange(n), axis] = -sign / 16
            squeeze = rng.uniform(1, 8, n)
            press = on_grid(squeeze * np.exp(rng.uniform(-1, 1, n)), 12)
            wrench = exact_wrench(points, press[:, None] * normals)
            weights = np.ones(n) if number % 2 else squeeze
            name = f"zero_friction_{n}_{number:02d}"
            yield SuiteProblem(name, "zero_friction", points, normals, np.zeros(n), squeeze, wrench, weights)


def _twist_of(points: np.ndarray, velocity: np.ndarray) -> np.ndarray:
    """Return the twist ``(6,)`` of a common motion from the velocities of the contacts ``(n, 3)``."""
    maps = np.concatenate([np.concatenate([np.eye(3), np.cross(np.eye(3), p).T], 1) for p in points])
    return np.linalg.lstsq(maps, velocity.ravel())[0]


def infeasible() -> Iterable[SuiteProblem]:
    """Yield contacts that all push against a common motion, along which the wrench does work."""
    for n in (2, *SIZES):
        rng = _rng("infeasible", n)
        contacts, velocity = P._one_sided(rng, n, COUNT)
        forces = P._inner_forces(rng, contacts)
        # Pulling forces, so that the wrench is one of the grasp's range, however few its contacts.
        speed2 = np.sum(velocity**2, (-2, -1), keepdims=True)
        strength = rng.uniform(0.05, 1.0, (COUNT, 1, 1)) * contacts.squeeze.sum(-1)[:, None, None]
        pull = strength * np.sqrt(speed2 / n) - np.sum(forces * velocity, (-2, -1), keepdims=True)
        wrench = P.exact_wrench(contacts.points, forces + pull / speed2 * velocity)
        for number in range(COUNT):
            twist = _twist_of(contacts.points[number], velocity[number])
            certificate = np.stack([twist, 0 * twist])
            yield _named("infeasible", n, number, contacts, wrench[number], feasible=False, certificate=certificate)


def limits() -> Iterable[SuiteProblem]:
    """Yield loads of 1 -+ 10^-k of the largest along a direction, two for each k and size."""
    for n in SIZES:
        rng = _rng("limit", n)
        made = 0
        while made < 2:
            contacts, velocity = P._one_sided(rng, n, 1)
            inner = P._inner_forces(rng, contacts)
            pushes = rng.normal(size=inner.shape) * contacts.squeeze.mean(-1)[:, None, None]
            pushes *= np.sign(np.sum(pushes * velocity, (-2, -1), keepdims=True))
            start = P.exact_wrench(contacts.points, inner)[0]
            along = P.exact_wrench(contacts.points, pushes)[0]
            base = SuiteProblem("", "inside_limit", *(x[0] for x in contacts), start, contacts.squeeze[0])
            try:
                theta = suite_references.limit(base, along)
            except suite_references.NotDecidedError:
                continue
            beyond = np.array(
                [float(x) for x in suite_references.exact(start) + 1.1 * theta * suite_references.exact(along)]
            )
            # Where the load passes the limit at a flat angle, 10^-8 of it would be a matter of rounding.
            if not 0.05 < theta < 20 or suite_references.distance(base._replace(wrench=beyond)) < 1e-3:
                continue
            escape = _twist_of(base.points, velocity[0])
            for k in range(1, 9):
                for kind, sign in (("inside_limit", -1), ("outside_limit", 1)):
                    share = theta * (1 + sign * suite_references.mpf(10) ** -k)
                    target = suite_references.exact(start) + share * suite_references.exact(along)
                    wrench = np.array([float(x) for x in target])
                    problem = base._replace(
                        name=f"{kind}_{n}_{made}_{k}", kind=kind, wrench=wrench, feasible=sign < 0, distance=10.0**-k
                    )
                    if sign > 0:
                        twist = suite_references.certificate(problem, escape)
                        problem = problem._replace(certificate=suite_references.pair(twist))
                    yield problem
            made += 1


def soft() -> Iterable[SuiteProblem]:
    for n in SIZES:
        rng = _rng("soft_fingers", n)
        contacts = P._ordinary_contacts(rng, n, COUNT)
        forces = P._inner_forces(rng, contacts)
        press = np.sum(forces * contacts.normals, -1)
        torsion = 10 ** rng.uniform(-5, -1, press.shape) * contacts.friction
        moments = 0.5 * torsion * press * rng.uniform(-1, 1, press.shape)
        wrench = P.exact_wrench(contacts.points, forces)
        wrench[:, 3:] += np.sum(moments[..., None] * contacts.normals, 1)
        for number in range(COUNT):
            yield _named("soft_fingers", n, number, contacts, wrench[number], torsion=torsion[number])


def limited(joints: int = 6) -> Iterable[SuiteProblem]:
    """Yield bounds of joint torques just above those of forces that balance the load."""
    for n in SIZES:
        rng = _rng("torque_limits", n)
        contacts = P._ordinary_contacts(rng, n, COUNT)
        forces = P._inner_forces(rng, contacts)
        wrench = P.exact_wrench(contacts.points, forces)
        moved = rng.uniform(size=(COUNT, n, 1, joints)) < 0.5
        torque_map = 0.05 * rng.normal(size=(COUNT, n, 3, joints)) * moved
        torque = np.abs(np.einsum("bnc,bncj->bj", forces, torque_map))
        size = np.einsum("bnc,bncj->bj", np.abs(forces), np.abs(torque_map))
        most = torque + 10 ** rng.uniform(-4, 0, torque.shape) * size + 1e-6
        for number in range(COUNT):
            yield _named(
                "torque_limits", n, number, contacts, wrench[number], torque_map=torque_map[number],
                torque_max=most[number],
            )  # fmt: skip


def published() -> Iterable[SuiteProblem]:
    """Yield grasps of the literature, and simulated grips that ship with the package."""
    angles = np.radians([0.0, 120.0, 240.0])
    disc = np.stack([np.cos(angles), np.sin(angles), 0 * angles], -1)
    corners = np.array([[1.0, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]) / np.sqrt(3)
    pair = np.array([[1.0, 0, 0], [-1, 0, 0]])
    fingers = np.radians([-45.0, -15.0, 15.0, 45.0, 180.0])
    cylinder = np.stack([0.05 * np.cos(fingers), 0.05 * np.sin(fingers), 0 * fingers], -1)
    cylinder[:, 2] = [0.02, 0.0, -0.02, 0.01, 0.0]
    radial = -np.stack([np.cos(fingers), np.sin(fingers), 0 * fingers], -1)
    shares = 0.12 * np.array([30.0, 32, 23, 15, 100])

    def one(name: str, points, normals, friction: float, squeeze, wrench) -> SuiteProblem:
        squeeze = np.asarray(squeeze, float)
        return SuiteProblem(
            f"published_{name}", "published", np.asarray(points, float), np.asarray(normals, float),
            np.full(len(squeeze), friction), squeeze, np.asarray(wrench, float), squeeze,
        )  # fmt: skip

    yield one("antipodal_pair", pair, -pair, 0.5, [4, 4], [0, 0, 2, 0, 0, 0])
    yield one("antipodal_pair_turned", pair, -pair, 0.5, [4, 4], [0, 0, 2, 1, 0, 0])._replace(
        feasible=False, certificate=np.stack([np.array([0, 0, 0, 1.0, 0, 0]), np.zeros(6)])
    )
    for friction in (0.3, 0.5, 1.0):
        for load in (1.0, 3.0):
            name = f"unit_disc_mu{friction}_load{load:g}"
            yield one(name, disc, -disc, friction, [5, 5, 5], [0, 0, load, 0, 0, 0])
    for friction in (0.5, 1.0):
        yield one(f"tetrahedron_mu{friction}", corners, -corners, friction, [4] * 4, [1, 2, -1, 0.5, 0, 0.3])
    for degrees in (0, 30, 60, 90, 120, 150):
        turned = np.radians(degrees)
        gravity = 10 * np.array([np.sin(turned), np.cos(turned), 0])
        yield one(f"cylinder_tzafestas_{degrees}", cylinder, radial, 0.6, shares, [*gravity, 0, 0, 0])
    with np.load(P.__file__.replace("testing/problems.py", "data/simulated_grips.npz")) as grips:
        sizes = np.diff(grips["offsets"])
        chosen = [int(np.flatnonzero(sizes == n)[k]) for n in (3, 4, 5, 6, 8, 10, 12, 15) for k in (0, 40)]
        for i in chosen:
            rows = slice(*grips["offsets"][i : i + 2])
            squeeze = grips["squeeze"][rows]
            yield SuiteProblem(
                f"published_grip_{i}", "published", grips["points"][rows], grips["normals"][rows],
                grips["friction"][rows], squeeze, grips["wrench"][i], squeeze,
            )  # fmt: skip


ONCE_UNDECIDED = {
    ("limit_10001", 2): [(84, "squeeze"), (676, "squeeze"), (76, "uniform"), (84, "uniform"), (676, "uniform")],
    ("limit_10001", 3): [(i, "squeeze") for i in (18, 21, 93, 419, 606, 996)]
    + [(i, "uniform") for i in (18, 21, 93, 419, 606, 723, 996)],
    ("combined", 3): [(973, "squeeze")],
}
"""Indices and sharings of problems, by kind and number of contacts: undecided in version 0.1.0, but for ``combined``,
whose gap was 3e-8 where 1e-8 was promised."""
ON_A_SPHERE = {5: (115, 389, 453, 545, 748, 792, 25, 75), 8: (267, 1154)}
"""Likewise of contacts on a sphere with friction of 1e-8 to 1e-3, by number of contacts."""


def once_undecided() -> Iterable[SuiteProblem]:
    """Yield problems that this package did not decide, from the sets of its own tests."""
    for (kind, n), entries in ONCE_UNDECIDED.items():
        batch = P.problems(kind, n, 1000, 3 if kind == "limit_10001" else 2)
        for i, sharing in entries:
            yield SuiteProblem(
                f"once_undecided_{kind}_{n}_{sharing}_{i}", "once_undecided", batch.points[i], batch.normals[i],
                batch.friction[i], batch.squeeze[i], batch.wrench[i], batch.weights(sharing)[i],
                feasible=kind != "limit_10001",
            )  # fmt: skip
    for n, indices in ON_A_SPHERE.items():
        rng = np.random.default_rng(6)
        points = P.unit(rng.normal(size=(4000, n, 3)))
        friction, squeeze = 10 ** rng.uniform(-8, -3, points.shape[:2]), rng.uniform(0.5, 5, points.shape[:2])
        wrench = rng.normal(size=(4000, 6)) * [1, 1, 1, 0.3, 0.3, 0.3]
        for i in indices:
            yield SuiteProblem(
                f"once_undecided_sphere_{n}_{i}", "once_undecided", points[i], -points[i], friction[i], squeeze[i],
                wrench[i], squeeze[i],
            )  # fmt: skip


MAKERS = (ordinary, changed, gridded, zero_friction, infeasible, limits, soft, limited, published, once_undecided)
