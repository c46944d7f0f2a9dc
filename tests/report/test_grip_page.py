"""The page of a grip is one offline file: what it draws stands where hand, object and contacts are."""

import json
import re
import sys

import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrasp.grip import CYLINDRICAL_POWER_GRIP, Body, Hold, Scene, Touch
from jaxgrasp.hand import (
    Box,
    Capsule,
    Cylinder,
    Plane,
    Pose,
    Posture,
    Shape,
    Sphere,
    human_hand,
    link_contributions,
    signed_distance,
)
from jaxgrasp.hand.kinematics import pose_hand
from jaxgrasp.report import bundle
from jaxgrasp.report.grip_over_time import History, Scale, Stage
from jaxgrasp.report.grip_page import FRAMES, grip_html, write_grip_page
from jaxgrasp.report.grip_pictures import instants_figure, write_grip_pictures
from jaxgrasp.report.panels import label_heights, panels, spells, value_range
from jaxgrasp.report.surfaces import arrow, arrows, hull, link_surfaces, placed, shape_surface

HAND = human_hand()
LINKS, JOINTS = len(HAND.links), len(HAND.joints)
SHAPES = [Sphere(0.03), Cylinder(0.03, 0.12), Capsule(0.03, 0.1), Box(0.06, 0.04, 0.12)]


def scene(shape: Shape = SHAPES[1], table: float = -0.5) -> Scene:
    return Scene(
        HAND,
        Body(shape, 0.4),
        Pose(jnp.array([0.0, 0.0, table]), jnp.eye(3)),
        0.6,
        1000.0,
        link_contributions(HAND, CYLINDRICAL_POWER_GRIP),
        jnp.array([0.0, 0.0, -9.81]),
    )


def turns(count: int) -> np.ndarray:
    """Return rotations about x by up to a right angle."""
    angles = np.linspace(0, np.pi / 2, count)
    rotations = np.broadcast_to(np.eye(3), (count, 3, 3)).copy()
    rotations[:, 1:, 1:] = np.array([[np.cos(angles), -np.sin(angles)], [np.sin(angles), np.cos(angles)]]).transpose(
        2, 0, 1
    )
    return rotations


def posture(count: int) -> Posture:
    """Return postures of a hand that rises, turns and bends."""
    fraction = np.linspace(0, 1, count)
    origin = 0.2 * fraction[:, None] * np.array([0, 0, 1.0])
    return Posture(Pose(origin, turns(count)), 0.5 * fraction[:, None] * np.ones(JOINTS))


def happened(count: int = 5, contacts: tuple[int, ...] = (2, 5, 9)) -> History:
    """Return a history in which a few links touch until the object is lost at the end; one slides, one pulls."""
    links = pose_hand(HAND, posture(count)).links
    poses = np.concatenate([links.rotation, links.origin[..., None]], -1)
    is_touching = np.isin(np.arange(LINKS), contacts) & (np.arange(count) < count - 1)[:, None]
    touches = np.where(is_touching, Touch.HOLDS, Touch.ABSENT)
    if len(contacts) > 2:
        touches[:-1, contacts[1]], touches[:-1, contacts[2]] = Touch.SLIDES, Touch.PULLS
    normals = np.broadcast_to([0.0, 0.0, -1.0], (count, LINKS, 3))
    forces = is_touching[..., None] * np.array([0.5, 0.0, -2.0])
    return History(
        fingers=tuple(link.finger for link in HAND.links),
        links=tuple(link.name for link in HAND.links),
        joint_fingers=tuple(name.split()[0] for name in HAND.joints),
        joints=HAND.joints,
        times=np.linspace(0, 1, count),
        link_poses=poses,
        object_pose=np.concatenate([turns(count), np.full((count, 3, 1), 0.05)], -1),
        points=np.where(is_touching[..., None], poses[..., 3], 0),
        normals=normals,
        forces=forces,
        touches=touches,
        squeeze=np.where(is_touching, 2.0, 0.0),
        margins=np.where(is_touching, 0.2, np.nan),
        torques=np.linspace(0, 1, count)[:, None] * np.linspace(-1, 0.1, JOINTS),
        hold=np.array([Hold.STABLE] * (count - 1) + [Hold.LOST]),
    )


