"""A benchmark of several sections, each of which can be made again alone: its command line, its JSON and its page."""

import argparse
import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from benchmarks.machine import machine

Plan = TypeVar("Plan", bound=NamedTuple)


def run_sections(
    about: str | None,
    name: str,
    sections: Mapping[str, Callable[[Plan], Any]],
    plans: tuple[Plan, Plan],
    page: Callable[[dict], str],
    named: str = "plan",
) -> None:
    """Make the sections that the command line asks for; those that were made before stay.

    Args:
        about: what ``--help`` says.
        name: of the two files.
        sections: by their names.
        plans: of a measurement, and of ``--quick``.
        page: of a report, in Markdown.
        named: what the report calls the plan.
    """
    parser = argparse.ArgumentParser(description=about, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results"), help="folder of the two files")
    parser.add_argument("--quick", action="store_true", help="a few of everything: a test, not a measurement")
    parser.add_argument("--sections", nargs="+", choices=sections, default=list(sections), help="made again; all")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    plan, path = plans[options.quick], options.out / f"{name}.json"
    report = json.loads(path.read_text()) if path.exists() else {}
    report |= {"machine": machine(), named: plan._asdict()}
    for section in options.sections:
        report[section] = sections[section](plan)
        # What was remarked by hand of the section as it was.
        report.get("remarks", {}).pop(section, None)
    path.write_text(json.dumps(report, indent=1) + "\n")
    (options.out / f"{name}.md").write_text(page(report))
