"""Data sets of LeRobot: what is written is read back, by this package and by LeRobot's own library."""

import json
from pathlib import Path

import numpy as np
import pytest

import jaxgrasp
from jaxgrasp import Grasp
from jaxgrasp.batch.sources import save_grasps
from jaxgrasp.cli.main import main
from jaxgrasp.interop import ContactFrames, read_lerobot, write_lerobot
from jaxgrasp.quality import hold_margin
from jaxgrasp.testing.problems import problems

arrow = pytest.importorskip("pyarrow", reason="pip install 'jaxgrasp[table]'")
COUNT, N = 40, 4
EPISODES = np.repeat([0, 1, 2], [7, 1, COUNT - 8])
FORMAT_ROUNDING = float(np.finfo(np.float32).eps)


def frames(n: int = N, soft: bool = True, **changed: object) -> ContactFrames:
    rng = np.random.default_rng(0)
    problem = problems("ordinary", N, COUNT, seed=3)
    present = np.ones((COUNT, n))
    present[5, 0] = 0
    fields = {name: getattr(problem, name)[:, :n] for name in ("points", "normals", "friction", "squeeze")}
    torsion = np.full((COUNT, n), 0.01) if soft else None
    written = ContactFrames(
        Grasp(**fields, present=present, torsion=torsion),
        problem.wrench,
        rng.normal(size=(COUNT, n, 3)),
        rng.uniform(-1, 2, COUNT),
        EPISODES,
        rng.normal(size=(COUNT, n)) if soft else None,
        50.0,
    )
    return written._replace(**changed)


@pytest.mark.parametrize("n", [1, N])
@pytest.mark.parametrize("soft", [False, True])
def test_frames_are_read_back(folder, n, soft):
    written = frames(n, soft)
    write_lerobot("data", written)
    read = read_lerobot("data")
    is_present = np.asarray(written.grasp.present) > 0.5
    pairs = [(getattr(read.grasp, k), getattr(written.grasp, k)) for k in ("points", "normals", "friction", "squeeze")]
    pairs += [(read.forces, written.forces)]
    pairs += [(read.grasp.torsion, written.grasp.torsion), (read.moments, written.moments)] if soft else []
    for value, expected in pairs:
        np.testing.assert_allclose(value[is_present], np.asarray(expected)[is_present], rtol=FORMAT_ROUNDING)
        assert not np.any(np.linalg.norm(value[~is_present]) > 1)
    np.testing.assert_allclose(read.wrench, written.wrench, rtol=FORMAT_ROUNDING)
    np.testing.assert_allclose(read.margin, written.margin, rtol=FORMAT_ROUNDING)
    np.testing.assert_array_equal(read.episodes, EPISODES)
    np.testing.assert_array_equal(np.asarray(read.grasp.present) > 0.5, is_present)
    assert read.fps == 50 and (read.moments is None) == (not soft)
    assert [path.name for path in folder.iterdir()] == ["data"]


def test_files_have_the_layout_of_version_3(folder):
    write_lerobot("data", frames(), task="lift the cup")
    info = json.loads(Path("data/meta/info.json").read_text())
    assert (info["codebase_version"], info["total_episodes"], info["total_frames"], info["fps"]) == (
        "v3.0",
        3,
        COUNT,
        50,
    )
    forces = info["features"]["observation.contact_forces"]
    assert (forces["dtype"], forces["shape"], forces["names"][3]) == ("float32", [3 * N], "contact_1.x")
    table = arrow.parquet.read_table(Path("data") / info["data_path"].format(chunk_index=0, file_index=0))
    assert set(table.column_names) == set(info["features"]) and table.num_rows == COUNT
    np.testing.assert_allclose(table["timestamp"].to_numpy(), np.concatenate([np.arange(k) for k in (7, 1, 32)]) / 50)
    episodes = arrow.parquet.read_table("data/meta/episodes/chunk-000/file-000.parquet").to_pydict()
    assert episodes["dataset_from_index"] == [0, 7, 8] and episodes["dataset_to_index"] == [7, 8, COUNT]
    assert episodes["length"] == [7, 1, COUNT - 8] and episodes["tasks"] == [["lift the cup"]] * 3
    stats = json.loads(Path("data/meta/stats.json").read_text())
    assert stats.keys() == info["features"].keys()
    np.testing.assert_allclose(stats["observation.hold_margin"]["mean"], [frames().margin.mean()], rtol=1e-6)
    pandas = pytest.importorskip("pandas")
    tasks = pandas.read_parquet("data/meta/tasks.parquet")
    assert tasks.iloc[0].name == "lift the cup" and tasks["task_index"].tolist() == [0]


