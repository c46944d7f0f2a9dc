"""Solids as trees of balls: what the balls leave out, and that a descent finds what trying all of them finds."""

from itertools import pairwise

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import trimesh

from jaxgrasp.grip import Body
from jaxgrasp.grip.motion import spatial_inertia
from jaxgrasp.hand import (
    Box,
    Capsule,
    Cylinder,
    Mesh,
    Pose,
    Posture,
    Sphere,
    SphereTree,
    check_mesh,
    find_contacts,
    human_hand,
    level_errors,
    load_mesh,
    pose_hand,
    principal_frame,
    signed_distance,
    sphere_tree,
)
from jaxgrasp.hand.filling import filling_error
from jaxgrasp.hand.mesh import MeshSurface
from jaxgrasp.hand.sphere_tree import try_all
from tests.hand.hands import random_posture, rotations
from tests.turns import later

HAND = human_hand()
BOX = Box(0.06, 0.09, 0.05)
SHAPES = {"box": BOX, "cylinder": Cylinder(0.03, 0.12), "capsule": Capsule(0.025, 0.08), "sphere": Sphere(0.04)}


def of_trimesh(solid: trimesh.Trimesh) -> Mesh:
    return Mesh(np.array(solid.vertices), np.array(solid.faces))


def box_mesh() -> Mesh:
    return of_trimesh(trimesh.creation.box((BOX.length, BOX.width, BOX.height)))


def ring_mesh() -> Mesh:
    """Return a mesh that is not convex and has a hole."""
    return of_trimesh(trimesh.creation.annulus(0.02, 0.05, 0.03, sections=24))


def capsule_mesh() -> Mesh:
    return of_trimesh(trimesh.creation.capsule(0.08, 0.025, count=(16, 16)))


@pytest.fixture(scope="module")
def tree() -> SphereTree:
    return sphere_tree(BOX, 5, descends=True)


def scenes(count: int, seed: int = 3, below: float | np.ndarray = 0.045) -> tuple[Posture, Pose]:
    """Return bent hands with an object ``below`` the palm; some of them are deep in it."""
    rng = np.random.default_rng(seed)
    posture = random_posture(HAND, count, seed)
    inward = rng.normal(scale=0.012, size=(count, 3)) + [0.08, 0.0, 0.0]
    inward[:, 2] -= below
    origin = posture.wrist.origin + np.einsum("bij,bj->bi", posture.wrist.rotation, inward)
    return posture, Pose(origin, rotations(count, rng))


@pytest.mark.parametrize("shape", SHAPES.values(), ids=SHAPES)
@pytest.mark.parametrize("levels", [1, 3, 4])
def test_balls_lie_inside_and_touch_more_of_the_surface_with_each_level(shape, levels):
    tree = sphere_tree(shape, levels)
    distance, _ = signed_distance(shape, tree.balls.centers)
    assert np.all(-distance >= tree.balls.radii * (1 - 1e-9))
    assert np.max(-distance - tree.balls.radii) <= 1e-9 + 0.5 * 0.13 / 2**levels  # none is needlessly small


@pytest.mark.slow
def test_what_is_left_out_halves_with_the_cells():
    """Balls about as large as their cells leave gaps in proportion to them."""
    errors = level_errors(box_mesh(), 5)
    assert [error.levels for error in errors] == [1, 2, 3, 4, 5]
    for coarse, fine in pairwise(errors[1:]):
        assert fine.cell == pytest.approx(coarse.cell / 2)
        assert fine.error.mean < 0.6 * coarse.error.mean and fine.error.largest < 0.75 * coarse.error.largest
        assert fine.error.balls > coarse.error.balls
    assert errors[-1].error.largest < 0.5 * errors[-1].cell and errors[-1].error.mean < 0.08 * errors[-1].cell
    assert filling_error(sphere_tree(box_mesh(), 5), check_mesh(box_mesh())) == errors[-1].error


