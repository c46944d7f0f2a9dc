"""Contacts of a posed hand: against MuJoCo's for the same spheres, and the laws they obey."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrasp.hand import Box, Capsule, Cylinder, Plane, Pose, Posture, Sphere, find_contacts, human_hand
from jaxgrasp.hand.detection import _merge_overlaps
from jaxgrasp.numerics.vec3 import Vec3
from tests.hand.hands import random_posture, rotations

HAND = human_hand()
SHAPES = [Sphere(0.04), Box(0.06, 0.09, 0.05), Cylinder(0.03, 0.12), Capsule(0.025, 0.08), Plane()]
QUICK = Cylinder
"""Every other shape compiles anew: the long tests try those too."""
PARAMETERS = [
    pytest.param(shape, id=type(shape).__name__, marks=() if isinstance(shape, QUICK) else pytest.mark.slow)
    for shape in SHAPES
]
each_shape = pytest.mark.parametrize("shape", PARAMETERS)
FIELDS = ("points", "normals", "depths", "present")


def scenes(count: int, seed: int = 1) -> tuple[Posture, Pose]:
    """Return bent hands, and an object somewhere below each palm."""
    rng = np.random.default_rng(seed)
    posture = random_posture(HAND, count, seed)
    inward = np.array([0.08, 0.0, -0.045]) + rng.normal(scale=0.012, size=(count, 3))
    origin = posture.wrist.origin + np.einsum("bij,bj->bi", posture.wrist.rotation, inward)
    return posture, Pose(origin, rotations(count, rng))


@pytest.fixture(scope="module", params=PARAMETERS)
def case(request):
    posture, placed = scenes(40)
    return request.param, posture, placed, jax.device_get(find_contacts(HAND, posture, request.param, placed))


def mujoco_scene(shape):
    """Return a MuJoCo model of the hand's spheres as free geoms, and the shape on a body of its own."""
    import mujoco

    kinds = mujoco.mjtGeom
    sizes = {
        Sphere: lambda s: (kinds.mjGEOM_SPHERE, [s.radius, 0, 0]),
        Box: lambda s: (kinds.mjGEOM_BOX, [s.length / 2, s.width / 2, s.height / 2]),
        Cylinder: lambda s: (kinds.mjGEOM_CYLINDER, [s.radius, s.height / 2, 0]),
        Capsule: lambda s: (kinds.mjGEOM_CAPSULE, [s.radius, s.height / 2, 0]),
    }
    kind, size = sizes[type(shape)](shape)
    spec = mujoco.MjSpec()
    for radius in np.asarray(HAND.skin.radii).ravel():
        leaf = spec.worldbody.add_body(mocap=True)
        leaf.add_geom(type=kinds.mjGEOM_SPHERE, size=[radius, 0, 0], contype=1, conaffinity=2)
    held = spec.worldbody.add_body(name="held")
    held.add_freejoint()
    held.add_geom(name="held", type=kind, size=size, contype=2, conaffinity=1)
    return spec.compile()


def merged(depths, points, normals) -> tuple:
    """Merge overlaps by the stated rule: the largest depth, and means weighted by squared depth of all else."""
    weight = np.asarray(depths) ** 2
    normal = weight @ np.asarray(normals)
    return weight @ np.asarray(points) / weight.sum(), normal / np.linalg.norm(normal), max(depths)


