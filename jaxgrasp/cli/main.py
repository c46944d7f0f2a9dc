"""Entry point of the command ``jaxgrasp``.

How help shows an argument that may be left out: by what it takes where it is given, without a word on ``None``.
"""

import io
import os
import sys
import warnings
from collections.abc import Sequence
from dataclasses import replace
from importlib import import_module
from importlib.metadata import version
from types import NoneType, UnionType
from typing import Annotated, Any, Union, get_args

import tyro
from tyro.constructors import ConstructorRegistry, PrimitiveConstructorSpec, PrimitiveTypeInfo

from jaxgrasp.cli.arguments import (
    Check,
    CheckHand,
    Convert,
    Evaluate,
    ExportSuite,
    FindContacts,
    FollowSensitivity,
    Grip,
    Info,
    Kernel,
    ListSuite,
    Rank,
    ReadyScenes,
    RunSuite,
    SceneCommand,
    Show,
    SuiteCommand,
    Template,
    Validate,
    View,
)
from jaxgrasp.cli.experiment_arguments import (
    Analyse,
    Experiment,
    Export,
    Paper,
    PlanCommand,
    Power,
    RunExperiment,
    Screen,
)
from jaxgrasp.cli.glove_arguments import Ablate, Align, Calibrate, Glove, Monitor, Ports, Run, Simulate, Teleop, Test
from jaxgrasp.cli.interop_arguments import (
    ACRONYM,
    BODex,
    DexGraspBench,
    DexGraspNet,
    Dexonomy,
    ExportCommand,
    ExportGraspGen,
    ExportIsaacGrasp,
    ExportLeRobot,
    GraspGen,
    GraspIt,
    ImportCommand,
    IsaacGrasp,
)
from jaxgrasp.cli.terminal import STANDARD_OUTPUT, announce, show
from jaxgrasp.files.printable import message_line

REGISTRY = ConstructorRegistry()


@REGISTRY.primitive_rule
def optional(of: PrimitiveTypeInfo) -> PrimitiveConstructorSpec | None:
    """Return the specification by which tyro reads an annotation ``X | None`` as ``X``; None for others."""
    types = get_args(of.type)
    if of.type_origin not in (Union, UnionType) or len(types) != 2 or NoneType not in types:
        return None
    (inner_type,) = (candidate for candidate in types if candidate is not NoneType)
    spec = ConstructorRegistry.get_primitive_spec(PrimitiveTypeInfo.make(inner_type, of.markers))
    if not isinstance(spec, PrimitiveConstructorSpec):
        return None

    def to_strings(value: Any) -> list[str]:
        return ["None"] if value is None else spec.str_from_instance(value)

    return replace(
        spec, is_instance=lambda value: value is None or spec.is_instance(value), str_from_instance=to_strings
    )


