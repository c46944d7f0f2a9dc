"""Peak memory of `jaxgrasp evaluate` for one file that is larger than that.

    python -m benchmarks.large_files --out benchmarks/results

Files of every kind that is read in pieces, of 100,000 grasps of five contacts and of 10,000,000, evaluated by both
closed forms and both optima in a process of its own, as a user starts it. They hold the same 50,000 grasps again and
again, and are written a block at a time.
"""

import argparse
import json
import tempfile
import zipfile
from collections.abc import Callable
from pathlib import Path

import h5py
import jax
import numpy as np
from pyarrow import parquet

import jaxgrasp
from benchmarks.cluster import CONTACTS, run
from benchmarks.machine import machine
from jaxgrasp.batch.columnar import columns_to_save
from jaxgrasp.batch.contact_sets import ContactSets
from jaxgrasp.testing.problems import problems

NAME = "large_files"
BLOCK = 50_000
"""Grasps that differ."""
ROWS = 4096
"""Of a chunk of an HDF5 file."""


def block() -> ContactSets:
    drawn = problems("ordinary", CONTACTS, BLOCK, seed=0)
    grasp = jaxgrasp.Grasp(drawn.points, drawn.normals, drawn.friction, drawn.squeeze)
    return ContactSets.from_grasp(grasp, drawn.wrench)


def write_npz(path: Path, sets: ContactSets, times: int, packing: int = zipfile.ZIP_STORED) -> None:
    with zipfile.ZipFile(path, "w", packing, compresslevel=1) as archive:
        for name, array in columns_to_save(sets).items():
            repeats = times if array.ndim else 1
            shape = (repeats * len(array), *array.shape[1:]) if array.ndim else ()
            header = {"descr": np.lib.format.dtype_to_descr(array.dtype), "fortran_order": False, "shape": shape}
            with archive.open(f"{name}.npy", "w", force_zip64=True) as stream:
                np.lib.format.write_array_header_1_0(stream, header)
                for _ in range(repeats):
                    stream.write(array.tobytes())


def write_packed_npz(path: Path, sets: ContactSets, times: int) -> None:
    write_npz(path, sets, times, zipfile.ZIP_DEFLATED)


def write_hdf5(path: Path, sets: ContactSets, times: int) -> None:
    with h5py.File(path, "w") as file:
        for name, array in columns_to_save(sets).items():
            if not array.ndim:
                file[name] = array
                continue
            tail = array.shape[1:]
            data = file.create_dataset(name, (times * len(array), *tail), array.dtype, chunks=(ROWS, *tail))
            for k in range(times):
                data[k * len(array) : (k + 1) * len(array)] = array


def write_parquet(path: Path, sets: ContactSets, times: int) -> None:
    block_file = path.with_name("one.parquet")
    jaxgrasp.save_grasps(block_file, sets)
    table = parquet.read_table(block_file)
    with parquet.ParquetWriter(path, table.schema) as writer:
        for _ in range(times):
            writer.write_table(table)


KINDS: dict[str, tuple[str, Callable[[Path, ContactSets, int], None]]] = {
    "npz": ("npz", write_npz),
    "npz, compressed": ("npz", write_packed_npz),
    "HDF5, in chunks": ("h5", write_hdf5),
    "Parquet": ("parquet", write_parquet),
}


def measure(kind: str, grasps: int) -> dict:
    ending, write = KINDS[kind]
    with tempfile.TemporaryDirectory() as scratch:
        path = Path(scratch) / f"grasps.{ending}"
        write(path, block(), grasps // BLOCK)
        result = run([str(path), "--table", "none"], Path(scratch) / "results")
        figures = {name: result[name] for name in ("cpu_seconds", "wall_seconds", "largest_mib")}
        return {"kind": kind, "grasps": grasps, "file_bytes": path.stat().st_size, **figures}


def page(report: dict) -> str:
    lines = [
        "# One large file",
        "",
        "`python -m benchmarks.large_files --out benchmarks/results`. `jaxgrasp evaluate FILE` of grasps of",
        f"{CONTACTS} contacts, by both closed forms and both optima, on {report['machine']['cores']} cores of",
        f"{report['machine']['processor']}, others at work on it: look at CPU seconds, not at wall time. Memory is the",
        "most that the process held at any look, ten times a second.",
        "",
        "| file | grasps | its size, MiB | memory, MiB | CPU s | wall s |",
        "|---|---|---|---|---|---|",
    ]
    for row in report["rows"]:
        lines.append(
            f"| {row['kind']} | {row['grasps']:,} | {row['file_bytes'] / (1 << 20):,.0f} | {row['largest_mib']:,.0f} "
            f"| {row['cpu_seconds']:.0f} | {row['wall_seconds']:.0f} |"
        )
    return "\n".join([*lines, ""])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results"), help="folder of the two files")
    parser.add_argument("--grasps", type=int, nargs="+", default=[100_000, 10_000_000])
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=list(KINDS))
    arguments = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    path = arguments.out / f"{NAME}.json"
    earlier = json.loads(path.read_text())["rows"] if path.exists() else []
    rows = {(row["kind"], row["grasps"]): row for row in earlier}
    for kind in arguments.kinds:
        for grasps in arguments.grasps:
            rows[kind, grasps] = measure(kind, grasps)
            report = {"machine": machine(), "rows": [rows[key] for key in sorted(rows)]}
            path.write_text(json.dumps(report, indent=1) + "\n")
            (arguments.out / f"{NAME}.md").write_text(page(report))


if __name__ == "__main__":
    main()