@pytest.mark.parametrize("shape", PARAMETERS[:4])
def test_contacts_are_those_of_mujoco(shape):
    """Each overlap is MuJoCo's: point, normal and depth; then the rule that merges them."""
    mujoco = pytest.importorskip("mujoco")
    posture, placed = scenes(40)
    contacts = jax.device_get(find_contacts(HAND, posture, shape, placed))
    frames = jax.device_get(pose_frames(posture))
    model = mujoco_scene(shape)
    data = mujoco.MjData(model)
    held = model.geom("held").id
    compared = 0
    for i in range(40):
        centers = np.einsum("lij,lmj->lmi", frames.rotation[i], HAND.skin.centers) + frames.origin[i][:, None]
        data.mocap_pos[:] = centers.reshape(-1, 3)
        data.qpos[:3] = placed.origin[i]
        mujoco.mju_mat2Quat(data.qpos[3:7], np.ascontiguousarray(placed.rotation[i]).ravel())
        mujoco.mj_forward(model, data)
        overlaps = {k: [] for k in range(len(HAND.links))}
        for contact in data.contact:
            first = contact.geom[0] == held
            leaf = contact.geom[1] if first else contact.geom[0]
            into = contact.frame[:3] * (-1 if first else 1)
            # MuJoCo's point lies halfway between the surfaces; ours on the object's.
            overlaps[leaf // HAND.skin.radii.shape[1]].append(
                (-contact.dist, contact.pos - into * -contact.dist / 2, into)
            )
        for k, several in overlaps.items():
            assert bool(several) == bool(contacts.present[i, k]), (i, k)
            # A sphere whose centre lies inside has several ways out, of which each program takes one.
            if several and max(d for d, _, _ in several) < 0.9 * HAND.skin.radii[k].min():
                point, normal, depth = merged(*(np.array(column) for column in zip(*several, strict=True)))
                assert contacts.depths[i, k] == pytest.approx(depth, abs=1e-9)
                np.testing.assert_allclose(contacts.points[i, k], point, atol=1e-9)
                np.testing.assert_allclose(contacts.normals[i, k], normal, atol=1e-7)
                compared += 1
    assert compared > 50


def pose_frames(posture: Posture) -> Pose:
    from jaxgrasp.hand import pose_hand

    return pose_hand(HAND, posture).links


def test_some_touch_and_some_do_not(case):
    _, _, _, contacts = case
    assert 0.05 < contacts.present.mean() < 0.95
    assert (contacts.depths[contacts.present == 0] == 0).all() and (contacts.depths[contacts.present == 1] > 0).all()
    np.testing.assert_allclose(np.linalg.norm(contacts.normals, axis=-1), 1, rtol=1e-14)
    assert all(np.isfinite(getattr(contacts, name)).all() for name in FIELDS)


def test_contacts_move_with_the_scene(case):
    shape, posture, placed, contacts = case
    rng = np.random.default_rng(8)
    turn, shift = rotations(1, rng)[0], rng.normal(size=3)

    def moved(pose: Pose) -> Pose:
        return Pose(pose.origin @ turn.T + shift, turn @ pose.rotation)

    again = find_contacts(HAND, Posture(moved(posture.wrist), posture.angles), shape, moved(placed))
    np.testing.assert_allclose(again.depths, contacts.depths, atol=1e-14)
    np.testing.assert_allclose(
        again.normals[contacts.present == 1], contacts.normals[contacts.present == 1] @ turn.T, atol=1e-9
    )
    points = contacts.points[contacts.present == 1] @ turn.T + shift
    np.testing.assert_allclose(again.points[contacts.present == 1], points, atol=1e-12)


@pytest.mark.slow
def test_alone_mapped_and_batched_are_one(case):
    shape, posture, placed, contacts = case
    alone = [
        jax.device_get(find_contacts(HAND, *jax.tree.map(lambda x, i=i: x[i], (posture,)), shape, pose_at(placed, i)))
        for i in range(3)
    ]
    mapped = jax.vmap(lambda p, o: find_contacts(HAND, p, shape, o))(posture, placed)
    folded = jax.tree.map(lambda x: x.reshape(4, 10, *x.shape[1:]), (posture, placed))
    nested = jax.vmap(jax.vmap(lambda p, o: find_contacts(HAND, p, shape, o)))(*folded)
    batched = find_contacts(HAND, folded[0], shape, folded[1])
    for name in (*FIELDS, "tests"):
        expected = getattr(contacts, name)
        np.testing.assert_allclose(np.stack([getattr(a, name) for a in alone]), expected[:3], atol=1e-14)
        np.testing.assert_allclose(getattr(mapped, name), expected, atol=1e-14)
        for wide in (nested, batched):
            np.testing.assert_allclose(getattr(wide, name).reshape(expected.shape), expected, atol=1e-14)


