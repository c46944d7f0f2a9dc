"""Meshes of several shells: cavities stay cavities, and what would count twice is refused by name."""

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from jaxgrasp.hand import Mesh, check_mesh, load_mesh, sphere_tree
from jaxgrasp.hand.mesh import MeshSurface, mass_properties
from jaxgrasp.hand.mesh_shells import winding_number


def box(sides=(1.0, 1.0, 1.0), at=(0.0, 0.0, 0.0)) -> trimesh.Trimesh:
    return trimesh.creation.box(sides).apply_translation(at)


def inverted(solid: trimesh.Trimesh) -> trimesh.Trimesh:
    return trimesh.Trimesh(solid.vertices, np.asarray(solid.faces)[:, ::-1], process=False)


def joined(*parts: trimesh.Trimesh) -> trimesh.Trimesh:
    return trimesh.util.concatenate(parts)


def of_trimesh(solid: trimesh.Trimesh) -> Mesh:
    return Mesh(np.array(solid.vertices), np.array(solid.faces))


OUTER, CAVITY = box((6, 6, 12)), box((5, 5, 8), (0, 0, 1.5))
BOTTLE = joined(OUTER, inverted(CAVITY))
BALL = joined(trimesh.creation.icosphere(2, 3.0), inverted(trimesh.creation.icosphere(2, 2.0)))
DOLLS = joined(box((6, 6, 6)), inverted(box((4, 4, 4))), box((2, 2, 2), (0.5, 0, 0)))
SOLIDS = {
    "bottle": BOTTLE,
    "ball": BALL,
    "dolls": DOLLS,
    "two cavities": joined(box((9, 4, 4)), inverted(box(at=(2, 0, 0))), inverted(box(at=(-2.5, 0.5, 0)))),
    "two bottles": joined(BOTTLE, BOTTLE.copy().apply_translation([20, 0, 0])),
    "apart": joined(box(), box(at=(3, 0.2, 0))),
    "one vertex": joined(box(), box(at=(1, 1, 1))),
    "hooks": joined(
        trimesh.creation.annulus(2, 3, 1), trimesh.creation.annulus(2, 3, 1).apply_transform(
            trimesh.transformations.rotation_matrix(np.pi / 2, [1, 0, 0])).apply_translation([2.5, 0, 0])
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", SOLIDS)
@pytest.mark.parametrize("seed", range(3))
def test_volume_and_centre_are_those_of_the_winding_in_the_file(name, seed):
    """However the mesh is turned, moved, ordered or written inside out."""
    solid, rng = SOLIDS[name], np.random.default_rng(seed)
    turn, shift = Rotation.random(rng=seed).as_matrix(), rng.normal(size=3)
    faces = rng.permutation(np.asarray(solid.faces))
    if seed == 2:
        faces = faces[:, ::-1]
    properties = mass_properties(check_mesh(Mesh(np.asarray(solid.vertices) @ turn.T + shift, faces)))
    assert properties.volume == pytest.approx(solid.volume, rel=1e-9)
    np.testing.assert_allclose(properties.center, turn @ solid.center_mass + shift, atol=1e-9)


def test_a_shell_by_itself_that_is_inside_out_is_turned_with_what_lies_in_it():
    apart = inverted(BOTTLE).apply_translation([20, 0, 0])
    properties = mass_properties(check_mesh(of_trimesh(joined(BOTTLE, apart))))
    assert properties.volume == pytest.approx(2 * BOTTLE.volume)
    np.testing.assert_allclose(properties.center, BOTTLE.center_mass + [10, 0, 0], atol=1e-9)


@pytest.mark.parametrize("face", [0, 5, 11])
def test_an_outer_shell_that_is_wound_in_two_ways_is_made_one(face):
    faces = np.array(BOTTLE.faces)
    faces[face] = faces[face, ::-1]
    assert mass_properties(check_mesh(Mesh(np.array(BOTTLE.vertices), faces))).volume == pytest.approx(BOTTLE.volume)


def test_no_ball_lies_in_a_cavity(folder):
    BOTTLE.export(folder / "bottle.stl")
    tree = sphere_tree(load_mesh(folder / "bottle.stl", scale=0.01), levels=4)
    centers, radii = np.asarray(tree.balls.centers), np.asarray(tree.balls.radii)
    inside = MeshSurface(check_mesh(of_trimesh(CAVITY.copy().apply_scale(0.01))), 0.01).nearest(centers).distance
    assert np.all(inside >= radii * (1 - 1e-6))


def test_a_triangle_without_area_is_no_matter():
    cube = box()
    faces = np.concatenate([cube.faces, [[0, 0, 1], [2, 3, 2]]])
    assert mass_properties(check_mesh(Mesh(np.array(cube.vertices), faces))).volume == pytest.approx(1)


def klein_bottle() -> trimesh.Trimesh:
    """Return a closed one-sided surface: a torus whose last ring meets the first reversed."""
    n = 6
    vertices = np.random.default_rng(0).normal(size=(n * n, 3))

    def at(i: int, j: int) -> int:
        return (i % n) * n + (j % n if i < n else -j % n)

    quads = [(at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)) for i in range(n) for j in range(n)]
    faces = [face for a, b, c, d in quads for face in ((a, b, c), (a, c, d))]
    return trimesh.Trimesh(vertices, faces, process=False)


def half_wound(solid: trimesh.Trimesh, face: int) -> trimesh.Trimesh:
    faces = np.array(solid.faces)
    faces[face] = faces[face, ::-1]
    return trimesh.Trimesh(solid.vertices, faces, process=False)


REFUSED = {
    "overlap": (joined(box(), box(at=(0.5, 0.2, 0.1))), "shells 0 and 1 of the mesh overlap or touch near"),
    "cross": (joined(box((3, 1, 1)), box((1, 3, 1.1))), "shells 0 and 1 of the mesh overlap or touch"),
    "through a large face": (joined(box((9, 9, 9)), trimesh.creation.icosphere(2, 1).apply_translation([4.5, 0, 0])),
                             "shells 0 and 1 of the mesh overlap"),
    "parts of faces": (joined(box(), box(at=(1, 0.5, 0))), "overlap or touch"),
    "face": (joined(box(), box(at=(1, 0, 0))), "4 of the mesh's edges have more than two faces, the first has 4"),
    "edge": (joined(box(), box(at=(1, 1, 0))), r"1 of .* has 4, from \(0.5, 0.5, -0.5\) to \(0.5, 0.5, 0.5\)"),
    "twice": (joined(box(), box()), "18 of the mesh's edges have more than two faces"),
    "solid in a solid": (joined(OUTER, CAVITY), "shell 1 of the mesh lies in shell 0 and faces the same way"),
    "cavity in a cavity": (joined(box((6, 6, 6)), inverted(box((4, 4, 4))), inverted(box((2, 2, 2)))),
                           "shell 2 of the mesh lies in shell 1 and faces the same way"),
    "cavity of two windings": (half_wound(BOTTLE, -1), "shell 1 .* lies in shell 0 and is wound in two ways"),
    "open": (trimesh.Trimesh(BOTTLE.vertices, BOTTLE.faces[:-1], process=False), "3 edges have a face on one"),
    "one side": (klein_bottle(), "a shell with one side only"),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_what_would_count_twice_is_refused_by_name(name):
    solid, message = REFUSED[name]
    with pytest.raises(ValueError, match=message):
        check_mesh(of_trimesh(solid))


UNITED = {
    "overlap": ([box(), box(at=(0.5, 0.2, 0.1))], 2 - 0.5 * 0.8 * 0.9),
    "cross": ([box((3, 1, 1)), box((1, 3, 1.1))], 3 + 3.3 - 1),
    "parts of faces": ([box(), box(at=(1, 0.5, 0))], 2),
    "face": ([box(), box(at=(1, 0, 0))], 2),
    "inside out": ([inverted(box()), inverted(box(at=(0.5, 0.2, 0.1)))], 2 - 0.5 * 0.8 * 0.9),
    "three": ([box(), box(at=(0.5, 0, 0)), box(at=(5, 0, 0))], 2.5),
}


@pytest.mark.parametrize("name", UNITED)
@pytest.mark.parametrize("suffix", ["obj", "stl"])
def test_solids_of_a_file_that_overlap_are_united(folder, name, suffix):
    pieces, volume = UNITED[name]
    if (name, suffix) == ("face", "stl"):
        pytest.skip("its corners are merged by position, and then the solids cannot be told apart")
    joined(*pieces).export(folder / f"a.{suffix}")
    words = rf"a\.{suffix}: {len(pieces)} pieces of the mesh overlap or touch; they are united to one solid of"
    with pytest.warns(UserWarning, match=words):
        mesh = load_mesh(folder / f"a.{suffix}", scale=0.1)
    assert mass_properties(mesh).volume == pytest.approx(volume * 1e-3, rel=1e-6)


def test_pieces_that_are_no_solids_are_not_united(folder):
    cavity = inverted(box((0.2, 0.2, 0.2), (-0.3, 0, 0)))
    joined(box(), box(at=(0.5, 0.2, 0.1)), cavity).export(folder / "a.obj")
    with pytest.raises(ValueError, match="overlap or touch near"):
        load_mesh(folder / "a.obj")


def test_a_vertex_of_a_file_that_is_no_number_is_named(folder):
    vertices = np.array(box().vertices)
    vertices[2, 1] = np.nan
    for name in ("a.ply", "a.off"):
        trimesh.Trimesh(vertices, box().faces, process=False).export(folder / name)
        with pytest.raises(ValueError, match=rf"{name}: vertices\[2, 1\] is nan: expected a finite number \[m\]"):
            load_mesh(folder / name)
    trimesh.PointCloud(np.eye(3)).export(folder / "points.ply")
    with pytest.raises(ValueError, match=r"points\.ply"):
        load_mesh(folder / "points.ply")


def test_winding_numbers_are_whole():
    points = np.random.default_rng(0).uniform(-2.9, 2.9, (20, 3)) * [1, 1, 2]
    turns = np.array([winding_number(np.asarray(BOTTLE.triangles), point) for point in points])
    in_cavity = np.all(np.abs(points - [0, 0, 1.5]) < [2.5, 2.5, 4], axis=1)
    np.testing.assert_allclose(turns, np.where(in_cavity, 0, 1), atol=1e-9)
