"""Small MJCF files that ask for more than a machine has: refused by a count of what MuJoCo would build."""

import os
import struct
from pathlib import Path
from xml.etree import ElementTree

import pytest

from jaxgrasp.interop import hand_from_urdf, load_mjcf, read_hand
from jaxgrasp.interop.mjcf_file import _Counter

mujoco = pytest.importorskip("mujoco")

HINGE = '<joint type="hinge" axis="0 1 0" range="0 90"/><geom type="capsule" size="0.01 0.02"/>'
FINGER = f'<body name="b">{HINGE}</body>'


def mjcf(below: str = FINGER, beside: str = "") -> str:
    return f'<mujoco>{beside}<worldbody><body name="w">{below}</body></worldbody></mujoco>'


def asset(text: str) -> str:
    return mjcf(beside=f"<asset>{text}</asset>")


HOSTILE = {
    "replicate": (mjcf(f'<replicate count="1e8">{FINGER}</replicate>'), "makes 300,000,00. elements"),
    "nested": (mjcf('<replicate count="100">' * 5 + FINGER + "</replicate>" * 5), "makes 30,101,010,10. elements"),
    "huge": (
        mjcf('<replicate count="1e300">' * 150 + FINGER + "</replicate>" * 150),
        "makes 1,000,000,000,000 elements",
    ),
    "bodies": (mjcf('<replicate count="2100"><body/></replicate>' + FINGER), "makes 2,10. bodies"),
    "written": (mjcf("<body/>" * 2100 + FINGER), "makes 2,10. bodies"),
    "infinite": (mjcf(f'<replicate count="inf">{FINGER}</replicate>'), "<replicate> has count='inf': expected finite"),
    "flexcomp": (mjcf(FINGER + '<flexcomp name="f" count="1000 1000 100"/>'), "makes 100,000,00. elements"),
    "hfield": (asset('<hfield name="h" nrow="200000" ncol="200000" size="1 1 1 1"/>'), "has 40,000,000,000 cells"),
    "hfields": (asset('<hfield nrow="4096" ncol="4096" size="1 1 1 1"/>' * 3), "and all have 50,331,648"),
    "texture": (asset('<texture type="2d" builtin="flat" width="60000" height="60000"/>'), "3,600,000,000 cells"),
    "skybox": (asset('<texture type="skybox" builtin="flat" width="20000"/>'), "has 2,400,000,000 cells"),
    "camera": (mjcf('<camera resolution="100000 100000"/>' + FINGER), "has 10,000,000,000 cells"),
    "cone": (asset('<mesh name="m" builtin="cone" params="100000000 1"/>'), "name='m'> has params='100000000 1'"),
    "plate": (asset('<mesh name="m" builtin="plate" params="100000 100000"/>'), "at most 200 each"),
    "keys": (mjcf(beside='<size nkey="200000000"/>'), "<size> has nkey='200000000': expected at most 10,000"),
    "user data": (mjcf(beside='<size nuser_body="100000000"/>'), "nuser_body='100000000': expected at most 1,000"),
    "sensor": (mjcf(beside='<sensor><user dim="2000000000"/></sensor>'), "<user> has dim='2000000000'"),
    "deep": ("<mujoco>" + "<body>" * 200_000 + "</body>" * 200_000 + "</mujoco>", "nested 201 deep: expected a depth"),
    "entities": ('<!DOCTYPE mujoco [<!ENTITY a "1e8">]>' + mjcf(), "it has a document type"),
    "encoding": ('<?xml version="1.0" encoding="none"?>' + mjcf(), "unknown encoding"),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_what_would_fill_the_machine_is_refused_before_mujoco_sees_it(folder, monkeypatch, name):
    text, message = HOSTILE[name]
    (folder / "hand.xml").write_text(text)
    monkeypatch.setattr(mujoco, "MjSpec", None)
    for read in (read_hand, load_mjcf):
        with pytest.raises(ValueError, match=message) as caught:
            read("hand.xml")
        assert "hand.xml" in str(caught.value) and "\n" not in str(caught.value)


def test_files_that_hold_themselves_are_refused(folder):
    """MuJoCo 4.0 ends the process at the first of them."""
    attach = '<asset><model name="m" file="{}.xml"/></asset>'
    hand = '<frame><attach model="m" body="b" prefix="p"/></frame>'
    (folder / "self.xml").write_text(mjcf(FINGER + hand, attach.format("self")))
    (folder / "one.xml").write_text(mjcf(FINGER + hand, attach.format("two")))
    (folder / "two.xml").write_text(mjcf(FINGER + hand, attach.format("one")))
    (folder / "include.xml").write_text(mjcf().replace("<worldbody>", '<include file="include.xml"/><worldbody>'))
    for name in ("self", "one", "include"):
        with pytest.raises(ValueError, match="includes or attaches itself"):
            load_mjcf(f"{name}.xml")


def test_models_that_attach_one_another_are_counted_with_their_copies(folder):
    (folder / "0.xml").write_text(mjcf())
    for level in range(1, 30):
        twice = "".join(f'<frame><attach model="m" body="w" prefix="{i}"/></frame>' for i in range(2))
        (folder / f"{level}.xml").write_text(
            mjcf(FINGER + twice, f'<asset><model name="m" file="{level - 1}.xml"/></asset>')
        )
    with pytest.raises(ValueError, match=r"it makes [\d,]{12,} elements"):
        load_mjcf("29.xml")


def test_the_header_of_an_image_counts(folder):
    header = b"\x89PNG\r\n\x1a\n" + struct.pack(">I4sII", 13, b"IHDR", 100_000, 100_000)
    (folder / "bomb.png").write_bytes(header + bytes(20))
    for text in ('<hfield file="bomb.png" size="1 1 1 1"/>', '<texture type="2d" file="bomb.png"/>'):
        (folder / "hand.xml").write_text(asset(text))
        with pytest.raises(ValueError, match="has 10,000,000,000 cells"):
            load_mjcf("hand.xml")


def test_a_pipe_is_not_waited_for(folder):
    os.mkfifo("pipe")
    (folder / "hand.xml").write_text(mjcf().replace("<worldbody>", '<include file="pipe"/><worldbody>'))
    with pytest.raises(ValueError, match="<include file='pipe'> is not a regular file"):
        load_mjcf("hand.xml")
    with pytest.raises(ValueError, match="path is 'pipe': expected an MJCF file, but there is none"):
        load_mjcf("pipe")


@pytest.mark.parametrize(
    "below",
    [
        FINGER,
        f'<replicate count="7" euler="0 0 1">{FINGER}</replicate>',
        f'<replicate count="3"><frame><replicate count="4">{FINGER}</replicate></frame></replicate>',
        f'<replicate count="3"><body>{HINGE}<replicate count="2">{FINGER}</replicate></body></replicate>',
        '<include file="more.xml"/>' + FINGER,
        f'<replicate count="0">{FINGER}</replicate><body>{HINGE}</body>',
    ],
)
def test_as_many_bodies_are_counted_as_mujoco_makes(folder, below):
    (folder / "more.xml").write_text(f'<mujocoinclude><body name="c">{HINGE}</body></mujocoinclude>')
    (folder / "hand.xml").write_text(mjcf(below))
    cost = _Counter(Path("hand.xml")).file(ElementTree.parse("hand.xml").getroot(), Path("hand.xml"))
    assert cost.bodies == load_mjcf("hand.xml").nbody


@pytest.mark.parametrize("kind", [RuntimeError, MemoryError])
def test_whatever_mujoco_raises_is_a_value_error(folder, monkeypatch, kind):
    """MuJoCo reports arrays that it cannot allocate as an unknown exception, which becomes a ValueError too."""
    (folder / "hand.xml").write_text(mjcf())

    def refuse(*_: object) -> None:
        raise kind("Caught an unknown exception!")

    monkeypatch.setattr(mujoco, "MjSpec", type("MjSpec", (), {"from_file": refuse, "from_string": refuse}))
    with pytest.raises(ValueError, match=r"hand.xml is not a model that MuJoCo can read: Caught an unknown exception!"):
        load_mjcf("hand.xml")


def test_a_urdf_of_too_many_links_is_refused(folder):
    (folder / "many.urdf").write_text("<robot>" + "".join(f'<link name="{i}"/>' for i in range(2_001)) + "</robot>")
    with pytest.raises(ValueError, match="it has 2,001 links: expected at most 2,000"):
        hand_from_urdf("many.urdf", "a")
