"""The careful optimum: a proximal pull makes the dual strongly concave, and falls away level by level.

At each level the pull holds the multiplier near the last level's, so that Newton's method starts close to
its goal however degenerate the cones are. Where no forces exist the multiplier runs off instead, and what
is left of the wrench tends to the shortest one out of reach: the proof.
"""

from typing import NamedTuple, Protocol, runtime_checkable

import jax.numpy as jnp
from jax import Array, lax

from jaxgrasp.force import dual
from jaxgrasp.force.certify import proof
from jaxgrasp.force.fours import Four
from jaxgrasp.force.frame import Frame
from jaxgrasp.force.lanes import Lanes
from jaxgrasp.force.newton import Dual, Hill, Proximal, ascend, is_optimal
from jaxgrasp.force.pseudo_inverse import Metric
from jaxgrasp.force.sixes import Six
from jaxgrasp.force.unknowns import Unknowns
from jaxgrasp.model.solution import Verdict

STRONGEST = 1e-2
STEPS_PER_LEVEL = 40
LAST_SLACK = 16.0
"""At the last level an answer may be this much coarser: near the limit of what the contacts can exert, the
multiplier is so large that its own rounding stands in the way."""


class Search(NamedTuple):
    """Where each lane stands."""

    point: Array
    verdict: Array
    """NOT_CONVERGED for those that are not decided."""
    steps: Array
    certificate: Array
    """As many rows as the point has; read where the verdict is INFEASIBLE."""
    decided: Array


@runtime_checkable
class Ground(Protocol):
    """What the search goes over: a hill, what its points are worth, and what they prove."""

    def pulled(self, proximal: Proximal) -> Hill:
        """The hill with a proximal pull."""
        ...

    def judge(self, point: Array, slack: float) -> tuple[Four, Array]:
        """The forces of a point, and whether they are the optimum."""
        ...

    def proof(self, point: Array, before: Array) -> tuple[Array, Array]:
        """Whether a point, or the way to it, proves that no forces exist, and the direction that does."""
        ...


class Free(NamedTuple):
    """Whitened lanes without limits that tie their contacts together."""

    lanes: Lanes
    frame: Frame
    unknowns: Unknowns
    metric: Metric

    def pulled(self, proximal: Proximal) -> Hill:
        return Dual(self.lanes, self.unknowns, self.metric, proximal)

    def judge(self, point: Six, slack: float) -> tuple[Four, Array]:
        best = dual.best_forces(self.lanes, point, self.unknowns).forces
        return best, is_optimal(self.lanes, self.unknowns, self.metric, point, best, slack)

    def proof(self, point: Six, before: Six) -> tuple[Array, Six]:
        forces = dual.best_forces(self.lanes, point, self.unknowns).forces
        rest = dual.residual(self.lanes, forces, self.unknowns)
        return proof(self.lanes, self.frame, self.unknowns, rest, point - before)


def proximal_search(ground: Ground, search: Search) -> tuple[Four, Search]:
    """The optimum of the lanes that are not decided, or a proof that there is none; and the forces of all."""
    weakest = 4 * float(jnp.finfo(search.point.dtype).eps)

    def unfinished(carry):
        strength, search = carry
        return (strength >= weakest) & ~jnp.all(search.decided)

    def fall(carry):
        strength, search = carry
        return strength / 10, _level(ground, strength, search)

    start = jnp.asarray(STRONGEST, search.point.dtype)
    _, search = lax.while_loop(unfinished, fall, (start, search))
    forces, good = ground.judge(search.point, LAST_SLACK)
    verdict = jnp.where(~search.decided & good, Verdict.OPTIMAL, search.verdict)
    return forces, search._replace(verdict=verdict)


def _level(ground: Ground, strength: Array, search: Search) -> Search:
    """One level: ascend, then ask whether the point is the optimum, or what is left a proof."""
    hill = ground.pulled(Proximal(strength, search.point))
    ascent = ascend(hill, search.point, search.decided, STEPS_PER_LEVEL)
    _, optimal = ground.judge(ascent.point, 1.0)
    proven, direction = ground.proof(ascent.point, search.point)
    hopeless = ~optimal & proven
    open_ = ~search.decided
    verdict = jnp.where(optimal, Verdict.OPTIMAL, jnp.where(hopeless, Verdict.INFEASIBLE, Verdict.NOT_CONVERGED))
    return Search(
        point=jnp.where(open_, ascent.point, search.point),
        verdict=jnp.where(open_, verdict, search.verdict),
        steps=search.steps + jnp.where(open_, ascent.steps, 0),
        certificate=jnp.where(open_ & hopeless, direction, search.certificate),
        decided=search.decided | optimal | hopeless,
    )