@pytest.mark.slow
@pytest.mark.parametrize("n", [1, N])
def test_lerobots_own_library_loads_it(folder, monkeypatch, n):
    """Frames, episodes, windows over time, tasks and statistics."""
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    module = pytest.importorskip("lerobot.datasets.lerobot_dataset", reason="pip install lerobot")
    written = frames(n)
    write_lerobot("data", written, task="lift the cup")
    data = module.LeRobotDataset("local/data", root=folder / "data")
    assert len(data) == COUNT and data.num_episodes == 3 and data.fps == 50
    for i in (0, 7, COUNT - 1):
        item = data[i]
        np.testing.assert_allclose(item["observation.contact_forces"], written.forces[i].ravel(), rtol=1e-6)
        assert item["task"] == "lift the cup" and int(item["episode_index"]) == EPISODES[i]
    window = {"observation.contact_forces": [-0.02, 0.0]}
    one = module.LeRobotDataset("local/data", root=folder / "data", episodes=[2], delta_timestamps=window)
    assert one[1]["observation.contact_forces"].shape == (2, 3 * n)
    assert data.meta.stats["observation.contact_forces"]["std"].shape == (3 * n,)


BAD = {
    r"frames.forces\[2, 0, 1\] is nan": {
        "forces": np.where(np.arange(COUNT * N * 3).reshape(COUNT, N, 3) == 25, np.nan, 0)
    },
    r"frames.forces has the shape \(40, 3\)": {"forces": np.zeros((COUNT, 3))},
    r"contact_forces\[0\] has 1e\+60: expected numbers that float32 can hold": {"forces": np.full((COUNT, N, 3), 1e60)},
    r"frames.wrench has the shape \(40, 5\)": {"wrench": np.zeros((COUNT, 5))},
    r"frames.margin\[0\] is nan": {"margin": np.full(COUNT, np.nan)},
    r"frames.episodes\[0\] is 1: expected numbers from 0": {"episodes": np.ones(COUNT)},
    r"frames.episodes\[7\] is 2: expected numbers from 0 that stay or grow by one": {"episodes": 2 * EPISODES},
    r"frames.episodes\[1\] is 0.5": {"episodes": np.arange(COUNT) / 2},
    "frames have torsion but no moments": {"moments": None},
    r"frames.fps is 0: expected a positive number": {"fps": 0.0},
    r"points\[0, 0\] is \[nan nan nan\]": {"grasp": None},
}


@pytest.mark.parametrize("message", BAD)
def test_bad_frames_are_named_and_nothing_is_written(folder, message):
    changed = BAD[message]
    if "grasp" in changed:
        grasp = frames().grasp
        changed = {"grasp": Grasp(np.full((COUNT, N, 3), np.nan), grasp.normals, grasp.friction, grasp.squeeze)}
    with pytest.raises(ValueError, match=message):
        write_lerobot("data", frames(**changed))
    assert not list(folder.iterdir())


def test_a_folder_that_is_used_stays(folder):
    (folder / "data").mkdir()
    (folder / "data" / "mine").write_text("mine")
    with pytest.raises(FileExistsError, match="data exists already: expected a new or empty folder"):
        write_lerobot("data", frames())
    with pytest.raises(OSError, match="missing"):
        write_lerobot("data/mine/missing", frames())
    assert [path.name for path in folder.iterdir()] == ["data"] and (folder / "data" / "mine").read_text() == "mine"


