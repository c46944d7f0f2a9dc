"""``jaxgrasp experiment run``: a person in a glove, or a simulated observer."""

import re
import time
from collections import Counter
from collections.abc import Callable
from contextlib import ExitStack, closing, suppress
from typing import Any

from jaxgrasp.cli.experiment_arguments import RunExperiment
from jaxgrasp.cli.experiment_plan import (
    check_notices,
    observer_of,
    predicted,
    predicted_stimulus,
    read_plan,
    stimuli,
    summary,
    warnings,
)
from jaxgrasp.cli.experiment_terminal import OtherTerminal, TerminalPerson, ask
from jaxgrasp.cli.glove import check_ports, which_glove
from jaxgrasp.cli.glove_arguments import GloveArmed
from jaxgrasp.cli.glove_orders import FIRST, FULL, GOES_ON, arm_and_confirm
from jaxgrasp.cli.machine import compiling, set_up_jax
from jaxgrasp.cli.terminal import OwnTerminal, Terminal, show, typed
from jaxgrasp.files.replace import FolderHeldError, check_writable, locked
from jaxgrasp.glove.devices import find_device_class
from jaxgrasp.glove.glove_device import LinkState
from jaxgrasp.glove.loop.exchange import GloveState, TorqueLaw
from jaxgrasp.glove.loop.glove_process import GloveProcess
from jaxgrasp.glove.model import GloveModel
from jaxgrasp.glove.sensors import Sensors
from jaxgrasp.psychophysics.person import Person, SimulatedPerson
from jaxgrasp.psychophysics.plan import Plan
from jaxgrasp.psychophysics.records import TrialRecord
from jaxgrasp.psychophysics.session import check_records, run_experiment
from jaxgrasp.psychophysics.trial import NotFeltError, Stimulus, StimulusLostError
from jaxgrasp.validation.checked import check_positive

PATIENCE = 5.0
"""Time in which a glove must link, and arm [s]."""
NUMBERS = re.compile(r" \(.*?\)")
"""Numbers in the cause of a loss, removed so that equal causes are counted together."""
Arm = Callable[[], None]
"""Function that asks the person, and arms the glove."""


def run_command(arguments: RunExperiment) -> int:
    """Ask until all is asked, or the person stops."""
    check_positive(arguments, "baud", "full_scale")
    acceptance = find_device_class(arguments.device).acceptance
    if arguments.simulate == (arguments.port is not None):
        raise ValueError(
            "expected either --port, the glove in which stimuli are felt, or --simulate, by which a simulated "
            "observer answers"
        )
    if arguments.simulate and arguments.screen is not None:
        raise ValueError("--screen is given with --simulate: a simulated observer needs no screen")
    if arguments.host != RunExperiment.host and not arguments.view:
        raise ValueError(f"host is {arguments.host}, for the pages of --view: add --view")
    if arguments.noise and not arguments.simulate:
        raise ValueError("noise is of a simulated observer: add --simulate")
    if arguments.view and arguments.simulate:
        raise ValueError("view needs the port of a glove: a simulated observer looks at nothing")
    plan = read_plan(arguments.file)
    with ExitStack() as stack:
        return _run(arguments, plan, acceptance, stack)


def _run(arguments: RunExperiment, plan: Plan, acceptance: str, stack: ExitStack) -> int:
    terminal: Terminal = OwnTerminal()
    if arguments.screen is not None:
        terminal = stack.enter_context(closing(OtherTerminal(arguments.screen)))
    person: Person = TerminalPerson(plan, terminal)
    if arguments.simulate:
        observer = observer_of(arguments.observer)
        check_notices(observer, plan)
        person = SimulatedPerson(observer, plan.seed, arguments.subject, parse_noise(arguments.noise, plan))
    if arguments.view:
        person = _viewed(person, plan)
    path = check_records(plan, arguments.subject, arguments.out, resume=arguments.resume, observer=person.observer)
    check_writable(arguments.out)
    arguments.out.mkdir(parents=True, exist_ok=True)
    try:
        stack.enter_context(locked(arguments.out, part=arguments.subject))
    except FolderHeldError as error:
        raise OSError(f"{path} is in use: {error}") from None
    show("\n".join(summary(plan)))
    try:
        stimulus, arm = (
            _simulated(arguments, plan)
            if arguments.simulate
            else _armed_glove(arguments, plan, acceptance, person, stack)
        )
        done = _run_trials(arguments, plan, stimulus, person, arm)
        if arguments.screen is not None:
            terminal.show("\nThank you, that was all.")
    except KeyboardInterrupt:
        if arguments.screen is not None:
            terminal.show("\nStopped: you feel nothing any more.")
        raise InterruptedError(
            f"stopped; all answers are in {path}, --resume goes on with them" if path.exists() else "stopped"
        ) from None
    show(f"{done} trials are in {path}; `jaxgrasp experiment analyse {arguments.out}` analyses them")
    return 0


