"""Entry point of the command ``jaxgrasp``."""

import sys
from collections.abc import Sequence
from importlib.metadata import version

import tyro

from jaxgrasp.cli.arguments import Command, Evaluate


def main(arguments: Sequence[str] | None = None) -> int:
    """Parse, run, and turn expected errors into one line on stderr and the exit code 1."""
    arguments = sys.argv[1:] if arguments is None else arguments
    if list(arguments) == ["--version"]:
        print(f"jaxgrasp {version('jaxgrasp')}")
        return 0
    command = tyro.cli(Command, prog="jaxgrasp", args=arguments)
    try:
        return command.run()
    except (ValueError, OSError, ImportError) as error:
        print(f"jaxgrasp: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        kept = "; finished chunks are kept, --resume goes on with them" if isinstance(command, Evaluate) else ""
        print(f"jaxgrasp: interrupted{kept}", file=sys.stderr)
        return 130


if __name__ == "__main__":
    sys.exit(main())
