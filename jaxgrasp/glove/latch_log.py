"""Log of latches: a line of JSON for each latch, with the cause, the time and the last frames.

Each line is an object:

========  ==================================================================================================
key       what it holds
========  ==================================================================================================
time      UTC, as ISO 8601 has it
at        time on the host's clock [s], which the frames' times are on
cause     why torque ended, in words
link      a LinkState, by its name; ``trouble`` why there is none
counts    what host and device had counted by then: frames, faults of the line, the device's last STATUS
turns     turns of the loop by then, its ``overruns``, and the ``worst`` lateness [ms]
frames    the last frames, oldest first: ``at``, ``way`` (``in`` from the device, ``out`` to it), and their fields
========  ==================================================================================================
"""

import json
import os
from datetime import UTC, datetime
from typing import Any

from jaxgrasp.validation.checked import checked


def append_latch(path: str | os.PathLike, record: dict[str, Any]) -> None:
    """Append a record as one line of JSON, in a single write; a line that was cut before is ended first.

    Raises:
        OSError: where it cannot be written.
    """
    line = json.dumps({"time": datetime.now(UTC).isoformat(timespec="milliseconds"), **record})
    with open(path, "a+b", buffering=0) as file:
        is_cut = file.seek(0, os.SEEK_END) > 0
        if is_cut:
            file.seek(-1, os.SEEK_END)
            is_cut = file.read(1) != b"\n"
        file.write(b"\n" * is_cut + line.encode() + b"\n")


def check_latch_log(path: str | os.PathLike) -> None:
    """Check that the log can be opened for writing.

    Raises:
        OSError: where it cannot.
    """
    open(path, "ab").close()


@checked
def read_latches(path: str | os.PathLike) -> list[dict[str, Any]]:
    """Read the records of a log, oldest first; an incomplete line of a host that died is skipped.

    Raises:
        ValueError: for a whole line that is no record.
        OSError: for a file that cannot be read.
    """
    with open(path, encoding="utf-8") as file:
        lines = file.read().split("\n")
    records = []
    for number, line in enumerate(lines, 1):
        try:
            record = json.loads(line) if line else None
        except ValueError:
            # Cut at the end, or where another host went on after it.
            continue
        if record is None:
            continue
        if not (isinstance(record, dict) and isinstance(record.get("cause"), str) and "time" in record):
            raise ValueError(f"{path} line {number} is {line[:40]!r}: expected the record of a latch")
        records.append(record)
    return records
