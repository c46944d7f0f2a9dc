"""The page of a teleoperation: geoms become surfaces, and a picture has the present poses, forces and torques."""

import time

import numpy as np
import pytest

from jaxgrasp.view.teleop_page import RATE, TeleopPage, bars_html, geom_surface

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


def test_a_picture_follows_the_robot(workplace):
    pytest.importorskip("viser")
    from jaxgrasp.view.viewer_server import serving

    follower, home = workplace.follower, workplace.task.home
    workplace.reset()
    with serving(port=0) as server:
        page = TeleopPage(server, follower, JOINTS)
        for k in range(50):
            follower.command(0.002 * k, workplace.retargeting.open, home._replace(origin=home.origin + [0, 0.1, 0]))
            follower.read(0.002 * (k + 1))
        time.sleep(1 / RATE)
        page.show("the robot <moves>", np.zeros(2), np.ones(2))
        body = follower.model.body("object").id
        assert page._frames[body].position == pytest.approx(follower.data.xpos[body])
        assert "&lt;moves&gt;" in page._words.content
        moved = [b for b in page._frames if "distal" in follower.model.body(b).name]
        assert moved and all(page._frames[b].position == pytest.approx(follower.data.xpos[b]) for b in moved)