def page(history: History, shape: Shape = SHAPES[1], **details: str) -> str:
    return grip_html(scene(shape), history, title="A grip", details=details)


def stored(html: str, name: str) -> dict:
    return json.loads(re.search(rf'<script type="application/json" id="{name}">(.*?)</script>', html, re.S)[1])


def outward(surface) -> np.ndarray:
    """Return six times the volume from the surface's middle to each triangle: positive where it faces outwards."""
    a, b, c = (surface.corners[surface.faces[:, k]] - surface.corners.mean(0) for k in range(3))
    return np.einsum("fi,fi->f", np.cross(b - a, c - a), a)


def test_skin_lies_on_its_spheres_and_holds_them():
    centers, radii = np.asarray(HAND.skin.centers), np.asarray(HAND.skin.radii)
    for surface, center, sizes in zip(link_surfaces(HAND), centers, radii, strict=True):
        off = np.linalg.norm(surface.corners[:, None] - center, axis=-1) - sizes
        np.testing.assert_allclose(off.min(1), 0, atol=1e-12)
        assert (outward(surface) > -1e-15).all()
        # A convex skin reaches as far as its spheres in the directions of its own corners, and nowhere further.
        directions = surface.corners - surface.corners.mean(0)
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        reach = (center @ directions.T + sizes[:, None]).max(0)
        assert (surface.corners @ directions.T).max(0) == pytest.approx(reach, abs=0.02 * sizes.max())


def test_spheres_of_radius_zero_are_left_out():
    alone = hull(np.zeros((1, 3)), np.array([0.01]))
    combined = hull(np.array([[0.0, 0, 0], [5, 0, 0]]), np.array([0.01, 0]))
    np.testing.assert_array_equal(alone.corners, combined.corners)
    assert not len(hull(np.zeros((2, 3)), np.zeros(2)).corners)


def test_posed_skin_stands_where_the_hand_does():
    history = happened()
    for k, surface in enumerate(link_surfaces(HAND)):
        corners = placed(surface.corners, history.link_poses[:, k])
        centers = placed(np.asarray(HAND.skin.centers[k]), history.link_poses[:, k])
        off = np.linalg.norm(corners[:, :, None] - centers[:, None], axis=-1) - np.asarray(HAND.skin.radii[k])
        np.testing.assert_allclose(off.min(-1), 0, atol=1e-7)


@pytest.mark.parametrize("shape", SHAPES, ids=lambda shape: type(shape).__name__)
def test_object_is_drawn_by_its_surface(shape):
    surface = shape_surface(shape)
    lines = surface.lines[np.isfinite(surface.lines).all(1)]
    for points in (surface.corners, lines):
        assert np.abs(signed_distance(shape, points)[0]).max() < 1e-6
    assert len(lines) and (outward(surface) > -1e-15).all()


def test_a_shape_without_end_cannot_be_drawn():
    with pytest.raises(TypeError, match="a Plane cannot be drawn"):
        shape_surface(Plane())


def test_arrows_start_at_their_tails_and_end_at_their_tips():
    rng = np.random.default_rng(1)
    tails, vectors = rng.normal(size=(2, 4, 3))
    vectors[2] = 0
    drawn = arrows(tails, vectors, 0.1).corners.reshape(-1, len(arrow().corners), 3)
    indices = [0, 1, 3]
    assert len(drawn) == 3
    np.testing.assert_allclose(drawn[:, :8].mean(1), tails[indices], atol=1e-12)
    np.testing.assert_allclose(drawn[:, -8:].mean(1), (tails + vectors)[indices], atol=1e-12)


