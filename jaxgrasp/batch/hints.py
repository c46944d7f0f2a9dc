"""Hints on likely errors in the data: millimetres, outward normals, contacts on a line."""

from dataclasses import replace

import numpy as np

from jaxgrasp.batch.contact_sets import ContactSets
from jaxgrasp.batch.engine import Engine
from jaxgrasp.batch.evaluation import run, usable
from jaxgrasp.batch.reasons import Reason
from jaxgrasp.batch.sources import MILLIMETRES, TURN_ROUND, GraspSource, looks_like_millimetres
from jaxgrasp.batch.stream import StreamPlan
from jaxgrasp.batch.summary import Summary
from jaxgrasp.model.compared_methods import methods_named
from jaxgrasp.model.solution import Verdict

SAMPLE = 256


def hints(source: GraspSource, plan: StreamPlan, summary: Summary) -> list[str]:
    """Return sentences on likely errors in the data; usually the list is empty."""
    sentences: list[str] = []
    sample = next(source.chunks(SAMPLE))
    sample, _ = usable(plan.adjustments.apply(sample), skip_bad=True)
    if not len(sample):
        return sentences
    if looks_like_millimetres(sample):
        sentences.append(f"{MILLIMETRES}.")
    if warning := summary.outward.warning(f"{TURN_ROUND}."):
        sentences.append(warning)
    if not summary.outward.is_most and _share_that_holds(summary) < 0.5 and _holds_turned_round(sample, plan):
        sentences.append(
            "most grasps fail, but hold with their normals turned round: if yours point out of the object, "
            "add --normals outward."
        )
    if summary.ranked is not None and (count := int(summary.ranked.counts[Reason.LINE])):
        sentences.append(
            f"{count:,} of {summary.problems:,} cannot hold because all contacts lie on one line, as those of a "
            "parallel jaw do: hard fingers resist no torque about the line between them, however hard they squeeze. "
            "If yours press along that line and are wide or soft, say so: --torsion 0.005 (metres) gives every contact "
            "torsional friction."
        )
    return sentences


def _share_that_holds(summary: Summary) -> float:
    holds = [m.count(Verdict.CLOSED_FORM_OPTIMAL, Verdict.OPTIMAL) for m in summary.methods.values()]
    return max(holds) / max(1, summary.problems)


def _holds_turned_round(sample: ContactSets, plan: StreamPlan) -> bool:
    turned = replace(sample, normals=-sample.normals).astype(np.dtype(plan.dtype))
    engine = Engine(methods_named(("B-optimum",)), devices=1)
    verdicts = run(engine, turned)["B-optimum"].verdict
    return bool((verdicts <= Verdict.OPTIMAL).mean() > 0.5)
