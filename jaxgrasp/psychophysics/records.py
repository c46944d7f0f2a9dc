"""Recorded trials of a person, checked by a replay of the plan, so that no other records are taken for them.

Records of one person: lines of JSON that are only ever appended, each on disk before the program goes on.
"""

import contextlib
import json
import os
from collections.abc import Iterable, Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any, BinaryIO

from jaxgrasp.files.file_values import is_number
from jaxgrasp.files.printable import shortened
from jaxgrasp.psychophysics.plan import Plan, plan_of
from jaxgrasp.psychophysics.schedule import Schedule
from jaxgrasp.psychophysics.trial import Trial, level_of

FORMAT = 1
_BINARY = getattr(os, "O_BINARY", 0)
SUFFIX = ".jsonl"


class RecordError(ValueError):
    """Records that cannot be read, or are not those of this experiment."""


def read_records(path: Path) -> tuple[list[dict[str, Any]], bytes]:
    """Read all records of a file, and the bytes of a last record that was cut off while it was written.

    Raises:
        RecordError: for a line that is no record, by its number.
        OSError: for a file that cannot be read.
    """
    *lines, cut_off = path.read_bytes().split(b"\n")
    records = [_parsed(line) for line in lines]
    for k, record in enumerate(records, 1):
        if record is None:
            raise RecordError(f"{path}, line {k}, is not a record: {lines[k - 1][:60]!r}")
    # Nothing that was cut off within a record is one: what lacks its end of line alone is whole.
    last = _parsed(cut_off)
    complete = [record for record in (*records, last) if record is not None]
    return complete, b"" if last is not None else cut_off


def _parsed(line: bytes) -> dict[str, Any] | None:
    try:
        record = json.loads(line)
    except (ValueError, RecursionError):
        return None
    return record if isinstance(record, dict) and isinstance(record.get("record"), str) else None


class Journal:
    """A file of records that is open for one more at a time, and for one program alone; a context manager."""

    def __init__(self, path: Path, first: dict[str, Any]) -> None:
        """Open a file, or create it with its first record.

        A last line that a crash cut off becomes a record of its own, so that nothing is lost.

        Args:
            path: of the file.
            first: the record that a new file begins with.

        Raises:
            RecordError: for a file with a line that is no record.
            OSError: for a file that cannot be written, or that another program has open.
        """
        self.path = path
        # One file from the beginning on, locked before it is looked at: of two programs, one finds it in use.
        self._stream: BinaryIO = os.fdopen(os.open(path, os.O_RDWR | os.O_CREAT | _BINARY, 0o666), "r+b")
        try:
            _lock(self._stream, path)
            self.records, cut_off = read_records(path)
            self._mend(cut_off, first)
            _sync_folder(path.parent)
        except BaseException:
            self._stream.close()
            raise

    def _mend(self, cut_off: bytes, first: dict[str, Any]) -> None:
        """Begin an empty file, and end a last line that a crash cut off."""
        self._stream.seek(-len(cut_off), os.SEEK_END)
        if not cut_off and self._stream.tell() and not self._ends_a_line():
            self._stream.seek(0, os.SEEK_END)
            self._stream.write(b"\n")
        if not self.records:
            self._write(first)
            self.records.append(first)
        if cut_off:
            self._write({"record": "cut-off", "text": cut_off.decode(errors="replace")})
        self._stream.truncate()
        self._stream.flush()
        os.fsync(self._stream.fileno())

    def _ends_a_line(self) -> bool:
        self._stream.seek(-1, os.SEEK_END)
        return self._stream.read(1) == b"\n"

    def append(self, record: dict[str, Any]) -> None:
        """Write a record; it is on disk when this returns.

        Raises:
            ValueError: for numbers that are not finite: JSON has none.
            OSError: if the disk does not take it.
        """
        self._write(record)
        self.records.append(record)

    def close(self) -> None:
        """Close the file, and release its lock."""
        # What a full disk did not take was never said to be on record.
        with contextlib.suppress(OSError):
            self._stream.close()

    def __enter__(self) -> "Journal":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _write(self, record: dict[str, Any]) -> None:
        line = _line(record)
        try:
            self._stream.write(line)
            self._stream.flush()
            os.fsync(self._stream.fileno())
        except OSError as error:
            raise OSError(
                f"{self.path} cannot be written: {error.strerror}; all earlier answers are in it; --resume continues"
            ) from None


def subjects(folder: Path) -> Iterator[Path]:
    """Yield the files of records in a folder, in the order of the persons' codes."""
    yield from sorted(folder.glob(f"*{SUFFIX}"))


def _line(record: dict[str, Any]) -> bytes:
    return json.dumps(record, allow_nan=False, separators=(",", ":")).encode() + b"\n"


def _sync_folder(folder: Path) -> None:
    """Write the name of a new file to disk, on systems that can sync a folder."""
    with contextlib.suppress(OSError, AttributeError):
        number = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
        try:
            os.fsync(number)
        finally:
            os.close(number)


def _lock(stream: BinaryIO, path: Path) -> None:
    """Lock a file until its stream is closed or the program ends.

    Raises:
        OSError: for a file that another program has locked.
    """
    try:
        if os.name == "nt":
            import msvcrt

            # Far beyond its end: there a lock keeps nobody from reading.
            stream.seek(2**40)
            msvcrt.locking(stream.fileno(), msvcrt.LK_NBLCK, 1)  # type: ignore[attr-defined]
        else:
            import fcntl

            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        raise OSError(f"{path} is in use by another program") from None


