"""Accuracy of the psychophysics: bias, coverage, the efficiency of procedures, and the effect of devices.

    python -m benchmarks.psychophysics --out benchmarks/results

Writes psychophysics.json and psychophysics.md. Simulated experiments at the paper's design (references 1, 2 and 3 N
with Weber fractions as it prints them; differences of 5 to 30 %; 10 answers a level of one person, 50 of five) and at
ten times as many answers. Some minutes; no times are measured.
"""

import random
from dataclasses import asdict
from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq

from benchmarks.page import psychophysics_tables
from benchmarks.sections import run_sections
from jaxgrasp.paper.tables import DIFFERENCES, REFERENCE_WEIGHTS, WEBER
from jaxgrasp.psychophysics.analysis.counts import count
from jaxgrasp.psychophysics.analysis.likelihood import Model
from jaxgrasp.psychophysics.analysis.threshold import Threshold, threshold
from jaxgrasp.psychophysics.prediction import (
    Recovery,
    by_bootstrap,
    by_likelihood,
    cheapest,
    jnd_through,
    shares_of_device,
)
from jaxgrasp.psychophysics.procedures import Adaptive, ConstantStimuli, Settings, Staircase
from jaxgrasp.psychophysics.psychometric import Observer, PsychometricShape, hit_probability

NAME = "psychophysics"
LEVELS = np.array(DIFFERENCES)
ANSWERS = (10, 50, 100, 500)
"""At each level: of one person and of five at the paper's design, and ten times as many."""
WIDTHS = {
    PsychometricShape.GAUSSIAN: 0.15,
    PsychometricShape.LOGISTIC: 0.09,
    PsychometricShape.WEIBULL: 0.8,
    PsychometricShape.DIFFERENCE: 1.0,
}
MOST = (0.05, 0.1)
"""Largest shares of lapses that a fit may find."""
LAPSES = (0.0, 0.04)
"""Shares of trials answered wrong for want of attention."""
REAL = 0.10
"""Weber fraction of real weights, as the paper cites it."""


class Effort(NamedTuple):
    experiments: int = 1000
    resamples: int = 1000
    runs: int = 400


QUICK = Effort(experiments=60, resamples=100, runs=10)


def recovery(effort: Effort) -> list[dict]:
    """Fit each function to answers drawn from itself, at each of the paper's three Weber fractions."""
    rows = []
    for shape, width in WIDTHS.items():
        for lapse in ((0.0, 0.0), (0.0, 0.05)):
            for reference, truth in zip(REFERENCE_WEIGHTS, WEBER, strict=True):
                for answers in ANSWERS:
                    rng = np.random.default_rng(answers)
                    chances = hit_probability(shape, LEVELS, truth, width, sum(lapse) / 2)
                    hits = rng.binomial(answers, chances, (effort.experiments, len(LEVELS)))
                    recoveries = by_likelihood(hits, answers, LEVELS, Model(shape, lapse=lapse), truth)
                    for method, recovery_of_method in recoveries.items():
                        rows.append(
                            _row(
                                method,
                                recovery_of_method,
                                shape=shape,
                                free=lapse[1] > 0,
                                reference=reference,
                                answers=answers,
                            )
                        )
    return rows


def misfit(effort: Effort) -> list[dict]:
    """Fit each method to answers of an observer with noisy sensations, at the paper's Weber fraction for 2 N."""
    rows, truth = [], WEBER[1]
    observer = Observer(truth)
    for answers in ANSWERS:
        rng = np.random.default_rng(answers)
        chances = np.asarray(observer.hit_probability(2.0, 2.0 * (1 + LEVELS)))
        hits = rng.binomial(answers, chances, (effort.experiments, len(LEVELS)))
        for shape in WIDTHS:
            recoveries = by_likelihood(hits, answers, LEVELS, Model(shape), truth)
            rows.append(_row(f"likelihood, {shape}", recoveries["likelihood"], answers=answers))
        for method in ("interpolation", "line", "paper"):
            recovery_of_method = by_bootstrap(hits, answers, LEVELS, Model(), truth, method, effort.resamples, rng)
            rows.append(_row(method, recovery_of_method, answers=answers))
    return rows