Command = (
    Annotated[FindContacts, tyro.conf.subcommand("contacts")]
    | Annotated[Convert, tyro.conf.subcommand("convert")]
    | Annotated[Evaluate, tyro.conf.subcommand("evaluate")]
    | Annotated[Experiment, tyro.conf.subcommand("experiment")]
    | Annotated[ExportCommand, tyro.conf.subcommand("export")]
    | Annotated[Glove, tyro.conf.subcommand("glove")]
    | Annotated[Grip, tyro.conf.subcommand("grip")]
    | Annotated[CheckHand, tyro.conf.subcommand("hand")]
    | Annotated[ImportCommand, tyro.conf.subcommand("import")]
    | Annotated[Info, tyro.conf.subcommand("info")]
    | Annotated[Kernel, tyro.conf.subcommand("kernel")]
    | Annotated[Rank, tyro.conf.subcommand("rank")]
    | Annotated[SceneCommand, tyro.conf.subcommand("scene")]
    | Annotated[FollowSensitivity, tyro.conf.subcommand("sensitivity")]
    | Annotated[Show, tyro.conf.subcommand("show")]
    | Annotated[SuiteCommand, tyro.conf.subcommand("suite")]
    | Annotated[Teleop, tyro.conf.subcommand("teleop")]
    | Annotated[Template, tyro.conf.subcommand("template")]
    | Annotated[Validate, tyro.conf.subcommand("validate")]
    | Annotated[View, tyro.conf.subcommand("view")]
)
FUNCTIONS: dict[type, str] = {
    FindContacts: "contacts.contacts_command",
    Convert: "grasp_files.convert_command",
    Template: "grasp_files.template_command",
    Evaluate: "evaluate.evaluate_command",
    **dict.fromkeys((DexGraspBench, DexGraspNet, GraspIt), "import_grasps.import_hands"),
    **dict.fromkeys((ACRONYM, GraspGen, IsaacGrasp), "import_grasps.import_grippers"),
    **dict.fromkeys((BODex, Dexonomy), "import_grasps.import_contacts"),
    ExportGraspGen: "export_grasps.export_graspgen",
    ExportIsaacGrasp: "export_grasps.export_isaac_grasp",
    ExportLeRobot: "export_grasps.export_lerobot",
    Info: "grasp_files.info_command",
    Kernel: "kernel.kernel_command",
    Validate: "grasp_files.validate_command",
    Grip: "grip.grip_command",
    Rank: "grasp_files.rank_command",
    Show: "grasp_files.show_command",
    Teleop: "teleop.teleop_command",
    View: "view.view_command",
    CheckHand: "check_files.check_hand_command",
    FollowSensitivity: "sensitivity.sensitivity_command",
    Check: "check_files.check_scene_command",
    ReadyScenes: "check_files.list_command",
    PlanCommand: "experiment_plan.plan_command",
    RunExperiment: "experiment_run.run_command",
    Screen: "experiment_terminal.screen_command",
    Analyse: "experiment_analyse.analyse_command",
    Export: "experiment_analyse.export_command",
    Paper: "experiment_analyse.paper_command",
    Power: "experiment_plan.power_command",
    ListSuite: "suite.list_command",
    ExportSuite: "suite.export_command",
    RunSuite: "suite.run_command",
    Simulate: "glove.simulate_command",
    Monitor: "glove.monitor_command",
    Test: "glove_bench.test_command",
    Run: "glove_run.run_command",
    Calibrate: "glove_setup.calibrate_command",
    Align: "glove_setup.align_command",
    Ablate: "glove_ablate.ablate_command",
    Ports: "glove.ports_command",
}
"""Module and function of each command, imported when the command runs, so that help comes without JAX."""


def run(command: Any) -> int:
    """Run a command with its arguments, or the one that a group holds; returns the exit code."""
    chosen = getattr(command, "command", command)
    module, function = FUNCTIONS[type(chosen)].split(".")
    return getattr(import_module(f"jaxgrasp.cli.{module}"), function)(chosen)


def main(arguments: Sequence[str] | None = None) -> int:
    """Parse, run, and turn expected errors into one line on stderr and the exit code 1."""
    for stream in (sys.stdout, sys.stderr):
        # A terminal without these letters shows their codes instead.
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    arguments = sys.argv[1:] if arguments is None else arguments
    command: Any = None
    format_of_python = warnings.formatwarning
    warnings.formatwarning = _format_warning
    try:
        if list(arguments) == ["--version"]:
            show(f"jaxgrasp {version('jaxgrasp')}")
            return 0
        command = tyro.cli(Command, prog="jaxgrasp", args=arguments, registry=REGISTRY)
        return run(command)
    except BrokenPipeError:
        # Whoever read what is shown has enough of it; what is in files is whole.
        _close_stdout()
        return 1
    except (ValueError, OSError, ImportError) as error:
        if isinstance(error, OSError) and error.filename == STANDARD_OUTPUT:
            _close_stdout()
        announce(f"jaxgrasp: {message_line(error)}")
        return 1
    except KeyboardInterrupt:
        hint = "; finished chunks are kept, --resume goes on with them" if isinstance(command, Evaluate) else ""
        announce(f"jaxgrasp: interrupted{hint}")
        return 130
    finally:
        warnings.formatwarning = format_of_python


def _format_warning(
    message: Warning | str, category: type[Warning], filename: str, lineno: int, line: str | None = None
) -> str:
    """Format a warning as a line of its own: the place in this package's code tells the user of a command nothing."""
    return f"{'warning' if category is UserWarning else category.__name__}: {message_line(message)}\n"


def _close_stdout() -> None:
    """Redirect stdout to the null device: output still buffered would fail again as the interpreter ends."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


if __name__ == "__main__":
    sys.exit(main())