def test_page_holds_every_frame_and_each_contact_where_it_is():
    history = happened()
    film = stored(page(history), "film")
    assert [frame["time"] for frame in film["frames"]] == history.times.tolist()
    for k, frame in enumerate(film["frames"]):
        links = frame["contacts"]["links"]
        assert links == np.flatnonzero(history.touches[k] != Touch.ABSENT).tolist()
        rows = np.array(frame["contacts"]["vectors"]).reshape(-1, 9)
        expected = [history.points[k, links], history.normals[k, links], history.forces[k, links]]
        np.testing.assert_allclose(rows, np.concatenate(expected, -1), atol=1e-5)
        poses = np.concatenate([history.link_poses[k], history.object_pose[k][None]])
        np.testing.assert_allclose(np.array(frame["poses"]).reshape(-1, 3, 4), poses, atol=1e-5)
    assert film["frames"][0]["said"] == "stable: 3 contacts, 1 hold, 1 slide, 1 pull"
    assert film["frames"][-1]["said"] == "lost: nothing touches" and not film["frames"][-1]["contacts"]["links"]


def test_page_opens_offline_and_says_its_scale():
    history = happened()
    html = page(history, note="<b>")
    words = html.replace(bundle.plotly_bundle(), "")
    assert "http://" not in words and "https://" not in words and "default-src 'none'" in words
    assert "<b>" not in words and "&lt;b&gt;" in words
    scale = Scale.of(history)
    assert f"{1000 * scale.length:g} mm for {scale.newtons:g} N" in words
    assert all(touch in words for touch in ("holds", "slides", "pulls"))


def test_figures_are_ones_that_plotly_knows():
    go = pytest.importorskip("plotly.graph_objects")
    for shape in SHAPES:
        html = page(happened(), shape)
        go.Figure(stored(html, "film")["figure"])
        go.Figure(stored(html, "plots-data"))


def test_long_grips_show_a_hundred_frames_and_plot_all():
    html = page(happened(count=4 * FRAMES + 1))
    frames = stored(html, "film")["frames"]
    assert len(frames) == FRAMES and frames[0]["time"] == 0 and frames[-1]["time"] == 1
    assert len(stored(html, "plots-data")["data"][0]["x"]) == 4 * FRAMES + 1
    assert len(html) < 6e6


def test_what_is_not_a_number_leaves_a_gap_and_no_more():
    history = happened()
    history.points[1, 2] = np.nan
    history.forces[0, 5, 1] = np.nan
    history.link_poses[2, 3] = np.nan
    history.torques[1, 0] = np.nan
    html = page(history)
    frames = stored(html, "film")["frames"]
    assert frames[1]["contacts"]["links"] == [5, 9]
    assert frames[2]["poses"][3] == [None] * 12
    assert stored(html, "plots-data")["data"][10]["y"][1] is None


def test_a_table_is_drawn_where_it_is_near():
    history = happened()
    assert Stage.of(scene(table=-0.5), history).table is None
    stage = Stage.of(scene(table=-0.1), history)
    assert stage.table is not None and stage.table.corners[:, 2] == pytest.approx(-0.1)
    assert stage.box[0, 2] <= -0.1
    # In a picture only where it lies within the axes: below the hand at first, and no more once it has risen.
    figure = instants_figure(scene(table=-0.05), happened(contacts=()), {"closed": 0, "lifted": 3})
    assert [len(axes.collections) for axes in figure.axes] == [2, 1]


def test_everything_held_lies_in_the_box():
    history = happened()
    stage = Stage.of(scene(), history)
    for k, link in enumerate(stage.links):
        corners = placed(link.corners, history.link_poses[:, k])
        assert (corners > stage.box[0]).all() and (corners < stage.box[1]).all()


