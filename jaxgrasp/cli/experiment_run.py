"""``jaxgrasp experiment run``: a person in a glove, or a simulated observer."""

import time
from collections.abc import Callable
from contextlib import ExitStack
from typing import Any

from jaxgrasp.cli.experiment_arguments import RunExperiment
from jaxgrasp.cli.experiment_person import TerminalPerson
from jaxgrasp.cli.experiment_plan import check_notices, observer_of, predicted, predicted_stimulus, read_plan, summary
from jaxgrasp.cli.glove import which_glove
from jaxgrasp.cli.glove_arguments import GloveDriven
from jaxgrasp.cli.glove_orders import FIRST, FULL, GOES_ON, until_armed
from jaxgrasp.cli.machine import say_compiling, set_up_jax
from jaxgrasp.cli.terminal import show, typed
from jaxgrasp.glove.devices import device_kind
from jaxgrasp.glove.glove_device import LinkState
from jaxgrasp.glove.line import check_port
from jaxgrasp.glove.loop.exchange import GloveState, TorqueLaw
from jaxgrasp.glove.loop.glove_process import GloveProcess
from jaxgrasp.glove.model import GloveModel
from jaxgrasp.glove.sensors import Sensors
from jaxgrasp.psychophysics.plan import Plan
from jaxgrasp.psychophysics.running.person import Person, SimulatedPerson
from jaxgrasp.psychophysics.running.session import check_records, run_experiment
from jaxgrasp.psychophysics.stimulus import NotFeltError, Stimulus, StimulusLostError
from jaxgrasp.validation.fields import check_positive

PATIENCE = 5.0
"""How long a glove may take to link and to arm [s]."""
Arm = Callable[[], None]
"""Asks the person, and arms the glove."""


def run_command(arguments: RunExperiment) -> int:
    """Ask until all is asked, or the person stops."""
    check_positive(arguments, "baud", "full_scale")
    acceptance = device_kind(arguments.device).acceptance
    if arguments.simulate == (arguments.port is not None):
        raise ValueError(
            "either --port, of the glove in which stimuli are felt, or --simulate, which lets an observer answer: "
            "expected one of them"
        )
    if arguments.view and arguments.simulate:
        raise ValueError("view needs the port of a glove: a simulated observer looks at nothing")
    plan = read_plan(arguments.file)
    observer = observer_of(arguments.observer)
    person: Person = TerminalPerson(plan)
    if arguments.simulate:
        check_notices(observer, plan)
        person = SimulatedPerson(observer, plan.seed, arguments.subject)
    if arguments.view:
        person = _viewed(person, plan)
    path = check_records(plan, arguments.subject, arguments.out, resume=arguments.resume, observer=person.observer)
    show("\n".join(summary(plan)))
    try:
        with ExitStack() as stack:
            stimulus, arm = (
                _simulated(arguments, plan) if arguments.simulate else _felt(arguments, plan, acceptance, person, stack)
            )
            done = _asked(arguments, plan, stimulus, person, arm)
    except KeyboardInterrupt:
        raise InterruptedError(f"stopped; all answers are in {path}, --resume goes on with them") from None
    show(f"{done} trials are in {path}; `jaxgrasp experiment analyse {arguments.out}` analyses them")
    return 0


def _asked(arguments: RunExperiment, plan: Plan, stimulus: Stimulus, person: Person, arm: Arm) -> int:
    """A trial whose stimulus was lost is asked again, once the person has armed the glove anew."""

    def lost(error: StimulusLostError) -> None:
        show(f"\n{error}: this trial does not count")
        if not isinstance(error, NotFeltError):
            arm()

    return run_experiment(plan, arguments.subject, arguments.out, stimulus, person, resume=arguments.resume, lost=lost)


