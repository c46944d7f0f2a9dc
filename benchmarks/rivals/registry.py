"""Installed rivals, and one line about each package that is missing."""

from collections.abc import Iterable
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version

from benchmarks.rivals.interface import Rival

MODULES = {
    "by_closed_form": "jaxgrasp",
    "by_jaxgrasp": "jaxgrasp",
    "by_optimistix": "optimistix",
    "by_jaxopt": "jaxopt",
    "by_moreau": "moreau",
    "by_clarabel": "clarabel",
    "by_qoco": "qoco",
    "by_ecos": "ecos",
    "by_scs": "scs",
    "by_qpax": "qpax",
}
"""Files of this package, and the import that each needs."""


def load(module: str, needs: str | tuple[str, ...], attribute: str):
    """Return an attribute of a rival's file, or the line that says why it is left out.

    Args:
        module: the file.
        needs: imports of the extra ``bench`` that it needs.
        attribute: of the file.
    """
    try:
        return getattr(import_module(f"benchmarks.rivals.{module}"), attribute)
    except ModuleNotFoundError as error:
        # Any other missing import is a fault, and not to be hidden.
        library = (error.name or "").partition(".")[0]
        if library not in ((needs,) if isinstance(needs, str) else needs):
            raise
        return f"{library} is not installed, so its rows are left out: pip install 'jaxgrasp[bench]'"


def available(most: int | None = None) -> tuple[list[Rival], list[str]]:
    """Return every rival whose package is installed, at most ``most`` from each, and a line for each other package."""
    modules = [load(module, needs, "RIVALS") for module, needs in MODULES.items()]
    rivals = [rival for part in modules if not isinstance(part, str) for rival in part[:most]]
    return rivals, [part for part in modules if isinstance(part, str)]


def versions(packages: Iterable[str]) -> dict[str, str]:
    """Return the installed version of each distribution."""
    installed = {}
    for package in sorted(set(packages)):
        try:
            installed[package] = version(package)
        except PackageNotFoundError:
            continue
    return installed