TrialRecord = dict[str, Any]


def experiment_of(records: list[dict[str, Any]], path: Path) -> tuple[Plan, dict[str, float] | None, list[TrialRecord]]:
    """Return the plan in a person's records, the parameters of a simulated observer or None, and the checked trials.

    Raises:
        RecordError: for records that the plan does not lead to; the message names the trial and the field.
    """
    if not records:
        raise RecordError(f"{path} has no first record of an experiment")
    plan = _plan(records[0], path)
    return plan, _observer(records[0], path), replay(Schedule(plan, path.stem), path.stem, records, path)


def replay(schedule: Schedule, subject: str, records: list[dict[str, Any]], path: Path) -> list[TrialRecord]:
    """Advance a schedule to the end of the records, and return their trials, which must be those of the schedule."""
    if not records:
        return []
    if records[0].get("subject") != subject:
        raise RecordError(f"{path} is of subject {records[0].get('subject')!r}: expected {subject!r}")
    trials = [record for record in records if record["record"] == "trial"]
    for record in trials:
        trial = schedule.next()
        if trial is None:
            raise RecordError(f"{path} has more trials than the plan")
        for name, value in asdict(trial).items():
            # Records of before have no condition.
            if record.get(name, "" if name == "condition" else None) != value:
                raise RecordError(
                    f"{path}, trial {trial.number}: {name} is {record.get(name)!r}, and the plan leads to {value!r}"
                )
        schedule.score(_score(trial, record, path))
    return trials


def check_plan(records: list[dict[str, Any]], plan: Plan, observer: dict[str, float] | None, path: Path) -> None:
    """Raise RecordError unless a file was begun with this plan, and by a person or this observer alike."""
    if not records:
        return
    _check_same(_plan(records[0], path), plan, path)
    recorded_observer = _observer(records[0], path)
    if recorded_observer != observer:
        names = [
            "a person" if origin is None else f"a simulated observer, {origin}"
            for origin in (recorded_observer, observer)
        ]
        raise RecordError(f"{path} was begun by {names[0]}, and now it is {names[1]}")


def check_other(path: Path, plan: Plan) -> None:
    """Raise RecordError where another person's file was begun with another plan: an experiment has one."""
    records = read_records(path)[0]
    if records:
        _check_same(_plan(records[0], path), plan, path)


def _check_same(recorded_plan: Plan, current_plan: Plan, path: Path) -> None:
    recorded_table = recorded_plan.table()
    for key, value in current_plan.table().items():
        if recorded_table[key] != value:
            raise RecordError(
                f"{path} was begun with another plan: {key} was {recorded_table[key]!r}, and now is {value!r}"
            )


def _plan(first: dict[str, Any], path: Path) -> Plan:
    if first["record"] != "begun":
        raise RecordError(f"{path} has no first record of an experiment")
    if first.get("format") != FORMAT:
        raise RecordError(f"{path} has format {first.get('format')!r}: expected {FORMAT}")
    if not (isinstance(first.get("plan"), dict) and isinstance(first.get("observer", 0), dict | None)):
        raise RecordError(f"{path} has no plan in its first record")
    try:
        return plan_of(first["plan"], "plan")
    except ValueError as error:
        raise RecordError(f"{path}: {error}") from None


def _observer(first: dict[str, Any], path: Path) -> dict[str, float] | None:
    """Return the parameters of the simulated observer, or None, from a first record that ``_plan`` accepted."""
    parameters = first["observer"]
    for name, value in (parameters or {}).items():
        if not is_number(value):
            raise RecordError(f"{path}: observer.{name} is {shortened(value)}: expected a number")
    return None if parameters is None else {name: float(value) for name, value in parameters.items()}


def _score(trial: Trial, record: TrialRecord, path: Path) -> float:
    """Return the score of a recorded answer, after a check of its fields."""
    label = f"{path}, trial {trial.number}"
    if not isinstance(record.get("saturated"), bool):
        raise RecordError(f"{label}: saturated is {record.get('saturated')!r}: expected true or false")
    # Earlier records have neither of the last two.
    for name in ("felt", "torque", "durations", *(name for name in ("whole", "moved") if name in record)):
        if not _is_pair(record.get(name)):
            raise RecordError(f"{label}: {name} is {record.get(name)!r}: expected two numbers")
    if trial.task == "setting":
        setting = record.get("setting")
        if setting is None or not is_number(setting) or setting < 0:
            raise RecordError(f"{label}: setting is {setting!r}: expected a number, 0 or more")
        return level_of(trial.reference, setting)
    answer, right = record.get("answer"), record.get("right")
    if answer not in (1, 2) or isinstance(answer, bool):
        raise RecordError(f"{label}: answer is {answer!r}: expected 1 or 2")
    if right is not (answer == trial.stronger):
        raise RecordError(
            f"{label}: right is {right!r}, and the answer was {answer} of which {trial.stronger} is right"
        )
    return float(right)


def _is_pair(value: Any) -> bool:
    """Tell whether a value is a list of two numbers, of which either may be None."""
    return isinstance(value, list) and len(value) == 2 and all(number is None or is_number(number) for number in value)


def felt_levels(trials: Iterable[TrialRecord]) -> list[float]:
    """Compute the relative differences of the felt intensities of each trial, where both are known."""
    differences = []
    for trial in trials:
        first, second = trial["felt"]
        if first is not None and second is not None and min(first, second) > 0:
            differences.append(max(first, second) / min(first, second) - 1)
    return differences
