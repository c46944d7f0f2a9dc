"""A program that runs an experiment and says what is on record, to be killed: folder, subject, series."""

import sys
from pathlib import Path

from jaxgrasp.psychophysics.person import SimulatedPerson
from jaxgrasp.psychophysics.plan import Plan
from jaxgrasp.psychophysics.procedures import ConstantStimuli
from jaxgrasp.psychophysics.psychometric import Observer
from jaxgrasp.psychophysics.session import run_experiment
from jaxgrasp.psychophysics.trial import IdealStimulus

if __name__ == "__main__":
    folder, subject, series = sys.argv[1:]
    plan = Plan(procedure=ConstantStimuli(series=int(series)))
    person = SimulatedPerson(Observer(), plan.seed, subject)
    done = lambda record: print(record["number"], flush=True)  # noqa: E731
    run_experiment(plan, subject, Path(folder), IdealStimulus(), person, resume=True, recorded=done)
