"""LeRobot's data sets (v3.0): contacts, forces at each contact, the load and the hold margin as features of frames.

A folder has ``meta/info.json`` with the features, frame rate and path templates, ``meta/stats.json``,
``meta/tasks.parquet``, episodes in ``meta/episodes/chunk-000/file-000.parquet`` and frames in
``data/chunk-000/file-000.parquet``. Features of one number are plain columns, others lists of fixed length. Here they
are named ``observation.contact_...``: n contacts of each frame, contact by contact, in float32.

Source: LeRobot's documentation of LeRobotDataset v3.0, and version 0.4.4 of the library, which loads the tests' files.
"""

import json
import os
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jaxgrasp.files.printable import shortened
from jaxgrasp.files.replace import partial_path
from jaxgrasp.interop.file_records import field, numbers, positive, read_text
from jaxgrasp.model.faults import check_grasp
from jaxgrasp.model.grasp import Grasp
from jaxgrasp.validation.checked import checked
from jaxgrasp.validation.optional_library import optional_library

MISSING = "LeRobot's data sets need pyarrow: pip install 'jaxgrasp[table]'"
VERSION = "v3.0"
DATA = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
EPISODES = "meta/episodes/chunk-000/file-000.parquet"
TASKS = "meta/tasks.parquet"
PREFIX = "observation."
AXES = ("x", "y", "z")
FORCES = "contact_forces"
VECTORS = ("contact_points", "contact_normals", FORCES)
NUMBERS = ("contact_friction", "contact_squeeze", "contact_present")
OF_SOFT_FINGERS = ("contact_torsion", "contact_moments")
INDICES = ("timestamp", "frame_index", "episode_index", "index", "task_index")


class ContactFrames(NamedTuple):
    """T frames of n contacts each, of one or more episodes."""

    grasp: Grasp
    """Contacts ``(T, n)``."""
    wrench: np.ndarray
    """``(T, 6)``: what the contacts must exert [N, N.m]."""
    forces: np.ndarray
    """``(T, n, 3)``: on the object [N]."""
    margin: np.ndarray
    """``(T,)``: of [`jaxgrasp.quality.hold_margin`][]."""
    episodes: np.ndarray
    """``(T,)``: number of each frame's episode, from 0, in ascending order."""
    moments: np.ndarray | None = None
    """``(T, n)``: about the normals of soft fingers [N.m]; None without ``torsion``."""
    fps: float = 30.0
    """Frames a second."""


@checked
def write_lerobot(folder: str | Path, frames: ContactFrames, *, task: str = "grasp") -> None:
    """Write contacts over time as a data set of LeRobot, whole or not at all.

    Args:
        folder: the data set's; it must not exist yet, or be empty.
        frames: at least one; contacts that are not ``present`` are written as zeros with a normal of (0, 0, 1).
        task: what is done in every episode, in words.

    Raises:
        ImportError: without pyarrow.
        ValueError: for the first entry that cannot be written, before anything is written.
        OSError: for a folder that has files, or that cannot be written.
    """
    arrow = optional_library("pyarrow", "pyarrow.parquet", missing=MISSING)
    folder = Path(folder)
    columns, names = _columns(frames)
    fps = positive("frames.fps", frames.fps)
    episodes = _episodes(frames.episodes, len(frames.wrench))
    starts = np.flatnonzero(np.diff(episodes, prepend=-1))
    ends = np.append(starts[1:], len(episodes))
    steps = np.arange(len(episodes)) - np.repeat(starts, ends - starts)
    indices: dict[str, np.ndarray] = {
        "timestamp": (steps / fps).astype(np.float32),
        "frame_index": steps,
        "episode_index": episodes,
        "index": np.arange(len(episodes)),
        "task_index": np.zeros(len(episodes), np.int64),
    }
    columns |= {name: values.reshape(-1, 1) for name, values in indices.items()}
    features = {
        name: {"dtype": str(values.dtype), "shape": [values.shape[1]], "names": names.get(name)}
        for name, values in columns.items()
    }
    count = len(starts)
    info = {
        "codebase_version": VERSION,
        "robot_type": None,
        "total_episodes": count,
        "total_frames": len(episodes),
        "total_tasks": 1,
        "chunks_size": 1000,
        "data_files_size_in_mb": 100,
        "video_files_size_in_mb": 200,
        "fps": int(fps) if fps == int(fps) else fps,
        "splits": {"train": f"0:{count}"},
        "data_path": DATA,
        "video_path": None,
        "features": features,
    }
    stats = {name: _statistics(values) for name, values in columns.items()}
    zeros = np.zeros(count, np.int64)
    of_episodes = {
        "episode_index": np.arange(count),
        "tasks": [[task]] * count,
        "length": ends - starts,
        "dataset_from_index": starts,
        "dataset_to_index": ends,
        **dict.fromkeys(("data/chunk_index", "data/file_index"), zeros),
        **dict.fromkeys(("meta/episodes/chunk_index", "meta/episodes/file_index"), zeros),
    }
    files = {
        DATA.format(chunk_index=0, file_index=0): arrow.table({n: _arrow_column(arrow, v) for n, v in columns.items()}),
        EPISODES: arrow.table(of_episodes),
        TASKS: _task_table(arrow, task),
        "meta/info.json": info,
        "meta/stats.json": stats,
    }
    _write_folder(arrow, folder, files)


