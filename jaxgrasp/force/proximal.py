"""The careful optimum: a proximal pull makes the dual strongly concave, and falls away level by level.

At each level the pull holds the multiplier near the last level's, so that Newton's method starts close to
its goal however degenerate the cones are. Where no forces exist the multiplier runs off instead, and what
is left of the wrench tends to the shortest one out of reach: the proof.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array, lax

from jaxgrasp.force import dual, fours
from jaxgrasp.force.answer import Outcome
from jaxgrasp.force.certify import proof
from jaxgrasp.force.fours import Four
from jaxgrasp.force.lanes import Frame, Lanes
from jaxgrasp.force.newton import Proximal, ascend, is_optimal
from jaxgrasp.force.pseudo_inverse import Metric
from jaxgrasp.force.sixes import Six
from jaxgrasp.force.unknowns import Unknowns
from jaxgrasp.model.solution import Verdict

STRONGEST = 1e-2
STEPS_PER_LEVEL = 40
LAST_SLACK = 16.0
"""At the last level an answer may be this much coarser: near the limit of what the contacts can exert, the
multiplier is so large that its own rounding stands in the way."""


class _Search(NamedTuple):
    point: Six
    verdict: Array
    steps: Array
    certificate: Six
    decided: Array


def proximal_optimum(
    lanes: Lanes, frame: Frame, unknowns: Unknowns, metric: Metric, closed: Outcome, decided: Array
) -> Outcome:
    """The optimum of whitened lanes that are not ``decided`` and whose closed form is not optimal already."""
    optimal = closed.verdict == Verdict.CLOSED_FORM_OPTIMAL
    search = _Search(
        point=jnp.where(optimal | decided, closed.multiplier, 0),
        verdict=jnp.where(optimal, closed.verdict, Verdict.NOT_CONVERGED),
        steps=closed.steps,
        certificate=closed.certificate,
        decided=decided | optimal,
    )
    weakest = 4 * float(jnp.finfo(lanes.squeeze.dtype).eps)

    def unfinished(carry):
        strength, search = carry
        return (strength >= weakest) & ~jnp.all(search.decided)

    def fall(carry):
        strength, search = carry
        return strength / 10, _level(lanes, frame, unknowns, metric, strength, search)

    start = jnp.asarray(STRONGEST, lanes.squeeze.dtype)
    _, search = lax.while_loop(unfinished, fall, (start, search))
    best, good = _judge(lanes, unknowns, metric, search.point, LAST_SLACK)
    verdict = jnp.where(~search.decided & good, Verdict.OPTIMAL, search.verdict)
    forces = fours.where(optimal | decided, closed.forces, best)
    return Outcome(forces, search.point, verdict, search.steps, search.certificate, jnp.zeros_like(decided))


def _level(lanes: Lanes, frame: Frame, unknowns: Unknowns, metric: Metric, strength: Array, search: _Search) -> _Search:
    """One level: ascend, then ask whether the point is the optimum, or what is left a proof."""
    pull = Proximal(strength, search.point)
    ascent = ascend(lanes, unknowns, metric, search.point, search.decided, STEPS_PER_LEVEL, pull)
    forces, optimal = _judge(lanes, unknowns, metric, ascent.point, 1.0)
    rest = dual.residual(lanes, forces, unknowns)
    proven, direction = proof(lanes, frame, unknowns, rest, ascent.point - search.point)
    hopeless = ~optimal & proven
    open_ = ~search.decided
    verdict = jnp.where(optimal, Verdict.OPTIMAL, jnp.where(hopeless, Verdict.INFEASIBLE, Verdict.NOT_CONVERGED))
    return _Search(
        point=jnp.where(open_, ascent.point, search.point),
        verdict=jnp.where(open_, verdict, search.verdict),
        steps=search.steps + jnp.where(open_, ascent.steps, 0),
        certificate=jnp.where(open_ & hopeless, direction, search.certificate),
        decided=search.decided | optimal | hopeless,
    )


def _judge(lanes: Lanes, unknowns: Unknowns, metric: Metric, point: Six, slack: float) -> tuple[Four, Array]:
    """The forces of a multiplier, and whether they are the optimum."""
    best = dual.best_forces(lanes, point, unknowns).forces
    return best, is_optimal(lanes, unknowns, metric, point, best, slack)
