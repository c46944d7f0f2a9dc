"""Soft fingers and limited hands: what they cost beside hard fingers without limits, and whether answers are right.

    python -m benchmarks.limited_hands --out benchmarks/results

Writes limited_hands.json and limited_hands.md.
"""

from benchmarks.one_thread import one_thread

one_thread()

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import jaxgrasp
from benchmarks.page import limited_tables
from benchmarks.page.clock import interleaved
from benchmarks.sections import run_sections
from jaxgrasp import Grasp, Limits, Route, Verdict
from jaxgrasp.testing import limited_reference
from jaxgrasp.testing.limited_problems import limited_problems
from jaxgrasp.testing.problems import problems

NAME = "limited_hands"
KINDS = (
    "ordinary",
    "near_collinear",
    "coincident_some",
    "low_friction",
    "zero_friction",
    "wide_squeeze",
    "some_zero_squeeze",
    "infeasible",
    "scales",
    "far_frame",
    "combined",
)
BIND = (1, 2, 3, 6)
"""How many limits bind."""
BROKEN = (3, 6)
"""How many limits the optimum without them breaks, whatever binds then."""
LEVER = 0.01
"""Torsional friction over friction [m]."""


class Plan(NamedTuple):
    """Sizes and repetitions of the measurements."""

    sizes: tuple[int, ...] = (3, 5, 10, 20)
    joints: int = 20
    batch: int = 1000
    repeats: int = 15
    judged: int = 100
    tight: tuple[float, ...] = (1.0, 0.5, 0.25)


class _Hand(NamedTuple):
    """Grasps, their wrenches, and a hand whose joints feel about half of the contacts each."""

    grasp: Grasp
    wrench: jax.Array
    jacobian: np.ndarray
    torque: np.ndarray
    """Of the optimum without limits."""


def _hand(n: int, plan: Plan) -> _Hand:
    p = problems("ordinary", n, plan.batch, seed=5)
    rng = np.random.default_rng([n, plan.joints])
    grasp = jax.tree.map(jnp.asarray, Grasp(p.points, p.normals, p.friction, p.squeeze))
    jacobian = 0.05 * rng.normal(size=(plan.batch, n, 3, plan.joints))
    jacobian *= rng.uniform(size=(plan.batch, n, 1, plan.joints)) < 0.5
    forces = np.asarray(jaxgrasp.constrained_optimum(grasp, p.wrench).forces)
    return _Hand(grasp, jnp.asarray(p.wrench), jacobian, np.abs(np.einsum("bnc,bncj->bj", forces, jacobian)))


def _limits(hand: _Hand, broken: int) -> Limits:
    """Return limits of which the optimum without them breaks ``broken``, by up to a tenth."""
    rng = np.random.default_rng(broken)
    most = hand.torque * rng.uniform(1.2, 2.5, hand.torque.shape) + 1e-3
    order = np.argsort(rng.uniform(size=most.shape), 1)[:, :broken]
    rows = np.arange(len(most))[:, None]
    most[rows, order] = hand.torque[rows, order] * rng.uniform(0.9, 1.0, order.shape)
    return Limits(torque_map=jnp.asarray(hand.jacobian), torque_max=jnp.asarray(most))


class _Variant(NamedTuple):
    """Arguments of a call, and its problems."""

    grasp: Grasp
    limits: Limits | None = None
    bind: int | None = None
    """Those alone in which so many limits bind."""


def _solve(hand: _Hand, grasp: Grasp, limits: Limits | None, rows: np.ndarray):
    selected = jax.tree.map(lambda x: x[rows], (grasp, hand.wrench, limits))
    return lambda: jax.block_until_ready(jaxgrasp.constrained_optimum(selected[0], selected[1], limits=selected[2]))


def times(plan: Plan) -> list[dict]:
    """Measure each variant beside the plain optimum of the same problems, those alone that both solve."""
    rows = []
    for n in plan.sizes:
        hand = _hand(n, plan)
        rows += [_beside_plain(n, name, hand, variant, plan) for name, variant in _variants(hand, plan).items()]
    return rows