@checked
def read_lerobot(folder: str | Path) -> ContactFrames:
    """Read the contacts of a data set that ``write_lerobot`` wrote, or another with the same features.

    Args:
        folder: the data set's, with ``meta`` and ``data``.

    Returns:
        Frames in their order, in float64, with normals of unit length.

    Raises:
        ImportError: without pyarrow.
        ValueError: for a folder that is no such data set, naming what is wrong.
        OSError: for a file that cannot be read.
    """
    arrow = optional_library("pyarrow", "pyarrow.parquet", missing=MISSING)
    folder = Path(folder)
    path = folder / "meta" / "info.json"
    try:
        info = json.loads(read_text(path))
        version = field(info, "codebase_version")
        if version != VERSION:
            raise ValueError(f"codebase_version is {shortened(version)}: expected {VERSION!r}")
        fps, features = positive("fps", field(info, "fps")), field(info, "features")
        forces = field(features, PREFIX + FORCES)
        n, remainder = divmod(int(numbers("shape", field(forces, "shape"), (1,))[0]), 3)
        if remainder or n < 1:
            raise ValueError(
                f"{PREFIX}{FORCES} has the shape {forces['shape']}: expected three numbers for each contact"
            )
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{path} is not of a data set with contact forces: {error}") from None
    soft = [name for name in OF_SOFT_FINGERS if PREFIX + name in features]
    widths = (
        dict.fromkeys(VECTORS, 3 * n) | dict.fromkeys((*NUMBERS, *soft), n) | {"object_wrench": 6, "hold_margin": 1}
    )
    paths = sorted((folder / "data").glob("*/*.parquet"))
    if not paths:
        raise ValueError(f"{folder / 'data'} holds no .parquet files")
    tables = [_read_table(arrow, path) for path in paths]
    columns = {name: _read_column(tables, PREFIX + name, width) for name, width in widths.items()}
    order = np.argsort(_read_column(tables, "index", 1)[:, 0], kind="stable")
    columns = {name: values[order] for name, values in columns.items()}
    points, normals, forces = (columns[name].reshape(-1, n, 3) for name in VECTORS)
    lengths = np.linalg.norm(normals, axis=-1, keepdims=True)
    friction, squeeze, present = (columns[name] for name in NUMBERS)
    grasp = Grasp(
        points,
        normals / np.where(lengths > 0, lengths, 1),
        friction,
        squeeze,
        present=None if np.all(present == 1) else present,
        torsion=columns.get("contact_torsion"),
    )
    check_grasp(grasp)
    return ContactFrames(
        grasp,
        columns["object_wrench"],
        forces,
        columns["hold_margin"][:, 0],
        _read_column(tables, "episode_index", 1)[order, 0].astype(int),
        columns.get("contact_moments"),
        fps,
    )


def _columns(frames: ContactFrames) -> tuple[dict[str, np.ndarray], dict[str, list[str]]]:
    """Check the frames, and return the features ``(T, width)`` in float32 with the names of their entries."""
    grasp = frames.grasp
    if np.ndim(grasp.points) != 3 or not len(grasp.points):
        raise ValueError(f"frames.grasp.points has shape {np.shape(grasp.points)}: expected (T, n, 3), T at least 1")
    check_grasp(grasp)
    count, n, _ = np.shape(grasp.points)
    if n < 1:
        raise ValueError("frames.grasp has no contacts: expected places for at least one")
    present = np.ones((count, n)) if grasp.present is None else np.asarray(grasp.present, float)
    is_absent = present < 0.5
    values: dict[str, Any] = {
        "contact_points": grasp.points,
        "contact_normals": grasp.normals,
        FORCES: numbers("frames.forces", frames.forces, (count, n, 3)),
        "contact_friction": grasp.friction,
        "contact_squeeze": grasp.squeeze,
    }
    if (grasp.torsion is None) != (frames.moments is None):
        fields = "torsion but no moments" if frames.moments is None else "moments but no torsion"
        raise ValueError(f"frames have {fields}: expected both, or neither")
    if grasp.torsion is not None:
        values["contact_torsion"] = grasp.torsion
        values["contact_moments"] = numbers("frames.moments", frames.moments, (count, n))
    columns: dict[str, np.ndarray] = {}
    for name, array in values.items():
        array = np.array(np.broadcast_to(np.asarray(array, float), (count, n, 3) if name in VECTORS else (count, n)))
        array[is_absent] = (0, 0, 1) if name == "contact_normals" else 0
        columns[name] = array.reshape(count, -1)
    columns["contact_present"] = 1.0 - is_absent
    columns["object_wrench"] = numbers("frames.wrench", frames.wrench, (count, 6))
    columns["hold_margin"] = numbers("frames.margin", frames.margin, (count,))[:, None]
    names = {name: [f"contact_{i}.{axis}" for i in range(n) for axis in AXES] for name in VECTORS}
    names |= {name: [f"contact_{i}" for i in range(n)] for name in (*NUMBERS, *OF_SOFT_FINGERS)}
    names |= {"object_wrench": [f"{kind}.{axis}" for kind in ("force", "torque") for axis in AXES]}
    names |= {"hold_margin": ["margin"]}
    features = {}
    for name, array in columns.items():
        with np.errstate(over="ignore"):
            features[PREFIX + name] = array.astype(np.float32)
        bad = np.argwhere(~np.isfinite(features[PREFIX + name]))
        if len(bad):
            frame, entry = bad[0]
            raise ValueError(f"{name}[{frame}] has {array[frame, entry]:g}: expected numbers that float32 can hold")
    return features, {PREFIX + name: entries for name, entries in names.items()}