def pose_at(pose: Pose, i: int) -> Pose:
    return Pose(pose.origin[i], pose.rotation[i])


def test_what_comes_near_with_no_link_costs_a_test_for_each_link():
    """An open hand about nothing: within reach of the object, but no link is near."""
    posture, placed = scenes(40)
    aside = Pose(placed.origin - 0.09 * np.asarray(posture.wrist.rotation)[..., 2], placed.rotation)
    beside = find_contacts(HAND, posture, Sphere(0.005), aside)
    assert (beside.tests == 1 + len(HAND.links)).all() and (beside.present == 0).all()
    # One pose that comes near makes those beside it be looked at too, and finds what it does alone.
    origin = np.asarray(aside.origin).copy()
    origin[7] = placed.origin[7]
    contacts = find_contacts(HAND, posture, Sphere(0.03), Pose(origin, placed.rotation))
    assert contacts.present[7].any() and (contacts.tests > 1 + len(HAND.links)).any()
    alone = find_contacts(HAND, jax.tree.map(lambda x: x[7], posture), Sphere(0.03), pose_at(placed, 7))
    for name in FIELDS:
        np.testing.assert_allclose(getattr(contacts, name)[7], getattr(alone, name), atol=1e-14)


def test_what_is_out_of_reach_costs_one_test():
    posture, placed = scenes(40)
    away = placed.origin.copy()
    away[::2] += [0.0, 0.0, 1.0]
    contacts = find_contacts(HAND, posture, Sphere(0.04), Pose(away, placed.rotation))
    full = find_contacts(HAND, posture, Sphere(0.04), placed)
    assert (contacts.tests[::2] == 1).all() and (contacts.present[::2] == 0).all()
    assert (contacts.tests[1::2] == 1 + len(HAND.links) + HAND.skin.radii.size).all()
    for name in FIELDS:
        np.testing.assert_allclose(getattr(contacts, name)[1::2], getattr(full, name)[1::2], atol=1e-15)


@each_shape
def test_nothing_within_reach_is_skipped(shape):
    """Wherever any link can touch, the first test lets it through."""
    rng = np.random.default_rng(4)
    posture = random_posture(HAND, 4000, seed=4)
    origin = posture.wrist.origin + rng.normal(scale=0.12, size=(4000, 3))
    placed = Pose(origin, rotations(4000, rng))
    contacts = find_contacts(HAND, posture, shape, placed)
    brute = jax.vmap(lambda p, o: find_contacts(jax.tree.map(lambda x: x + 0 * o.origin[0], HAND), p, shape, o))
    np.testing.assert_array_equal(contacts.present, brute(posture, placed).present)
    assert contacts.present.mean() > 0.02 and (contacts.tests == 1).mean() > 0.02


@each_shape
def test_derivatives_forward_reverse_and_by_differences(shape):
    posture, placed = jax.tree.map(lambda x: x[:4], scenes(4, seed=2))
    sizes, structure = jax.tree.flatten(jax.tree.map(jnp.asarray, shape))
    start = (jnp.asarray(posture.angles), jnp.asarray(posture.wrist.origin), jnp.asarray(placed.origin), *sizes)

    def measured(angles, wrist, place, *sizes):
        contacts = find_contacts(
            HAND,
            Posture(Pose(wrist, posture.wrist.rotation), angles),
            jax.tree.unflatten(structure, sizes),
            Pose(place, placed.rotation),
        )
        return contacts.depths, contacts.points, contacts.normals

    rng = np.random.default_rng(7)
    tangent = tuple(rng.normal(size=x.shape) for x in start)
    values, moved = jax.jit(lambda x, d: jax.jvp(measured, x, d))(start, tangent)
    cotangent = tuple(rng.normal(size=x.shape) for x in values)
    (back,) = jax.jit(lambda x, c: jax.vjp(lambda y: measured(*y), x)[1](c))(start, cotangent)
    forward = sum(np.vdot(c, m) for c, m in zip(cotangent, moved, strict=True))
    reverse = sum(np.vdot(d, g) for d, g in zip(tangent, back, strict=True))
    assert forward == pytest.approx(reverse, rel=1e-11)
    step = 1e-6
    ahead, behind = (measured(*(x + h * d for x, d in zip(start, tangent, strict=True))) for h in (step, -step))
    for rate, a, b in zip(moved, ahead, behind, strict=True):
        # A plane's normal stays as it is.
        assert float(jnp.abs(rate).max()) > 0.01 or isinstance(shape, Plane)
        np.testing.assert_allclose(rate, (a - b) / (2 * step), atol=2e-4 * float(jnp.abs(rate).max()))