def procedures(effort: Effort) -> list[dict]:
    """Compare the precision of 40 and 120 trials of one person by procedure, with the same likelihood."""
    observer, truth, rows = Observer(WEBER[1]), WEBER[1], []
    for trials in (40, 120):
        plans: dict[str, Settings] = {
            "constant stimuli, the paper's": ConstantStimuli(series=trials // 8),
            "constant stimuli, 10 and 25 %": ConstantStimuli(levels=(0.10, 0.25), series=trials // 4),
            "staircase, 1 up 2 down": Staircase(interleaved=1, reversals=trials, trials=trials),
            "staircase, 1 up 3 down": Staircase(interleaved=1, reversals=trials, trials=trials, down=3),
            "adaptive (psi)": Adaptive(trials=trials),
        }
        for name, settings in plans.items():
            rows.append({"procedure": name, "trials": trials, **_many_persons(settings, observer, truth, effort.runs)})
    return rows


def lapses(effort: Effort) -> list[dict]:
    """Measure the effect of lapses, and of a belief of another shape than the fit's, on thresholds at 0.75."""
    rows = []
    for lapse in LAPSES:
        observer = Observer(WEBER[1], lapse=lapse)
        truth = float(brentq(lambda level, o=observer: o.hit_probability(2.0, 2.0 * (1 + level)) - 0.75, 0.01, 1.0))
        for trials in (40, 120):
            for name, settings, most in _lapse_cases(trials):
                statistics = _many_persons(settings, observer, truth, effort.runs, most)
                rows.append({"procedure": name, "lapse": lapse, "trials": trials, "most": most, **statistics})
    return rows


def _lapse_cases(trials: int) -> list[tuple[str, Settings, float]]:
    """Return procedures, and the largest share of lapses that their fit may find."""
    staircase = Staircase(interleaved=1, reversals=trials, trials=trials)
    weibull, difference = (
        (f"adaptive, believing in {shape}", Adaptive(trials=trials, shape=shape))
        for shape in (PsychometricShape.WEIBULL, PsychometricShape.DIFFERENCE)
    )
    unmatched = [
        (name, settings, most)
        for name, settings in (difference, ("staircase, 1 up 2 down", staircase))
        for most in MOST
    ]
    return [(*weibull, MOST[0]), *unmatched]


def _many_persons(
    settings: Settings, observer: Observer, truth: float, runs: int, most: float = 0.05
) -> dict[str, float | None]:
    """Return bias, spread and coverage of the thresholds of ``runs`` simulated sessions."""
    thresholds = [_one_person(settings, observer, seed, most) for seed in range(runs)]
    estimates = np.array(
        [
            person_threshold.estimate if np.isfinite(person_threshold.estimate) else np.inf
            for person_threshold in thresholds
        ]
    )
    low, middle, high = np.quantile(estimates, [0.1587, 0.5, 0.8413], method="nearest")
    return {
        "bias": middle / truth - 1,
        "spread": (high - low) / (2 * truth) if np.isfinite(high) else None,
        "coverage": float(
            np.mean([person_threshold.low <= truth <= person_threshold.high for person_threshold in thresholds])
        ),
        "none": float(np.mean(~np.isfinite(estimates))),
    }


def _one_person(settings: Settings, observer: Observer, seed: int, most: float) -> Threshold:
    """Return the threshold of a simulated session by the difference shape, the default where levels follow answers."""
    procedure, rng = settings.begin(random.Random(seed)), np.random.default_rng(seed)
    levels, right = [], []
    while (presented := procedure.next()) is not None:
        is_right = rng.random() < observer.hit_probability(2.0, 2.0 * (1 + presented.level))
        levels.append(presented.level)
        right.append(bool(is_right))
        procedure.score(float(is_right))
    return threshold(
        count(np.array(levels), np.array(right)), model=Model(PsychometricShape.DIFFERENCE, lapse=(0.0, most))
    )


def power(effort: Effort) -> list[dict]:
    """Design experiments for a standard error of 0.01 and 0.02 of the mean Weber fraction at 2 N, persons as different
    as the paper's."""
    rows = []
    for target_error in (0.02, 0.01):
        for design in cheapest(
            target_error, Observer(WEBER[1]), 2.0, LEVELS, between=0.035, experiments=effort.experiments
        ):
            rows.append({"wanted": target_error, **asdict(design), "total": design.total(len(LEVELS))})
    return rows


def device(_: Effort) -> list[dict]:
    """Predict Weber fractions through the paper's glove for a person with 10 % for real weights, by assumption."""
    import jax

    from jaxgrasp.glove.model import lrp_hand_master
    from jaxgrasp.glove.simulated.simulated_glove import Cable
    from jaxgrasp.lab.felt_objects import felt_object
    from jaxgrasp.lab.stimuli import glove_error
    from jaxgrasp.psychophysics.plan import FIG_8, StimulusPlan

    jax.config.update("jax_enable_x64", True)
    model = lrp_hand_master()
    two_fingers, observer, rows = felt_object(StimulusPlan(fingers=FIG_8), model), Observer(REAL), []
    for sliding in (0.0, 0.05, 0.08):
        for pretension in (0.0, 1.0, 2.0) if sliding else (0.0,):
            error = glove_error(two_fingers, model, cable=Cable(14, sliding=sliding), pretension=pretension)
            fractions = [jnd_through(observer, error, reference) / reference for reference in (1.0, 1.5, 2.0)]
            shares = {name: jnd / 2.0 for name, jnd in shares_of_device(observer, error, 2.0).items()}
            rows.append(
                {
                    "sliding": sliding,
                    "pretension": pretension,
                    "limit": error.limit,
                    "quantum": error.quantum,
                    "fractions": [value if np.isfinite(value) else None for value in fractions],
                    "shares": {name: value if np.isfinite(value) else None for name, value in shares.items()},
                }
            )
    return rows


def _row(method: str, recovery_of_method: Recovery, **where) -> dict:
    numbers = {name: value if np.isfinite(value) else None for name, value in asdict(recovery_of_method).items()}
    return {
        "method": method,
        **{name: str(v) if isinstance(v, PsychometricShape) else v for name, v in where.items()},
        **numbers,
    }


SECTIONS = {
    "recovery": recovery,
    "misfit": misfit,
    "procedures": procedures,
    "lapses": lapses,
    "power": power,
    "device": device,
}


if __name__ == "__main__":
    run_sections(__doc__, NAME, SECTIONS, (Effort(), QUICK), psychophysics_tables.page, named="effort")