def _simulated(arguments: RunExperiment, plan: Plan) -> tuple[Stimulus, Arm]:
    _, model, _ = _glove(arguments)
    stimulus = predicted_stimulus(plan, model)
    warnings = [line for line in predicted(plan, stimulus) if line.startswith("WARNING")]
    show("\n".join([*warnings, "a simulated observer answers"]))
    return stimulus, lambda: None


def _felt(
    arguments: RunExperiment, plan: Plan, acceptance: str, person: Person, stack: ExitStack
) -> tuple[Stimulus, Arm]:
    """A glove that is armed: first at a twentieth of the torque, then, when the person says so, at all of it."""
    check_port(arguments.port or "", arguments.baud)
    set_up_jax("float64")
    say_compiling("the hand and its torques")
    from jaxgrasp.lab.felt_objects import felt_object
    from jaxgrasp.lab.stimuli import GloveStimulus

    options, model, _ = _glove(arguments)
    glove = stack.enter_context(GloveProcess(arguments.port or "", len(model.joints), **options, scale=FIRST))
    _check_linked(glove, arguments.port or "")
    show("compiling")
    felt = felt_object(plan.stimulus, model)
    stimulus = GloveStimulus(felt, model, glove, **_watch(arguments, plan, felt, model, person, stack))
    stack.callback(stimulus.close)
    show("\n".join(predicted(plan, stimulus)))

    if acceptance:
        show(f"{GOES_ON}; to go on, type: {acceptance}")
    accepted = typed("") if acceptance else ""

    def arm(scale: float, words: str) -> None:
        # What is typed for an answer must not arm it.
        while typed(words).strip().lower() != "arm":
            pass
        glove.disarm()
        glove.rescale(scale)
        until_armed(glove, accepted, PATIENCE)
        stimulus.wait_until_armed(PATIENCE)

    def arm_both() -> None:
        arm(FIRST, "type arm for a twentieth of the glove's torque: ")
        arm(FULL, "feel it, and type arm for all of it: ")

    arm_both()
    return stimulus, arm_both


def _viewed(person: Person, plan: Plan) -> Person:
    """A person whose trials the pages show."""
    from jaxgrasp.view.viewed_person import ViewedPerson

    return ViewedPerson(person, plan.most_trials())


def _watch(
    arguments: RunExperiment, plan: Plan, felt: Any, model: GloveModel, person: Any, stack: ExitStack
) -> dict[str, Callable[[GloveState, TorqueLaw], None]]:
    """Both pages, where they are asked for, and who tells them what is read and computed."""
    if not arguments.view:
        return {}
    from jaxgrasp.view.view_feed import ViewFeed
    from jaxgrasp.view.view_slots import TRIAL, ViewFrame

    shown = {"felt": felt, "model": model, "kind": plan.stimulus.kind}
    ports = arguments.view_port, arguments.view_port + 1
    feed = stack.enter_context(ViewFeed(len(model.joints), TRIAL, shown, ports))
    show(f"the person's page: {feed.addresses[0]}\nthe experimenter's page: {feed.addresses[1]}")
    return {"watch": lambda state, law: feed.write(ViewFrame.ticked(state, law, person.now.vector()))}


def _glove(arguments: RunExperiment) -> tuple[dict[str, Any], GloveModel, Sensors]:
    """As [`which_glove`][jaxgrasp.cli.glove.which_glove] has it."""
    named = ("calibration", "baud", "device", "full_scale")
    return which_glove(GloveDriven(model=arguments.glove, **{name: getattr(arguments, name) for name in named}))


def _check_linked(glove: GloveProcess, port: str) -> None:
    """Before anything takes long: raise OSError unless a glove answers there."""
    end = time.perf_counter() + PATIENCE
    while (state := glove.state()) is None or state.link < LinkState.LINKED:
        if time.perf_counter() > end or not glove.is_alive():
            why = next((event["trouble"] for event in reversed(glove.events()) if event["trouble"]), "it says nothing")
            raise OSError(f"no glove answers at {port}: {why}; `jaxgrasp glove ports` lists the ports")
        time.sleep(0.02)