def _episodes(episodes: Any, count: int) -> np.ndarray:
    array = numbers("frames.episodes", episodes, (count,))
    steps = np.diff(array, prepend=-1)
    bad = np.flatnonzero((steps != 0) & (steps != 1) | (np.arange(count) == 0) & (steps != 1))
    if len(bad):
        raise ValueError(
            f"frames.episodes[{bad[0]}] is {array[bad[0]]:g}: expected numbers from 0 that stay or grow by one"
        )
    return array.astype(np.int64)


def _statistics(values: np.ndarray) -> dict[str, list]:
    exact = values.astype(float)
    return {
        "min": exact.min(0).tolist(),
        "max": exact.max(0).tolist(),
        "mean": exact.mean(0).tolist(),
        "std": exact.std(0).tolist(),
        "count": [len(values)],
    }


def _arrow_column(arrow: Any, values: np.ndarray) -> Any:
    """Return a column of plain numbers for width 1, as LeRobot has it, else one of lists of fixed length."""
    flat = arrow.array(np.ascontiguousarray(values).reshape(-1))
    return flat if values.shape[1] == 1 else arrow.FixedSizeListArray.from_arrays(flat, values.shape[1])


def _task_table(arrow: Any, task: str) -> Any:
    """Return the table of tasks, whose texts are the index of a pandas frame, as LeRobot reads it."""
    index = "__index_level_0__"
    kinds = {"task_index": ("int64", "int64"), index: ("unicode", "object")}
    metadata = {
        "index_columns": [index],
        "column_indexes": [],
        "columns": [
            {
                "name": None if name == index else name,
                "field_name": name,
                "pandas_type": kind,
                "numpy_type": numpy_type,
                "metadata": None,
            }
            for name, (kind, numpy_type) in kinds.items()
        ],
        "pandas_version": "2.2.0",
    }
    table = arrow.table({"task_index": np.zeros(1, np.int64), index: [task]})
    return table.replace_schema_metadata({"pandas": json.dumps(metadata)})


def _write_folder(arrow: Any, folder: Path, files: Mapping[str, Any]) -> None:
    """Write all files beside ``folder``, then rename: a folder that is there must be empty."""
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise FileExistsError(f"{folder} exists already: expected a new or empty folder")
    beside = partial_path(folder)
    try:
        for name, content in files.items():
            path = beside / name
            path.parent.mkdir(parents=True, exist_ok=True)
            if isinstance(content, dict):
                path.write_text(json.dumps(content, indent=4, allow_nan=False))
            else:
                arrow.parquet.write_table(content, path)
        if folder.exists():
            folder.rmdir()
        os.replace(beside, folder)
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(folder)) from error
    finally:
        shutil.rmtree(beside, ignore_errors=True)


def _read_table(arrow: Any, path: Path) -> Any:
    try:
        return path, arrow.parquet.read_table(path)
    except (arrow.ArrowException, OSError) as error:
        if isinstance(error, OSError) and error.errno is not None:
            raise
        raise ValueError(f"{path} cannot be read as Parquet: {' '.join(str(error).split())[:200]}") from None


def _read_column(tables: list, name: str, width: int) -> np.ndarray:
    """Return a column of all files ``(T, width)`` in float64."""
    parts = []
    for path, table in tables:
        if name not in table.column_names:
            raise ValueError(f"{path} has no column {name!r}")
        try:
            parts.append(numbers(name, table[name].to_pylist(), (None,) if width == 1 else (None, width)))
        except ValueError as error:
            raise ValueError(f"{path}: {error}") from None
    return np.concatenate(parts).reshape(-1, width)