@pytest.mark.parametrize("make", [box_mesh, *later(ring_mesh, capsule_mesh)])
def test_no_hole_is_left_inside(make):
    """Whatever is deeper than the cells are wide lies in a ball."""
    mesh = check_mesh(make())
    low, high = mesh.vertices.min(0), mesh.vertices.max(0)
    points = np.random.default_rng(0).uniform(low, high, (6000, 3))
    for levels in (4, 5):
        cell = (high - low).max() / 2**levels
        inside = points[MeshSurface(mesh, 2 * cell).nearest(points).distance < -0.5 * cell]
        distance, _ = signed_distance(sphere_tree(mesh, levels), inside)
        assert len(inside) > 1000 and np.max(distance) < 0.1 * cell


def test_a_face_through_the_middle_of_cells_is_no_gap():
    """Balls lie inside the box though centres of the finest cells lie on its surface, where the side is undefined."""
    box = Box(0.08, 0.05, 0.08 * 12.5 / 16)
    tree = sphere_tree(box, 4)
    across = np.random.default_rng(0).uniform(-0.5, 0.5, (500, 2)) * [0.07, 0.04]
    face = np.column_stack([across, np.full(500, box.height / 2)])
    distance, _ = signed_distance(tree, face)
    assert np.max(distance) < 0.2 * 0.08 / 16


def test_every_node_holds_all_balls_below_it(tree):
    nodes = tree.nodes
    children, leaf = np.asarray(nodes.children).T, np.asarray(nodes.leaf)
    centers, radii = np.asarray(nodes.bounds.centers), np.asarray(nodes.bounds.radii)
    balls, sizes = np.asarray(tree.balls.centers), np.asarray(tree.balls.radii)
    visited = []

    def below(node: int) -> list[int]:
        if leaf[node] >= 0:
            visited.append(leaf[node])
            assert children[node, 0] == node and np.all(children[node, 1:] == -1)
            return [leaf[node]]
        contained = [ball for child in children[node] if child >= 0 for ball in below(child)]
        below_node = np.array(contained)
        far = np.linalg.norm(balls[below_node] - centers[node], axis=1) + sizes[below_node]
        assert far.max() <= radii[node] * (1 + 1e-12)
        return contained

    below(0)
    assert sorted(visited) == list(range(len(tree.balls.radii)))


@pytest.mark.slow
def test_a_descent_finds_what_trying_all_finds(tree):
    posture, placed = scenes(60, below=np.repeat([0.0, 0.06, 0.09, 1.0], 15))
    contacts = find_contacts(HAND, posture, tree, placed)
    everything = find_contacts(HAND, posture, replace_descent(tree), placed)
    for name in ("points", "normals", "depths", "present"):
        np.testing.assert_allclose(
            getattr(contacts, name), getattr(everything, name), rtol=1e-9, atol=1e-12, err_msg=name
        )
    tests, all_tests = np.asarray(contacts.tests), int(np.max(everything.tests))
    # Far ones cost one test, shallow ones a fraction of all, and those deep inside all and what was tried before.
    assert np.all(tests[45:] == 1) and np.all(tests[:45] > 1)
    assert np.min(tests[:45]) < 0.05 * all_tests and np.max(tests) > all_tests


def replace_descent(tree: SphereTree) -> SphereTree:
    return SphereTree(tree.balls, tree.nodes, tree.moments, not tree.descends)


def test_small_trees_try_all_and_large_ones_descend():
    assert not sphere_tree(BOX, 1).descends
    assert sphere_tree(BOX, 3).descends


@pytest.mark.slow
def test_contacts_come_as_close_to_the_exact_shapes_as_the_balls_come_to_its_surface(tree):
    posture, placed = scenes(60, 5)
    exact, contacts = find_contacts(HAND, posture, BOX, placed), find_contacts(HAND, posture, tree, placed)
    errors = level_errors(box_mesh(), 5)[-1].error
    shallow = (exact.depths > 0) & (exact.depths < 0.004)
    assert shallow.sum() > 30
    assert np.all(contacts.depths <= exact.depths + errors.largest + 1e-12)
    assert np.all((contacts.depths >= exact.depths - 2 * errors.largest)[shallow])
    is_deep_in_both = np.asarray(shallow & (contacts.present > 0) & (exact.depths > 3 * errors.mean))
    turned = np.degrees(np.arccos(np.clip(np.sum(contacts.normals * exact.normals, -1), -1, 1)))[is_deep_in_both]
    assert np.median(turned) < 4