def _run_trials(arguments: RunExperiment, plan: Plan, stimulus: Stimulus, person: Person, arm: Arm) -> int:
    """Run all trials, and repeat those whose stimulus was lost after the person arms again; return their number."""

    discarded: Counter[str] = Counter()

    def lost(error: StimulusLostError) -> None:
        discarded[NUMBERS.sub("", str(error))] += 1
        if not isinstance(error, NotFeltError):
            show(f"\n{error}")
            arm()
        elif arguments.screen is not None:
            show(f"asked again: {error}")

    def recorded(record: TrialRecord) -> None:
        if arguments.screen is not None:
            show(_trial_line(record, plan.stimulus.unit))

    try:
        return run_experiment(
            plan,
            arguments.subject,
            arguments.out,
            stimulus,
            person,
            resume=arguments.resume,
            recorded=recorded,
            lost=lost,
        )
    finally:
        for cause, count in discarded.most_common():
            show(f"discarded and asked again, {count} times: {cause}")


def parse_noise(text: str, plan: Plan) -> dict[str, float]:
    """Return the factors on the noise by condition of a text such as ``force=1,vibration=1.6``.

    Raises:
        ValueError: for a condition that the plan does not have, and a factor that is no number.
    """
    factors = {}
    for part in text.split(",") if text else ():
        condition, _, factor = part.strip().partition("=")
        if condition not in plan.within.conditions:
            known = ", ".join(plan.within.conditions) or "no condition, since the plan has no factor within persons"
            raise ValueError(f"noise names the condition {condition!r}: expected {known}")
        try:
            factors[condition] = float(factor)
        except ValueError:
            raise ValueError(f"noise of {condition} is {factor!r}: expected a number") from None
    return factors


def _trial_line(record: TrialRecord, unit: str) -> str:
    """Format stimuli and answer of a trial as a line for the experimenter alone."""
    if record["task"] == "choice":
        answer = f"answer {record['answer']}, {'right' if record['right'] else 'wrong'}"
    else:
        answer = f"set to {record['setting']:.4g} {unit}"
    first, second = (f"{record[name]:.4g}" for name in ("first", "second"))
    cut = ", a torque was cut" if record["saturated"] else ""
    return f"trial {record['number']}: {first} and {second} {unit}: {answer}{cut}"


def _simulated(arguments: RunExperiment, plan: Plan) -> tuple[Stimulus, Arm]:
    _, model, _ = _glove(arguments)
    with compiling("the hand and its torques"):
        stimulus = predicted_stimulus(plan, model)
        lines = predicted(plan, stimulus)
    show("\n".join([*warnings(lines), "a simulated observer answers"]))
    return stimulus, lambda: None


