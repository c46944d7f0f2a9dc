"""Steps that every ``jaxgrasp import`` shares: check the arguments, read each file, leave bad ones out."""

import os
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import numpy as np

from jaxgrasp.cli.import_arguments import ImportGrasps
from jaxgrasp.cli.terminal import show
from jaxgrasp.files.printable import message_line
from jaxgrasp.files.replace import check_writable
from jaxgrasp.interop.contact_records import ContactRecords
from jaxgrasp.interop.grasp_poses import GraspPoses
from jaxgrasp.validation.fields import check_not_negative

FRICTION, MASS = 0.5, 0.1
"""Defaults where neither the user nor the file gives them; the mass in [kg]."""


Read = TypeVar("Read", GraspPoses, ContactRecords)


def check_import(arguments: ImportGrasps, *needed: Path) -> None:
    """Raise ValueError for arguments that every format refuses, and for files that are not there; OSError for an
    output that could not be written."""
    check_not_negative(arguments, "friction", "mass")
    if not np.all(np.isfinite(arguments.gravity)):
        raise ValueError(f"gravity is {arguments.gravity}: expected finite numbers [m/s^2]")
    if not arguments.files:
        raise ValueError("no input files: pass at least one")
    if arguments.out.suffix not in (".npz", ".csv"):
        raise ValueError(f"out is {arguments.out}: expected a file that ends in .npz or .csv")
    for path in (*arguments.files, *needed):
        if not path.is_file():
            try:
                os.stat(path)
            except FileNotFoundError:
                raise ValueError(f"{path}: no such file") from None
            raise ValueError(f"{path} is not a file")
    check_writable(arguments.out.parent)


def read_files(arguments: ImportGrasps, read: Callable[[Path], Read]) -> list[Read]:
    """Read all files; with ``keep_going``, list bad files and records on screen and leave them out."""
    results: list[Read] = []
    problems: list[str] = []
    for path in arguments.files:
        try:
            results.append(read(path))
            problems += results[-1].left_out
        except (ValueError, OSError) as error:
            if not arguments.keep_going:
                raise
            problems.append(str(error))
    if not results:
        raise ValueError(f"{problems[0]}; none of the {len(arguments.files)} files can be read")
    for line in problems:
        show(message_line(f"left out: {line}"))
    if problems:
        show(f"left out: {len(problems)} bad records or files in all")
    return results