def test_contacts_are_those_of_mujoco_for_the_same_balls():
    """MuJoCo finds the pairs of spheres that meet; the stated rules merge them."""
    mujoco = pytest.importorskip("mujoco")
    tree = sphere_tree(BOX, 3)
    posture, placed = scenes(6, 8)
    contacts = jax.device_get(find_contacts(HAND, posture, tree, placed))
    frames = pose_hand(HAND, posture).links
    centers = np.einsum("blij,lmj->blmi", frames.rotation, HAND.skin.centers) + frames.origin[:, :, None]
    model, hand_radii = pairs_model(mujoco, tree), np.asarray(HAND.skin.radii).ravel()
    assert np.any(contacts.present)
    for pose in range(6):
        data = mujoco.MjData(model)
        data.mocap_pos[:] = centers[pose].reshape(-1, 3)
        data.qpos[:3] = placed.origin[pose]
        mujoco.mju_mat2Quat(data.qpos[3:7], np.ascontiguousarray(placed.rotation[pose]).ravel())
        mujoco.mj_forward(model, data)
        merged = merge_pairs(data, model, hand_radii, centers[pose].reshape(-1, 3))
        for link in range(len(HAND.links)):
            depth, point, normal = link_contact(merged, link, HAND.skin.radii.shape[1])
            assert (depth > 0) == (contacts.present[pose, link] > 0)
            if depth > 0:
                np.testing.assert_allclose(contacts.depths[pose, link], depth, atol=1e-9)
                np.testing.assert_allclose(contacts.points[pose, link], point, atol=1e-9)
                np.testing.assert_allclose(contacts.normals[pose, link], normal, atol=1e-7)


def pairs_model(mujoco, tree):
    spec = mujoco.MjSpec()
    sphere = mujoco.mjtGeom.mjGEOM_SPHERE
    for radius in np.asarray(HAND.skin.radii).ravel():
        leaf = spec.worldbody.add_body(mocap=True)
        leaf.add_geom(type=sphere, size=[radius, 0, 0], contype=1, conaffinity=2)
    held = spec.worldbody.add_body(name="held")
    held.add_freejoint()
    for center, radius in zip(np.asarray(tree.balls.centers), np.asarray(tree.balls.radii), strict=True):
        held.add_geom(type=sphere, pos=center, size=[radius, 0, 0], contype=2, conaffinity=1)
    return spec.compile()


def merge_pairs(data, model, radii, centers) -> dict[int, tuple]:
    """Merge each sphere's overlaps: the largest depth, and the mean direction out, weighted by squared overlap."""
    pairs: dict[int, list] = {}
    for contact in data.contact:
        assert contact.geom1 < len(radii) <= contact.geom2
        pairs.setdefault(int(contact.geom1), []).append((-contact.dist, -np.array(contact.frame[:3])))
    merged = {}
    for sphere, overlaps in pairs.items():
        overlap, out = np.array([pair[0] for pair in overlaps]), np.array([pair[1] for pair in overlaps])
        out = overlap**2 @ out
        out /= np.linalg.norm(out)
        merged[sphere] = (overlap.max(), centers[sphere] - (radii[sphere] - overlap.max()) * out, out)
    return merged


def link_contact(merged: dict[int, tuple], link: int, count: int) -> tuple:
    overlaps = [merged[sphere] for sphere in range(link * count, (link + 1) * count) if sphere in merged]
    overlaps = [overlap for overlap in overlaps if overlap[0] > 0]
    if not overlaps:
        return 0.0, None, None
    depth, point, out = (np.array(part) for part in zip(*overlaps, strict=True))
    weight = depth**2
    normal = -weight @ out
    return depth.max(), weight @ point / weight.sum(), normal / np.linalg.norm(normal)


