"""``jaxgrasp convert`` and ``jaxgrasp template``: files of grasps out of others, or out of nothing."""

from importlib.resources import files
from pathlib import Path

from jaxgrasp.batch.sources import file_format, open_source, save_grasps
from jaxgrasp.cli.data import adjustments_of
from jaxgrasp.cli.file_arguments import Convert, Template
from jaxgrasp.cli.terminal import show
from jaxgrasp.files.replace import replace_file


def convert_command(arguments: Convert) -> int:
    """Read all, check all, write all."""
    file_format(arguments.out)
    _check_free(arguments.out, arguments.overwrite, "; --overwrite replaces it")
    adjustments = adjustments_of(arguments)
    with open_source(arguments.file, adjustments) as source:
        sets = adjustments.apply(next(source.chunks(max(1, len(source)))))
        for fault in sets.faults():
            raise ValueError(f"{arguments.file}: {fault}")
        save_grasps(arguments.out, sets)
    show(f"{arguments.out}: {len(sets):,} grasps, {len(sets.points):,} contacts")
    return 0


def template_command(arguments: Template) -> int:
    """Write the example that ships with the package."""
    _check_free(arguments.out, False, ": choose another --out")
    content = (files("jaxgrasp") / "data" / f"template.{arguments.kind}").read_bytes()
    replace_file(arguments.out, lambda stream: stream.write(content))
    show(f"{arguments.out}: fill it in, then: jaxgrasp evaluate {arguments.out}")
    return 0


def _check_free(path: Path, overwrite: bool, remedy: str) -> None:
    if path.exists() and not overwrite:
        raise FileExistsError(f"{path} exists already{remedy}")