def test_panels_sum_up_fingers():
    history = happened()
    force, torque, margin = panels(history)
    solid = {line.label: line.values for line in force.lines if line.label}
    pressing = 2.0 * (history.touches != Touch.ABSENT)
    for finger, values in solid.items():
        np.testing.assert_allclose(values, pressing[:, np.array(history.fingers) == finger].sum(1))
    assert [line.name for line in torque.lines] == list(HAND.joints)
    assert sum(bool(line.label) for line in torque.lines) == 5
    touched = next(line for line in margin.lines if line.label == history.fingers[2])
    np.testing.assert_allclose(touched.values, [*[np.degrees(0.2)] * 4, np.nan])
    fingers = {history.fingers[link] for link in (2, 5, 9)}
    assert {line.label for line in margin.lines} == {*fingers, ""}, "who touches nothing has no margin, nor a name at 0"
    assert spells(history) == [(1.0, 1.0, Hold.LOST)]


def test_labels_keep_apart_in_order_and_inside():
    heights = label_heights([1.0, 0.9, 0.0, 1.0], 0.0, 1.0, 0.2)
    assert np.diff(np.sort(heights)).min() == pytest.approx(0.2)
    assert max(heights) <= 1 and heights[2] < heights[1] < heights[0]


def test_a_short_peak_does_not_flatten_a_plot():
    history = happened(count=200)
    history.torques[100] = 1e3
    low, high = value_range(panels(history)[1])
    assert low < -0.9 and 0 < high < 5


def test_one_instant_is_enough(tmp_path):
    assert len(stored(page(happened(count=1)), "film")["frames"]) == 1
    assert len(write_grip_pictures(tmp_path, scene(), happened(count=1), {"now": 0.0})) == 2


def test_pictures_are_written_whole(tmp_path):
    history = happened()
    history.link_poses[2, 3] = np.nan
    history.points[1, 2] = np.nan
    paths = write_grip_pictures(tmp_path, scene(), history, {"closed": 0.0, "turned": 0.5, "end": 1.0})
    assert [path.name for path in paths] == ["grip.png", "grip_forces.png"] and sorted(paths) == sorted(
        tmp_path.iterdir()
    )
    assert all(path.read_bytes().startswith(b"\x89PNG") and path.stat().st_size > 20_000 for path in paths)


def test_pictures_name_each_instant_and_what_becomes_of_the_object():
    figure = instants_figure(scene(), happened(), {"closed": 0, "end": 4})
    assert [axes.get_title() for axes in figure.axes] == ["closed, 0.00 s", "end, 1.00 s"]
    titles = [axes.texts[0].get_text() for axes in figure.axes]
    assert titles == ["stable: 3 contacts, 1 hold, 1 slide, 1 pull", "lost: nothing touches"]
    # Solids, normals, and a heap of arrows for each of holds, slides, pulls; no arrow where nothing touches.
    assert [len(axes.collections) for axes in figure.axes] == [5, 1]


def test_what_stands_still_is_seen_from_four_sides():
    history = happened()
    for poses in (history.link_poses, history.object_pose):
        poses[:] = poses[0]
        poses[..., 2, 3] += np.arange(len(poses)).reshape(-1, *[1] * (poses.ndim - 3))
    shown = {"closed": 0, "lifted": 1, "held": 2, "end": 3}
    figure = instants_figure(scene(), history, shown)
    assert len({axes.azim % 360 for axes in figure.axes}) == 4
    history.object_pose[1:, 0, 3] += 0.01
    figure = instants_figure(scene(), history, shown)
    assert [axes.azim % 360 for axes in figure.axes] == [52, 52, 232, 142]


def test_matplotlib_missing_is_one_line(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(ImportError, match=r"pip install 'jaxgrasp\[report\]'"):
        write_grip_pictures(tmp_path, scene(), happened(), {"closed": 0.0})
    assert not list(tmp_path.iterdir())


def test_plotly_missing_is_one_line(monkeypatch, tmp_path):
    bundle.plotly_bundle.cache_clear()
    monkeypatch.setitem(sys.modules, "plotly.offline", None)
    with pytest.raises(ImportError, match=r"pip install 'jaxgrasp\[report\]'"):
        write_grip_page(tmp_path / "grip.html", scene(), happened(), title="", details={})
    assert not list(tmp_path.iterdir())
