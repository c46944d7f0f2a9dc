"""README and the pages of ``docs``: their Python runs as it stands, commands parse, and links lead somewhere."""

import ast
import inspect
import re
import shlex
from pathlib import Path

import nbformat
import numpy as np
import pytest
import tyro

import jaxgrasp
from benchmarks import readme
from jaxgrasp.cli.main import Command

ROOT = Path(__file__).parent.parent
README = ROOT / "README.md"
DOCS = sorted((ROOT / "docs").glob("*.md"))
PAGES = pytest.mark.parametrize("page", [README, *DOCS], ids=lambda page: page.stem)
LINK = re.compile(r"\]\(([^)\s]+)\)")


def blocks(page: Path, language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", page.read_text(), re.S | re.M)


def run(page: Path, names: dict) -> dict:
    """Run all the Python of a page, one block after the other; return its names."""
    for number, code in enumerate(blocks(page, "python")):
        exec(compile(code, f"{page.name}, block {number}", "exec"), names)
    return names


def anchors(page: Path) -> set[str]:
    """Return GitHub's anchors for the headings of a page."""
    headings = re.findall(r"^#+ (.*)$", re.sub(r"^```.*?^```", "", page.read_text(), flags=re.S | re.M), re.M)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.fixture(scope="module")
def ten_lines() -> dict:
    """Run README's ten lines and return their names; the other pages continue from them."""
    return run(README, {})


def test_the_ten_lines_run(ten_lines):
    (code,) = blocks(README, "python")
    assert len(code.strip().splitlines()) <= 16
    best, wrench = ten_lines["best"], ten_lines["wrench"]
    assert jaxgrasp.Verdict(int(best.verdict)).solved
    np.testing.assert_allclose(np.asarray(best.forces).sum(0), np.asarray(wrench)[:3], atol=1e-9)
    assert ten_lines["by_squeeze"].shape == (3, 3, 3)


QUICK_PAGES = ("answers",)


def _with_marks(page: Path):
    marks = () if page.stem in QUICK_PAGES else pytest.mark.slow
    return pytest.param(page, marks=marks, id=page.stem)


@pytest.mark.repeats
@pytest.mark.parametrize("page", [_with_marks(page) for page in DOCS if blocks(page, "python")])
def test_the_examples_run(page, ten_lines, capsys):
    run(page, dict(ten_lines))
    output = capsys.readouterr().out
    assert output
    if page.stem == "hand_and_grip":
        assert output.startswith("STABLE")


def tensors() -> dict:
    """Return the names of the page's block on PyTorch."""
    torch = pytest.importorskip("torch")
    points = torch.tensor([[0.05, 0, 0], [-0.05, 0, 0], [0, 0.05, 0]], dtype=torch.float64, requires_grad=True)
    normals = torch.nn.functional.normalize(-points.detach(), dim=-1)
    wrench = torch.tensor([0.0, 0, 1, 0, 0, 0], dtype=torch.float64)
    return {"points": points, "normals": normals, "friction": 0.6, "squeeze": 2.0, "wrench": wrench}


def shadow_hand() -> dict:
    """Return the names of the page's block on other hands."""
    pytest.importorskip("mujoco")
    from tests.interop.test_mujoco_hand import model_of

    return {"jaxgrasp": jaxgrasp, "model": model_of("shadow")[0]}


def two_blocks() -> dict:
    """Return the names of the page's block on many objects: a stack of two on a table, and a hand far away."""
    from jaxgrasp.grip import Body
    from jaxgrasp.hand import Pose, Posture
    from tests.world.worlds import BLOCK, tower

    world, state = tower([0.4, 0.2])
    wrists = Pose(np.full((2, 3), 9.0), np.stack([np.eye(3)] * 2))
    postures = Posture(wrists, np.zeros((2, len(world.scene.hand.joints))))
    return {"Body": Body, "block": BLOCK, "scene": world.scene, "where": state.placed, "postures": postures}


def held_probe() -> dict:
    """Return the names of the page's block on a probe: a hand in a glove, and a file of heights."""
    from jaxgrasp.glove import lrp_hand_master
    from jaxgrasp.hand import human_hand
    from jaxgrasp.teleop import ForceFeedback

    person = human_hand()
    np.savetxt("ridges.csv", 1e-4 * np.sin(np.arange(20)) * np.ones((4, 1)), delimiter=",")
    angles = np.full(len(person.joints), 0.4)
    return {"np": np, "feedback": ForceFeedback(person, lrp_hand_master(), person, np.eye(3)), "angles": angles}


def posed_grasps() -> dict:
    """Return the names of the page's block on files for other programs: poses of a hand, and their contacts."""
    pytest.importorskip("yaml")
    from jaxgrasp import interop
    from jaxgrasp.hand import human_hand
    from jaxgrasp.testing.problems import problems

    hand, problem = human_hand(), problems("ordinary", 4, 40, seed=3)
    poses = interop.GraspPoses(
        Path("some.npz"), tuple(map(str, range(40))), np.tile(np.eye(4), (40, 1, 1)), np.zeros((40, len(hand.joints)))
    )
    grasp = jaxgrasp.Grasp(problem.points, problem.normals, problem.friction, problem.squeeze)
    touched = interop.PosedContacts(grasp, np.zeros(40, bool), 0)
    names = {"jaxgrasp": jaxgrasp, "np": np, "interop": interop, "hand": hand}
    return names | {"poses": poses, "touched": touched, "wrench": problem.wrench}


PREPARED = {
    "margin = np.asarray(jaxgrasp.quality.hold_margin": posed_grasps,
    "from jaxgrasp.interop import torch": tensors,
    "loaded = jaxgrasp.interop.hand_from_mujoco": shadow_hand,
    "from jaxgrasp.world import": two_blocks,
    "from jaxgrasp.teleop import HeldProbe": held_probe,
}
"""What a block of Python needs that does not go on from its page, by how the block begins."""
APART = [code for page in (README, *DOCS) for code in blocks(page, "py")]


def test_every_block_that_stands_apart_is_prepared():
    assert len(APART) == len(PREPARED)
    for begin in PREPARED:
        assert sum(code.startswith(begin) for code in APART) == 1, begin


@pytest.mark.slow
@pytest.mark.parametrize("begin", PREPARED)
def test_the_blocks_that_stand_apart_run(begin, folder):
    """Blocks that need extras or data which the page only names run by themselves."""
    (code,) = [block for block in APART if block.startswith(begin)]
    names = PREPARED[begin]()
    exec(compile(code, begin, "exec"), names)


@PAGES
def test_the_commands_parse(page):
    lines = [shlex.split(line, comments=True) for text in blocks(page, "bash") for line in text.splitlines()]
    for _, *arguments in [line for line in lines if line[:1] == ["jaxgrasp"]]:
        tyro.cli(Command, args=arguments)


CALL = re.compile(r"`(jaxgrasp\.[^`]*\([^`]*\))`")


def inline_calls() -> list:
    """List the package calls in the text of pages and notebooks, by file."""
    texts = {path: path.read_text() for path in (README, *DOCS)}
    for path in sorted((*ROOT.glob("notebooks/*.ipynb"), *ROOT.glob("docs/**/*.ipynb"))):
        texts[path] = "\n".join(cell.source for cell in nbformat.read(path, 4).cells if cell.cell_type == "markdown")
    return [
        pytest.param(call, id=f"{path.stem}: {call}") for path, text in texts.items() for call in CALL.findall(text)
    ]


def check_call(code: str) -> None:
    """Check a call's arguments, some of which may be left out, against the signature of the package's function."""
    call = ast.parse(code, mode="eval").body
    assert isinstance(call, ast.Call)
    function = eval(ast.unparse(call.func), {"jaxgrasp": jaxgrasp})
    inspect.signature(function).bind_partial(
        *call.args, **{keyword.arg: keyword.value for keyword in call.keywords if keyword.arg}
    )


@pytest.mark.parametrize("call", inline_calls())
def test_calls_in_the_text_fit_their_functions(call):
    check_call(call)


def test_a_call_of_an_unknown_argument_or_name_is_seen():
    check_call("jaxgrasp.report.show('a.html', grasp, pose=placed)")
    with pytest.raises(TypeError, match="placed"):
        check_call("jaxgrasp.report.show('a.html', grasp, placed=placed)")
    with pytest.raises(AttributeError):
        check_call("jaxgrasp.report.shown('a.html')")


@PAGES
def test_the_links_lead_somewhere(page):
    """Files that are there, and headings that are there."""
    for link in LINK.findall(page.read_text()):
        if link.startswith(("http:", "https:")):
            continue
        file, _, anchor = link.partition("#")
        target = (page.parent / file).resolve() if file else page
        assert target.exists(), link
        assert not anchor or anchor in anchors(target), link


def test_the_site_has_three_doors_which_list_every_page_once():
    index, topics = ROOT / "docs" / "index.md", ROOT / "docs" / "reference" / "topics.md"
    assert re.findall(r"^:caption: (.*)$", index.read_text(), re.M) == ["Start", "Tutorials", "Reference"]
    listed = [(door.parent / link).resolve() for door in (index, topics) for link in LINK.findall(door.read_text())]
    assert sorted(page for page in listed if page in DOCS) == sorted(set(DOCS) - {index})
    assert topics in listed


def test_readme_is_short():
    assert len(README.read_text().split()) < 900


@pytest.mark.parametrize("file", readme.TABLES)
def test_the_tables_are_those_of_the_committed_results(file):
    assert readme.filled(file) == (ROOT / file).read_text()


def test_the_quick_start_has_two_lines():
    block = re.search(r"<!-- quick start -->\n```bash\n(.*?)```\n<!-- end -->", README.read_text(), re.S)
    assert block and len(block[1].strip().splitlines()) == 2
