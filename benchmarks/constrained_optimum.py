"""The constrained optimum beside its rivals: times, errors, verdicts and derivatives, failures included.

    python -m benchmarks.constrained_optimum --out benchmarks/results

Writes constrained_optimum.json, constrained_optimum.md and time_error.png. ``--only`` makes some of the sections and
leaves the others as the JSON has them.
"""

from benchmarks.one_thread import one_thread

one_thread()

import argparse
import json
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path

import jax

from benchmarks.machine import machine
from benchmarks.page import decisions, extras, gradients, plot, stress, tables, times
from benchmarks.rivals import registry
from benchmarks.rivals.interface import Differentiator, Rival
from jaxgrasp.testing import references as R

SECTIONS = ("singles", "batches", "extras", "stress", "decisions", "gradients")
NAME = "constrained_optimum"
NO_PICTURE = "matplotlib is not installed, so the picture is left out: pip install 'jaxgrasp[bench]'"


def measure(section: str, rivals: list[Rival], differentiators: list[Differentiator], quick: bool):
    """Measure one section of the report."""
    sections: dict[str, Callable[[], object]] = {
        "singles": lambda: times.singles(rivals, times.QUICK if quick else times.Plan()),
        "batches": lambda: times.batches(rivals, times.QUICK if quick else times.Plan()),
        "extras": lambda: extras.extras(extras.QUICK if quick else extras.Plan()),
        "stress": lambda: stress.stress(stress.QUICK if quick else stress.Plan()),
        "decisions": lambda: decisions.decisions(rivals, decisions.QUICK if quick else decisions.Plan()),
        "gradients": lambda: gradients.gradients(differentiators, gradients.QUICK if quick else gradients.Plan()),
    }
    return sections[section]()


def write(report: dict, out: Path) -> None:
    (out / f"{NAME}.json").write_text(json.dumps(report, indent=1) + "\n")
    (out / f"{NAME}.md").write_text(tables.page(report))
    if "batches" in report and "singles" in report and find_spec("matplotlib"):
        plot.draw(report["singles"] + report["batches"], out / "time_error.png")


def about(rivals: list[Rival], differentiators: list[Differentiator], missing: list[str]) -> dict:
    facts = machine()
    packages = [*(method.package for method in rivals), *(method.package for method in differentiators)]
    facts["versions"] |= registry.versions(packages)
    return {"machine": facts, "missing": missing, "extended_precision": bool(R.EXTENDED)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results"), help="folder of the three files")
    parser.add_argument("--quick", action="store_true", help="a few problems of a few kinds: a test, not a measurement")
    parser.add_argument("--only", choices=SECTIONS, action="append", help="this section; may be given again")
    options = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    options.out.mkdir(parents=True, exist_ok=True)
    rivals, missing = registry.available(most=1 if options.quick else None)
    differentiators, more = gradients.available()
    report_file = options.out / f"{NAME}.json"
    report = json.loads(report_file.read_text()) if options.only and report_file.exists() else {}
    no_picture = [] if find_spec("matplotlib") else [NO_PICTURE]
    report |= about(rivals, differentiators, [*missing, *more, *no_picture])
    for line in report["missing"]:
        print(line)
    for section in options.only or SECTIONS:
        print(f"{section} ...", flush=True)
        report[section] = measure(section, rivals, differentiators, options.quick)
        # Hours may lie between sections: what is measured is kept.
        write(report, options.out)


if __name__ == "__main__":
    main()
