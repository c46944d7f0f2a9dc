"""The page of a teleoperation: geoms become surfaces, and a picture has the present poses, forces and torques."""

import contextlib
import time

import numpy as np
import pytest

from jaxgrasp.glove.glove_device import LinkState
from jaxgrasp.glove.guard import GuardState
from jaxgrasp.glove.loop.exchange import Slot
from jaxgrasp.glove.substitution import Sensations
from jaxgrasp.view.teleop_page import MAX_CONTACTS, NO_GLOVE, TeleopPage, TeleopPicture, bars_html, geom_surface
from jaxgrasp.view.view_slots import ViewFrame

JOINTS = ("index MP", "middle <MP>")


def test_surfaces_are_those_of_the_geoms(workplace):
    mujoco = pytest.importorskip("mujoco")
    model = workplace.follower.model
    for name, extent in {"grip": 2 * np.array([0.018, 0.035, 0.022]), "peg": np.array([0.024, 0.024, 0.06])}.items():
        corners, faces = geom_surface(mujoco, model, model.geom(name).id)
        assert np.ptp(corners, axis=0) == pytest.approx(extent, rel=0.01)
        assert faces.min() == 0 and faces.max() == len(corners) - 1
    assert geom_surface(mujoco, model, model.geom("table").id) is None


def test_bars_are_shares_of_the_limits_and_names_are_escaped():
    html = bars_html(JOINTS, np.array([0.06, 0.3]), np.array([0.12, 0.12]))
    assert 'value="0.500"' in html and 'value="1.000"' in html and "&lt;MP&gt;" in html and "60 mN" in html


def picture(follower, words: str, contacts: int = 2, sensations: Sensations | None = None) -> TeleopPicture:
    rng = np.random.default_rng(contacts)
    poses = np.concatenate([follower.data.xpos, follower.data.xquat], 1)
    return TeleopPicture(poses, rng.normal(size=(contacts, 3)), rng.normal(size=(contacts, 3)), words, sensations)


@pytest.mark.parametrize("contacts", [0, 3, MAX_CONTACTS, MAX_CONTACTS + 9])
@pytest.mark.parametrize("sensations", [None, Sensations(np.linspace(0, 1, 5), np.full(5, 38.0))])
def test_a_picture_is_unpacked_as_it_was_packed(workplace, contacts, sensations):
    sent = picture(workplace.follower, "words", contacts, sensations)
    n_bodies = workplace.follower.model.nbody
    vector = sent.vector()
    assert len(vector) == TeleopPicture.size(n_bodies)
    got = TeleopPicture.of(vector, n_bodies)
    np.testing.assert_array_equal(got.poses, sent.poses)
    largest = np.argsort(-np.linalg.norm(sent.forces, axis=-1))[:MAX_CONTACTS]
    np.testing.assert_array_equal(got.forces, sent.forces[largest])
    np.testing.assert_array_equal(got.points, sent.points[largest])
    assert got.words == "words" and (got.sensations is None) == (sensations is None)
    assert sensations is None or np.array_equal(got.sensations.vector(), sensations.vector())


def test_a_picture_follows_the_robot(workplace, tmp_path):
    pytest.importorskip("viser")
    from jaxgrasp.view.viewer_server import serving

    follower, home = workplace.follower, workplace.task.home
    workplace.reset()
    limits, zeros = np.array([0.12, 0.12]), np.zeros(2)
    slot = Slot(tmp_path / "slot", ViewFrame.size(2, TeleopPicture.size(follower.model.nbody)), create=True)
    with contextlib.closing(slot), serving(port=0) as server:
        page = TeleopPage(server, follower.model, np.zeros(3), JOINTS, limits, slot)
        page.frame()
        for k in range(50):
            follower.command(0.002 * k, workplace.retargeting.open, home._replace(origin=home.origin + [0, 0.1, 0]))
            follower.read(0.002 * (k + 1))
        moving = picture(follower, "the robot <moves>").vector()
        slot.write(ViewFrame(0.0, NO_GLOVE, 0, zeros, limits / 2, zeros, moving).vector())
        page.frame()
        body = follower.model.body("object").id
        assert page._frames[body].position == pytest.approx(follower.data.xpos[body])
        assert "&lt;moves&gt;" in page._words.content and "60 mN" in page._bars.content
        assert page._notice.html == "", "there is no glove"
        moved = [b for b in page._frames if "distal" in follower.model.body(b).name]
        assert moved and all(page._frames[b].position == pytest.approx(follower.data.xpos[b]) for b in moved)
        latched = (time.perf_counter(), LinkState.LINKED, GuardState.LATCHED)
        frame = ViewFrame(*latched, zeros, zeros, zeros, moving, cause="a cable broke", ticked_at=time.perf_counter())
        slot.write(frame.vector())
        page.frame()
        assert "No torque is felt" in page._notice.html and "a cable broke" in page._notice.html