def test_what_is_no_such_data_set_is_refused_in_one_line(folder):
    write_lerobot("data", frames())
    info = json.loads(Path("data/meta/info.json").read_text())
    path = Path("data/meta/info.json")
    cases = {
        "{": "is not of a data set with contact forces: ",
        json.dumps(info | {"codebase_version": "v2.1"}): "codebase_version is 'v2.1': expected 'v3.0'",
        json.dumps(info | {"features": {}}): "it has no 'observation.contact_forces'",
        json.dumps(info | {"fps": -1}): "fps is -1: expected a positive number",
        json.dumps(
            info | {"features": {"observation.contact_forces": {"shape": [4]}}}
        ): "expected three numbers for each contact",
        json.dumps(info | {"features": {"observation.contact_forces": {"shape": [3]}}}): r"has the shape \(40, 12\)",
    }
    for text, message in cases.items():
        path.write_text(text)
        with pytest.raises(ValueError, match=message) as caught:
            read_lerobot("data")
        assert "\n" not in str(caught.value) and str(caught.value).startswith("data/")
    path.write_text(json.dumps(info))
    file = Path("data/data/chunk-000/file-000.parquet")
    file.write_bytes(file.read_bytes()[:-100])
    with pytest.raises(ValueError, match=r"file-000.parquet cannot be read as Parquet"):
        read_lerobot("data")
    file.unlink()
    with pytest.raises(ValueError, match=r"holds no .parquet files"):
        read_lerobot("data")
    with pytest.raises(OSError, match="nowhere"):
        read_lerobot("nowhere")


@pytest.mark.slow
def test_the_command_writes_forces_that_hold_and_the_margin(folder, capsys):
    """Of ordinary grasps: forces are the optimum's, and inside their cones. Wrenches of a grasp are an episode."""
    problem = problems("ordinary", N, COUNT, seed=3)
    friction = problem.friction * np.where(np.arange(COUNT) % 2, 1, 0.02)[:, None]
    grasp = Grasp(problem.points, problem.normals, friction, problem.squeeze)
    save_grasps("contacts.npz", grasp, problem.wrench, name=list(map(str, range(COUNT))))
    assert main(["export", "lerobot", "contacts.npz", "--out", "data", "--fps", "20", "--task", "hold"]) == 0
    said = capsys.readouterr().out
    read, margin = read_lerobot("data"), np.asarray(hold_margin(grasp, problem.wrench))
    held = margin > 0
    assert "not in the data set: actions, images and the state of a robot, name" in said
    assert f"{np.sum(~held)} frames do not hold: their forces exert what is nearest to the wrench" in said
    np.testing.assert_array_equal(read.margin > 0, held)
    np.testing.assert_array_equal(read.episodes, np.zeros(COUNT))
    optimum = jaxgrasp.constrained_optimum(grasp, problem.wrench)
    scale = np.abs(problem.wrench).max()
    np.testing.assert_allclose(read.forces[held], np.asarray(optimum.forces)[held], atol=1e-5 * scale)
    pressing = np.sum(read.forces * problem.normals, -1)
    sliding = np.linalg.norm(read.forces - pressing[..., None] * problem.normals, axis=-1)
    assert np.all(sliding <= friction * pressing + 1e-5 * scale)
    several = np.stack([problem.wrench, 0.5 * problem.wrench], 1)
    save_grasps("several.npz", grasp, several)
    assert main(["export", "lerobot", "several.npz", "--out", "more"]) == 0
    read = read_lerobot("more")
    np.testing.assert_array_equal(read.episodes, np.repeat(np.arange(COUNT), 2))
    np.testing.assert_allclose(read.wrench, several.reshape(-1, 6), rtol=FORMAT_ROUNDING)
    for words, message in {
        ("nowhere.npz",): "nowhere.npz: no such file",
        ("contacts.npz", "--fps", "nan"): "fps is nan",
        ("contacts.npz", "--out", "more"): "more exists already",
    }.items():
        assert main(["export", "lerobot", *words]) == 1
        assert message in capsys.readouterr().err
