"""Contacts, cones and arrows as bodies: where their ends come to lie."""

import numpy as np
from scipy.spatial.transform import Rotation

from jaxgrasp.view.drawing import HEAD, NOTHING, Instances, arrows, cones, dots, turned_to
from jaxgrasp.view.viewer import cone, head, linear, segments, shaft

RNG = np.random.default_rng(0)
AXES = np.vstack([RNG.normal(size=(50, 3)), np.eye(3), -np.eye(3)])
AXES /= np.linalg.norm(AXES, axis=1, keepdims=True)


def corners_of(instances: Instances, body, k: int) -> np.ndarray:
    turned = Rotation.from_quat(instances.quaternions[k], scalar_first=True).apply(instances.scales[k] * body.corners)
    return instances.positions[k] + turned


def test_z_is_turned_to_any_axis():
    turned = Rotation.from_quat(turned_to(AXES), scalar_first=True).apply([0.0, 0.0, 1.0])
    np.testing.assert_allclose(turned, AXES, atol=1e-7)


def test_an_arrow_goes_from_its_tail_to_its_tip():
    vectors = AXES * np.linspace(0.002, 0.1, len(AXES))[:, None]
    arrow_set = arrows(AXES, vectors, "#D55E00")
    for k, vector in enumerate(vectors):
        along = vector / np.linalg.norm(vector)
        reach = (
            np.vstack([corners_of(arrow_set.shafts, shaft(), k), corners_of(arrow_set.heads, head(), k)]) - AXES[k]
        ) @ along
        np.testing.assert_allclose([reach.min(), reach.max()], [0, np.linalg.norm(vector)], atol=1e-8)
        assert arrow_set.heads.scales[k, 2] <= min(HEAD, np.linalg.norm(vector) / 2) + 1e-12


def test_what_is_not_there_is_not_seen_and_all_numbers_are_finite():
    nothing = np.zeros((4, 3))
    is_present, colours = np.zeros(4, bool), np.zeros((4, 3), np.uint8)
    for instances in (
        *arrows(nothing, nothing, "#000000"),
        dots(nothing, is_present, 0.01, colours),
        cones(nothing, nothing, np.full(4, np.nan), is_present, 0.01, colours),
    ):
        assert all(np.isfinite(array).all() for array in instances)
        assert instances.scales.max() <= NOTHING


def test_a_cone_opens_by_friction_and_keeps_its_side():
    friction = np.linspace(0, 2, len(AXES))
    cone_set = cones(AXES, AXES, friction, np.ones(len(AXES), bool), 0.02, np.zeros((len(AXES), 3), np.uint8))
    for k, mu in enumerate(friction):
        rim = corners_of(cone_set, cone(), k)[-20:] - AXES[k]
        along = rim @ AXES[k]
        across = np.linalg.norm(rim - along[:, None] * AXES[k], axis=1)
        np.testing.assert_allclose(across, mu * along, atol=1e-6)
        np.testing.assert_allclose(np.linalg.norm(rim, axis=1), 0.02, atol=1e-6)


def test_bodies_are_seen_from_outside():
    for body in (shaft(), head(), cone()):
        a, b, c = (body.corners[body.faces[:, i]] for i in range(3))
        out = np.cross(b - a, c - a)
        middle = (a + b + c) / 3 - [0.0, 0.0, 0.5]
        sized = np.linalg.norm(out, axis=1) > 1e-9
        assert (np.sum(out * middle, axis=1)[sized] > 0).mean() > 0.95


def test_lines_become_their_segments():
    lines = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [np.nan] * 3, [5, 0, 0], [6, 0, 0], [np.nan] * 3])
    np.testing.assert_array_equal(segments(lines)[:, :, 0], [[0, 1], [1, 2], [5, 6]])


def test_colours_of_instances_are_in_proportion_to_light():
    np.testing.assert_array_equal(linear(np.array([[0, 255, 188]], np.uint8)), [[0, 255, 128]])
