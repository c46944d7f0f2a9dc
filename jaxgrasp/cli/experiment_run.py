"""``jaxgrasp experiment run``: a person in a glove, or a simulated observer."""

import time
from contextlib import ExitStack

from jaxgrasp.cli.checks import check_positive
from jaxgrasp.cli.experiment_arguments import RunExperiment
from jaxgrasp.cli.experiment_person import TerminalPerson
from jaxgrasp.cli.experiment_plan import observer_of, predicted, predicted_stimulus, read_plan, summary
from jaxgrasp.cli.machine import set_up_jax
from jaxgrasp.glove.calibrate import load_model
from jaxgrasp.psychophysics.plan import Plan
from jaxgrasp.psychophysics.running.person import Person, SimulatedPerson
from jaxgrasp.psychophysics.running.records import SUFFIX
from jaxgrasp.psychophysics.running.session import check_subject, run_experiment
from jaxgrasp.psychophysics.stimulus import Stimulus

FIRST, FULL = 0.05, 1.0
PATIENCE = 5.0
"""How long a glove may take to link and to arm [s]."""


def run_command(arguments: RunExperiment) -> int:
    """Ask until all is asked, or the person stops."""
    check_positive(arguments, "baud")
    check_subject(arguments.subject)
    if arguments.simulate == (arguments.port is not None):
        raise ValueError(
            "either --port, of the glove in which stimuli are felt, or --simulate, which lets an observer answer: "
            "expected one of them"
        )
    plan = read_plan(arguments.file)
    print("\n".join(summary(plan)))
    path = arguments.out / f"{arguments.subject}{SUFFIX}"
    with ExitStack() as stack:
        person: Person = TerminalPerson(plan)
        if arguments.simulate:
            stimulus = _simulated(arguments, plan)
            person = SimulatedPerson(observer_of(arguments.observer), plan.seed, arguments.subject)
        else:
            stimulus = _felt(arguments, plan, stack)
        try:
            done = run_experiment(plan, arguments.subject, arguments.out, stimulus, person, resume=arguments.resume)
        except KeyboardInterrupt:
            raise InterruptedError(f"stopped; all answers are in {path}, --resume goes on with them") from None
    print(f"{done} trials are in {path}; `jaxgrasp experiment analyse {arguments.out}` analyses them")
    return 0


def _simulated(arguments: RunExperiment, plan: Plan) -> Stimulus:
    model, _ = load_model({"model": arguments.glove})
    stimulus = predicted_stimulus(plan, model)
    warnings = [line for line in predicted(plan, stimulus) if line.startswith("WARNING")]
    print("\n".join([*warnings, "a simulated observer answers"]))
    return stimulus


def _felt(arguments: RunExperiment, plan: Plan, stack: ExitStack) -> Stimulus:
    """A glove that is armed: first at a twentieth of the torque, then, when the person says so, at all of it."""
    set_up_jax("float64")
    from jaxgrasp.glove.loop.glove_process import GloveProcess
    from jaxgrasp.lab.felt_objects import felt_object
    from jaxgrasp.lab.stimuli import GloveStimulus

    files = {"model": arguments.glove, "calibration": arguments.calibration}
    options = {name: str(one.resolve()) for name, one in files.items() if one is not None}
    model, _ = load_model(options)
    felt = felt_object(plan.stimulus, model)
    print("compiling", flush=True)
    glove = stack.enter_context(
        GloveProcess(arguments.port or "", len(model.joints), **options, baud=arguments.baud, scale=FIRST)
    )
    stimulus = GloveStimulus(felt, model, glove)
    stack.callback(stimulus.close)
    print("\n".join(predicted(plan, stimulus)))
    for scale, words in (
        (FIRST, "Enter arms the glove at a twentieth of its torque "),
        (FULL, "Enter arms it at all "),
    ):
        input(words)
        glove.disarm()
        glove.rescale(scale)
        _arm(glove.arm)
        stimulus.wait_until_armed(PATIENCE)
    return stimulus


def _arm(arm) -> None:
    """Until there is a link and a law to follow, or nobody waits any longer."""
    end = time.perf_counter() + PATIENCE
    while True:
        try:
            return arm()
        except ValueError:
            if time.perf_counter() > end:
                raise
            time.sleep(0.1)