@pytest.mark.slow
def test_derivatives_forward_reverse_and_by_differences(tree):
    posture, placed = scenes(60, 5)
    depths = find_contacts(HAND, posture, tree, placed).depths
    pose = int(np.argmax(np.sum((depths > 0) & (depths < 0.004), 1)))
    angles, origin = posture.angles[pose], posture.wrist.origin[pose]
    weights = np.random.default_rng(0).normal(size=(len(HAND.links), 7))

    def read(angles, origin):
        wrist = Pose(origin, posture.wrist.rotation[pose])
        contacts = find_contacts(HAND, Posture(wrist, angles), tree, Pose(placed.origin[pose], placed.rotation[pose]))
        parts = jnp.concatenate([contacts.points, contacts.normals, contacts.depths[:, None]], -1)
        return jnp.sum(weights * jnp.where(contacts.present[:, None] > 0, parts, 0))

    tangents = [np.random.default_rng(1).normal(size=x.shape) for x in (angles, origin)]
    _, forward = jax.jit(lambda *x: jax.jvp(read, x, tuple(map(jnp.asarray, tangents))))(
        jnp.asarray(angles), jnp.asarray(origin)
    )
    reverse = sum(np.sum(a * b) for a, b in zip(jax.jit(jax.grad(read, (0, 1)))(angles, origin), tangents, strict=True))
    forward = float(forward)
    assert forward == pytest.approx(float(reverse), rel=1e-9)
    step = 1e-7
    ends = [float(jax.jit(read)(angles + s * step * tangents[0], origin + s * step * tangents[1])) for s in (1, -1)]
    assert forward == pytest.approx((ends[0] - ends[1]) / (2 * step), rel=1e-4, abs=1e-6)


def test_depth_and_normal_do_not_jump_while_a_sphere_rolls_over_the_balls(tree):
    """A thousand small steps across a face: what changes in one of them is of its size."""
    steps = np.linspace(-0.02, 0.02, 2001)
    points = np.stack([steps, 0.3 * steps, np.full_like(steps, BOX.height / 2 + 0.006)], -1)[None]
    balls_tried = try_all(jax.tree.map(lambda x: x[None], tree.balls), jnp.asarray(points), jnp.full(len(steps), 0.008))
    jump = steps[1] - steps[0]
    assert np.all(0.008 - balls_tried.distance > 0)
    assert np.max(np.abs(np.diff(balls_tried.distance[0]))) < 1.5 * jump
    assert np.max(np.linalg.norm(np.diff(balls_tried.out[0], axis=0), axis=-1)) < 3000 * jump
    assert np.min(balls_tried.out[0, :, 2]) > np.cos(np.radians(12))


@pytest.mark.slow
def test_a_pose_that_is_not_a_number_is_bad_data_and_leaves_its_neighbours_alone(tree):
    posture, placed = scenes(60, 5)
    sound = find_contacts(HAND, posture, tree, placed)
    origin = placed.origin.copy()
    origin[7, 1] = np.nan
    contacts = find_contacts(HAND, posture, tree, Pose(origin, placed.rotation))
    assert np.all(np.isnan(contacts.present[7]))
    others = np.arange(60) != 7
    np.testing.assert_allclose(contacts.depths[others], sound.depths[others], atol=1e-15)


@pytest.mark.parametrize("make", [box_mesh, ring_mesh])
def test_a_meshs_surface_is_found_exactly(make):
    mesh = check_mesh(make())
    points = np.random.default_rng(0).uniform(-0.06, 0.06, (500, 3))
    near = MeshSurface(mesh, 0.01).nearest(points)
    triangles = mesh.vertices[mesh.faces]
    feet = trimesh.triangles.closest_point(
        np.repeat(triangles, len(points), 0), np.tile(points, (len(triangles), 1))
    ).reshape(len(triangles), len(points), 3)
    far = np.linalg.norm(feet - points, axis=-1).min(0)
    np.testing.assert_allclose(np.abs(near.distance), far, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(points - near.foot, axis=1), far, atol=1e-12)
    np.testing.assert_array_equal(near.distance < 0, winding(triangles, points) > 0.5)