def _variants(hand: _Hand, plan: Plan) -> dict[str, _Variant]:
    g = hand.grasp
    soft = Grasp(g.points, g.normals, g.friction, g.squeeze, torsion=LEVER * g.friction)
    bounds = Limits(normal_min=0.3 * g.squeeze, normal_max=2.0 * g.squeeze)
    variants = {
        "none": _Variant(g),
        "soft fingers": _Variant(soft),
        "normal forces bounded": _Variant(g, bounds),
        "torques limited, none binds": _Variant(g, _limits(hand, 0)),
    }
    variants |= {f"{count} bind": _Variant(g, _limits(hand, count), count) for count in BIND if count <= plan.joints}
    return variants | {f"{count} broken": _Variant(g, _limits(hand, count)) for count in BROKEN if count <= plan.joints}


def _beside_plain(n: int, name: str, hand: _Hand, variant: _Variant, plan: Plan) -> dict:
    all_rows = np.arange(plan.batch)
    solution = jax.device_get(_solve(hand, variant.grasp, variant.limits, all_rows)())
    fits = solution.verdict <= Verdict.OPTIMAL
    if variant.bind is not None:
        fits &= (solution.torque_multiplier != 0).sum(1) == variant.bind
    solved = np.flatnonzero(fits)
    # One shape for all ways, filled up with the first ones again.
    solved = np.resize(solved, plan.batch) if len(solved) else all_rows
    calls = {
        "plain": _solve(hand, hand.grasp, None, solved),
        "this": _solve(hand, variant.grasp, variant.limits, solved),
    }
    spent = interleaved(calls, plan.repeats, 10.0)
    binds = solution.torque_multiplier
    return {
        "n": n,
        "way": name,
        "microseconds": {key: value / plan.batch * 1e6 for key, value in spent.items()},
        "ratio": spent["this"] / spent["plain"],
        "binding": None if binds is None else float((binds != 0).sum(1)[solved].mean()),
        "verdicts": np.bincount(solution.verdict, minlength=len(Verdict)).tolist(),
        "careful": int((solution.route == Route.ROBUST).sum()),
    }


def right(plan: Plan) -> list[dict]:
    """Compare verdicts and objectives of every kind with Clarabel, with limits about the witness and tighter ones."""
    rows = []
    for kind in KINDS:
        for tight in plan.tight:
            limited = limited_problems(kind, 4, plan.judged, 11, soft=True, bounded=True, joints=6)
            limited = limited._replace(torque_max=tight * limited.torque_max)
            for sharing in ("squeeze", "uniform"):
                rows.append({"kind": kind, "tight": tight, "sharing": sharing} | _decision_counts(limited, sharing))
    return rows


def _decision_counts(limited, sharing: str) -> dict:
    p, weights = limited.problem, limited.problem.weights(sharing)
    solution = jax.device_get(jaxgrasp.constrained_optimum(limited.grasp, p.wrench, weights, limits=limited.limits))
    counts = {"solved": 0, "infeasible": 0, "undecided": 0, "differ": 0, "reference undecided": 0}
    gap = 0.0
    for i, verdict in enumerate(solution.verdict):
        theirs = limited_reference.optimum(limited.case(i, weights))
        named = {"Solved": "solved", "PrimalInfeasible": "infeasible"}.get(theirs.status)
        ours = (
            "solved" if verdict <= Verdict.OPTIMAL else "infeasible" if verdict == Verdict.INFEASIBLE else "undecided"
        )
        counts[ours] += 1
        counts["reference undecided"] += named is None
        counts["differ"] += named is not None and ours != "undecided" and named != ours
        if named == ours == "solved":
            scale = max(theirs.objective, p.squeeze[i].sum() / 2)
            gap = max(gap, float(solution.objective[i] - theirs.objective) / scale)
    proofs = np.asarray(
        jaxgrasp.verify_certificate(
            limited.grasp,
            p.wrench,
            solution.certificate,
            weights,
            limits=limited.limits,
            rates=solution.certificate_rates,
        )
    )
    load = np.linalg.norm(p.wrench[:, :3], axis=-1) + p.squeeze.sum(-1)
    proven = (proofs / load)[solution.verdict == Verdict.INFEASIBLE]
    return counts | {"gap": gap, "least_proof": float(min(proven, default=np.inf))}


SECTIONS = {"times": times, "right": right}
QUICK = Plan(sizes=(3,), joints=4, batch=32, repeats=2, judged=4, tight=(1.0,))


def main() -> None:
    jax.config.update("jax_enable_x64", True)
    run_sections(__doc__, NAME, SECTIONS, (Plan(), QUICK), limited_tables.page)


if __name__ == "__main__":
    main()