def _armed_glove(
    arguments: RunExperiment, plan: Plan, acceptance: str, person: Person, stack: ExitStack
) -> tuple[Stimulus, Arm]:
    """Link and arm a glove, at a twentieth of the torque and then, by the person's order, at all of it.

    Returns:
        The stimulus that the glove renders, and the function that arms the glove again.
    """
    options, model, _ = _glove(arguments)
    check_ports(arguments.port or "", options)
    set_up_jax("float64")
    glove = stack.enter_context(GloveProcess(arguments.port or "", len(model.joints), **options, scale=FIRST))
    _check_linked(glove, arguments.port or "")
    with compiling("the hand and its torques"):
        from jaxgrasp.lab.felt_objects import felt_object
        from jaxgrasp.lab.simulated_weight import rendering_of
        from jaxgrasp.lab.stimuli import GloveStimulus

        object_ = felt_object(plan.stimulus, model)
        rendering = rendering_of(plan.stimulus, object_, model)
        watch = _watch(arguments, plan, object_, model, person, stack)
        stimulus = GloveStimulus(object_, model, glove, rendering, **watch)
        stack.callback(stimulus.close)
        stack.push(lambda error, *_: _stop_after_error(glove, error))
        lines = predicted(plan, stimulus)
    if arguments.screen is not None:
        # Whoever is asked must not see what comes.
        show("\n".join([*stimuli(plan), *lines]))
    elif warnings(lines):
        show("WARNING: some stimuli need more torque than the glove has; `jaxgrasp experiment plan` says which")
    if acceptance:
        show(f"{GOES_ON}; to go on, type: {acceptance}")
    accepted = (typed("") or "") if acceptance else ""

    def arm(scale: float, words: str) -> None:
        # What is typed for an answer must not arm it.
        ask(OwnTerminal(), words, ("arm",), "type arm")
        glove.disarm()
        glove.rescale(scale)
        arm_and_confirm(glove, accepted, PATIENCE)
        stimulus.wait_until_armed(PATIENCE)

    def arm_both() -> None:
        while True:
            try:
                arm(FIRST, "type arm for a twentieth of the glove's torque: ")
                return arm(FULL, "feel it, and type arm for all of it: ")
            except (ValueError, OSError) as error:
                if not glove.is_alive():
                    raise
                show(error)

    show("the glove answers, and nothing is armed")
    arm_both()
    return stimulus, arm_both


def _stop_after_error(glove: GloveProcess, error: type[BaseException] | None) -> bool:
    """Execute the emergency stop where an error, an interrupt or the word ``stop`` ends the experiment."""
    if error is not None:
        with suppress(OSError, ValueError):
            glove.stop()
    return False


def _viewed(person: Person, plan: Plan) -> Person:
    """Wrap a person so that the pages in the browser show the trials."""
    from jaxgrasp.view.viewed_person import ViewedPerson

    return ViewedPerson(person, plan.most_trials())


def _watch(
    arguments: RunExperiment, plan: Plan, object_: Any, model: GloveModel, person: Any, stack: ExitStack
) -> dict[str, Callable[[GloveState, TorqueLaw], None]]:
    """Serve both pages if asked for; return the callback that sends them each state and law, as ``watch``."""
    if not arguments.view:
        return {}
    from jaxgrasp.view.view_slots import TRIAL, ViewFeed, ViewFrame

    page_data = {"felt": object_, "model": model, "kind": plan.stimulus.kind}
    ports = arguments.view_port, arguments.view_port + 1
    feed = stack.enter_context(ViewFeed(len(model.joints), TRIAL, page_data, ports, arguments.host))
    show(f"the person's page: {feed.addresses[0]}\nthe experimenter's page: {feed.addresses[1]}")
    return {"watch": lambda state, law: feed.write(ViewFrame.ticked(state, law, person.state.vector()))}


def _glove(arguments: RunExperiment) -> tuple[dict[str, Any], GloveModel, Sensors]:
    """Return options, model and sensors, as [`which_glove`][jaxgrasp.cli.glove.which_glove] does."""
    named = ("calibration", "baud", "device", "full_scale", "log", "joints_from")
    files = GloveArmed(model=arguments.glove, **{name: getattr(arguments, name) for name in named})
    options, model, sensors = which_glove(files)
    if not all(model.is_resisted):
        joint = model.joints[model.is_resisted.index(False)]
        raise ValueError(
            f"{model.name} has no motor at {joint}: an experiment needs one at every channel; give --glove, a file of "
            "the channels that have one"
        )
    return options, model, sensors


def _check_linked(glove: GloveProcess, port: str) -> None:
    """Raise OSError unless a glove answers at the port, before any long computation."""
    end = time.perf_counter() + PATIENCE
    while (state := glove.state()) is None or state.link < LinkState.LINKED:
        if time.perf_counter() > end or not glove.is_alive():
            reason = next(
                (event["trouble"] for event in reversed(glove.events()) if event["trouble"]), "it says nothing"
            )
            raise OSError(f"no glove answers at {port}: {reason}; `jaxgrasp glove ports` lists the ports")
        time.sleep(0.02)