def winding(triangles, points) -> np.ndarray:
    """Compute the winding number of the surface about each point (van Oosterom and Strackee 1983)."""
    a, b, c = np.moveaxis(triangles[:, None] - points[None, :, None], 2, 0)
    la, lb, lc = (np.linalg.norm(x, axis=-1) for x in (a, b, c))
    volume = np.einsum("tpi,tpi->tp", a, np.cross(b, c))
    dots = [np.einsum("tpi,tpi->tp", x, y) for x, y in ((a, b), (b, c), (c, a))]
    return np.sum(2 * np.arctan2(volume, la * lb * lc + dots[0] * lc + dots[1] * la + dots[2] * lb), 0) / (4 * np.pi)


def test_a_mesh_falls_as_its_exact_shape_does():
    turn = rotations(1, np.random.default_rng(2))[0]
    moved = Mesh(box_mesh().vertices @ turn.T + [0.1, -0.2, 0.3], box_mesh().faces)
    mesh, pose = principal_frame(moved)
    np.testing.assert_allclose(mesh.vertices @ pose.rotation.T + pose.origin, moved.vertices, atol=1e-12)
    length, width, height = np.ptp(mesh.vertices, axis=0)
    assert height > length > width, "z is the longest axis, y the shortest"
    tree = sphere_tree(mesh, 2)
    ours, exact = (np.sort(np.diagonal(spatial_inertia(Body(x, 0.7), np.eye(3)))[3:]) for x in (tree, BOX))
    np.testing.assert_allclose(ours, exact, rtol=1e-9)
    assert np.all(np.isnan(sphere_tree(moved, 2).moments)), "a frame off the principal one has no principal moments"


@pytest.mark.parametrize(
    "spoil, words",
    [
        (lambda v, f: (v[:0], f[:0]), "0 vertices and 0 faces"),
        (lambda v, f: (v, f[1:]), "3 edges have a face on one side only"),
        (lambda v, f: (np.where(np.arange(len(v))[:, None] == 2, np.nan, v), f), r"vertices\[2, 0\] is nan"),
        (lambda v, f: (v, np.where(f == 3, 99, f)), "is 99: expected the index of one of 8 vertices"),
        (lambda v, f: (v * [1, 1, 0], f), "is flat"),
        (lambda v, f: (v[:, :2], f), r"shapes \(8, 2\)"),
    ],
)
def test_what_is_no_solid_is_refused(spoil, words):
    mesh = box_mesh()
    with pytest.raises(ValueError, match=words):
        sphere_tree(Mesh(*spoil(mesh.vertices, mesh.faces)))


def test_a_mesh_wound_inside_out_is_turned():
    mesh = box_mesh()
    turned = check_mesh(Mesh(mesh.vertices, mesh.faces[:, ::-1]))
    assert trimesh.Trimesh(*turned, process=False).volume == pytest.approx(0.06 * 0.09 * 0.05)


def test_files_of_meshes(folder):
    mesh = trimesh.creation.box((60, 90, 50))
    for name in ("box.stl", "box.obj", "box.ply"):
        mesh.export(folder / name)
        loaded = load_mesh(folder / name, scale=1e-3)
        np.testing.assert_allclose(np.ptp(loaded.vertices, axis=0), [0.06, 0.09, 0.05], rtol=1e-6)
    (folder / "bad.obj").write_text("v 1 2\nf 1 1 x\n")
    with pytest.raises(ValueError, match=r"bad\.obj"):
        load_mesh(folder / "bad.obj")
    with pytest.raises(FileNotFoundError, match="none.stl"):
        load_mesh(folder / "none.stl")
    with pytest.raises(ValueError, match="scale is -1"):
        load_mesh(folder / "box.stl", scale=-1.0)
    with pytest.raises(ValueError, match="levels is 0"):
        sphere_tree(BOX, 0)