def test_nothing_jumps_while_a_finger_rolls_over_an_edge():
    """A flexed finger slides along a cylinder, sphere after sphere meeting it and leaving it again."""
    count, step = 4000, 2e-5
    angles = np.zeros((count, 19))
    origin = np.zeros((count, 3))
    origin[:, 0] = -0.04 + step * np.arange(count)
    posture = Posture(Pose(origin, np.broadcast_to(np.eye(3), (count, 3, 3))), angles)
    turned = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
    contacts = jax.device_get(
        find_contacts(HAND, posture, Cylinder(0.03, 0.2), Pose(np.array([0.1, 0, -0.035]), turned))
    )
    proximal = [link.name for link in HAND.links].index("index proximal")
    depth, is_present = contacts.depths[:, proximal], contacts.present[:, proximal] == 1
    assert is_present.sum() > 1000
    assert np.abs(np.diff(depth)).max() < 2 * step
    is_present_before_and_after = is_present[1:] & is_present[:-1]
    assert (
        np.linalg.norm(np.diff(contacts.normals[:, proximal], axis=0)[is_present_before_and_after], axis=1).max() < 0.02
    )


@pytest.mark.parametrize("depth", [1e-9, 1e-12, 1e-18])
def test_derivatives_of_a_grazing_contact_are_finite_in_single_precision(depth):
    """The squares of such depths, by which points are weighted, underflow there."""
    depths = jnp.array([0.0, 1.0, 0.5], jnp.float32)[None, :, None] * jnp.float32(depth)
    places = Vec3(*(jnp.array([[[0.1], [0.2], [0.4]]], jnp.float32) for _ in range(3)))
    out = Vec3(*(jnp.full((1, 3, 1), x, jnp.float32) for x in (0.0, 0.6, 0.8)))
    for jacobian in (jax.jacfwd, jax.jacrev):
        rates = jacobian(lambda depths: _merge_overlaps(depths, places, out))(depths)
        assert all(np.isfinite(rate).all() for rate in jax.tree.leaves(rates))
    contact = _merge_overlaps(depths, places, out)
    np.testing.assert_allclose(contact.point.x, 0.24, rtol=1e-6)
    np.testing.assert_allclose(contact.normal.z, -0.8, rtol=1e-6)


def test_the_plane_reads_the_lowest_point():
    """A straight finger lies on a table with all its spheres: it is as deep as the lowest of them."""
    height = 0.008
    flat = Posture(Pose(np.array([0, 0, height]), np.eye(3)), np.zeros(19))
    contacts = find_contacts(HAND, flat, Plane(), Pose(np.zeros(3), np.eye(3)))
    deepest = np.maximum(np.asarray(HAND.skin.radii).max(1) - height, 0)
    fingers = [i for i, link in enumerate(HAND.links) if link.finger != "thumb"]
    np.testing.assert_allclose(contacts.depths[np.array(fingers)], deepest[fingers], atol=1e-15)
    is_present = np.asarray(contacts.present) == 1
    np.testing.assert_allclose(
        contacts.normals[is_present], np.broadcast_to([0, 0, -1.0], (is_present.sum(), 3)), atol=1e-15
    )
    np.testing.assert_allclose(contacts.points[..., 2], 0, atol=1e-16)
