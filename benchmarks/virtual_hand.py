"""The paper's Table II again: time of a tick of the virtual hand and of its parts, and how good the answers are.

    python -m benchmarks.virtual_hand --out benchmarks/results

A tick is ``observe``: posture to contacts, forces by method B and their optimum, joint torques. The hand holds spheres:
by its fingertips for 3 and 5 contacts, else in spherical power grips, as in the paper. It is left with the n links that
touch, so that n is what every solver sees. Writes virtual_hand.json and virtual_hand.md.
"""

from benchmarks.one_thread import one_thread

one_thread()

import argparse
import json
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import jaxgrasp
from benchmarks import laws
from benchmarks.closed_form import counts, force_error
from benchmarks.machine import machine
from benchmarks.page import devices, hand_tables
from benchmarks.page.clock import interleaved
from jaxgrasp import Solution
from jaxgrasp.grip import Body, GripType, Scene, power_grip, precision_grip
from jaxgrasp.grip.power_grip import lay_on
from jaxgrasp.hand import Contacts, Hand, Pose, Posture, Sphere, Spheres
from jaxgrasp.hand.to_grasp import contributions_of
from jaxgrasp.testing import references as R
from jaxgrasp.testing.references import Problems

NAME = "virtual_hand"
PAPER = {3: 2.0, 5: 2.0, 10: 3.0, 15: 5.0, 20: 7.0}
"""Table II: milliseconds for the forces of so many contacts, on a workstation of 50 MHz."""
MASS, FRICTION, STIFFNESS = 0.4, 0.6, 1000.0
CLEAR = 5e-4
"""Depth in the unperturbed grip that a link needs to be kept [m]: shallower ones would often be absent."""
TURN, SHIFT = 5e-3, 2e-4
"""By how much poses differ: standard deviations of every joint's angle [rad], and of the object's place [m]."""
BELOW, OUT_OF_REACH = 0.12, 1.0
"""How far down from the open hand the object lies within reach, and how far off out of it [m]."""
WHOLE_HAND = "whole hand"
PARTS = ("tick", "contacts", "closed form", "optimum", "torques")


class HandGrip(NamedTuple):
    """A grip of the hand on a sphere."""

    kind: GripType
    radius: float
    """[m]"""
    depth: float
    """Depth to which links close on it [m]."""

    def closed(self, hand: Hand) -> tuple[Posture, Pose, Contacts]:
        """Return posture, place of the sphere, and contacts."""
        if self.kind == GripType.SPHERICAL_POWER:
            return power_grip(hand, Sphere(self.radius), self.depth)
        return precision_grip(hand, Sphere(self.radius), int(self.kind), self.depth)


GRIPS = {
    3: HandGrip(GripType.PRECISION_3, 0.03, 2e-3),
    5: HandGrip(GripType.PRECISION_5, 0.03, 2e-3),
    10: HandGrip(GripType.SPHERICAL_POWER, 0.03, 1e-3),
    15: HandGrip(GripType.SPHERICAL_POWER, 0.046, 3e-3),
    20: HandGrip(GripType.SPHERICAL_POWER, 0.064, 8e-3),
}
"""Grips of so many contacts, of a hand whose palm has pads."""
WHOLE = GRIPS[15]
"""Grip of the whole hand, with the links that do not touch."""


class Plan(NamedTuple):
    """Sizes and repetitions of the measurements."""

    sizes: tuple[int, ...] = tuple(PAPER)
    batch: int = 10_000
    singles: int = 7
    """Poses that are computed one at a time."""
    judged: int = 1_000
    repeats: int = 21
    budget: float = 4.0
    """Seconds that one call may take up in all."""
    burst: float = 5e-3
    """Seconds that a single pose is computed again and again before it is another's turn."""


QUICK = Plan(sizes=(3,), batch=16, singles=1, judged=16, repeats=3, budget=0.5)


class Case(NamedTuple):
    """A scene, and its poses with a leading axis."""

    scene: Scene
    posture: Posture
    placed: Pose


def with_links(hand: Hand, links: np.ndarray) -> Hand:
    """Return the same hinges with the skin of these links alone."""
    kept_links = tuple(hand.links[i] for i in links)
    joints = (hand.origins, hand.rests, hand.axes, hand.lower, hand.upper)
    skin = Spheres(hand.skin.centers[links], hand.skin.radii[links])
    return Hand(*joints, skin, hand.parents, hand.joints, kept_links)


def touching(contacts: Contacts, n: int) -> np.ndarray:
    """Return the links that touch, which must be n."""
    links = np.flatnonzero(np.asarray(contacts.depths) > CLEAR)
    if len(links) != n:
        raise ValueError(f"sizes holds {n}: {len(links)} links touch in its grip, expected as many")
    return links


def cases(plan: Plan) -> dict[str, Case]:
    """Return grips of n contacts and one of the whole hand, and two cases without contact."""
    hand = jaxgrasp.hand.human_hand(palm_pads=True)
    grips = {}
    for n in plan.sizes:
        closed, placed, contacts = GRIPS[n].closed(hand)
        links = touching(contacts, n)
        grips[str(n)] = Case(scene(with_links(hand, links), GRIPS[n], hand, links), *poses(closed, placed, plan))
    closed, placed, _ = WHOLE.closed(hand)
    held = Case(scene(hand, WHOLE, hand, np.arange(len(hand.links))), *poses(closed, placed, plan))
    distant = held.placed.origin + jnp.array([0.0, 0.0, OUT_OF_REACH])
    wrist, angles = held.posture.wrist, lay_on(hand, held.scene.body.shape)[0].angles
    opened = held._replace(posture=Posture(wrist, jnp.broadcast_to(angles, held.posture.angles.shape)))
    lower = held.placed.origin - BELOW * wrist.rotation[..., 2]
    return grips | {
        WHOLE_HAND: held,
        "open hand, object within reach": opened._replace(placed=Pose(lower, held.placed.rotation)),
        "object out of reach": held._replace(placed=Pose(distant, held.placed.rotation)),
    }


def scene(hand: Hand, grip: HandGrip, whole_hand: Hand, links: np.ndarray) -> Scene:
    """Return the scene of a grip with these links of the whole hand."""
    table = Pose(jnp.array([0.0, 0.0, -1.0]), jnp.eye(3))
    gravity = jnp.array([0.0, 0.0, -9.81])
    contributions = jnp.asarray(contributions_of(whole_hand, grip.kind))[links]
    return Scene(hand, Body(Sphere(grip.radius), MASS), table, FRICTION, STIFFNESS, contributions, gravity)


def poses(closed: Posture, placed: Pose, plan: Plan) -> tuple[Posture, Pose]:
    """Return the grip turned every way as a whole, with small random changes of angles and of the object's position."""
    rng = np.random.default_rng(0)
    turns = np.linalg.qr(rng.normal(size=(plan.batch, 3, 3)))[0]
    turns[..., 0] *= np.linalg.det(turns)[:, None]
    angles = np.asarray(closed.angles) + TURN * rng.normal(size=(plan.batch, closed.angles.shape[-1]))
    origin = np.asarray(placed.origin) + SHIFT * rng.normal(size=(plan.batch, 3))
    wrist = Pose(jnp.zeros((plan.batch, 3)), jnp.asarray(turns))
    turned = Pose(jnp.asarray(np.einsum("bij,bj->bi", turns, origin)), jnp.asarray(turns @ placed.rotation))
    return Posture(wrist, jnp.asarray(angles)), turned


@jax.jit
def contacts(hand: Hand, posture: Posture, shape: Sphere, placed: Pose):
    return jaxgrasp.hand.pose_hand(hand, posture), jaxgrasp.hand.find_contacts(hand, posture, shape, placed)


tick, closed_form = jax.jit(jaxgrasp.grip.observe), jax.jit(jaxgrasp.closed_form)
optimum, torques = jax.jit(jaxgrasp.constrained_optimum), jax.jit(jaxgrasp.hand.joint_torques)


def calls(case: Case) -> dict[str, Callable]:
    """Return calls of a tick, and of its parts on the tick's own intermediate results."""
    hand, shape = case.scene.hand, case.scene.body.shape
    frames, touched = contacts(hand, case.posture, shape, case.placed)
    result = tick(*case)
    functions: dict[str, tuple[Callable, tuple]] = {
        "tick": (tick, tuple(case)),
        "contacts": (contacts, (hand, case.posture, shape, case.placed)),
        "closed form": (closed_form, (result.grasp, result.wrench)),
        "optimum": (optimum, (result.grasp, result.wrench)),
        "torques": (torques, (hand, frames, touched.points, result.assessment.forces)),
    }
    return {
        name: lambda f=f, arguments=arguments: jax.block_until_ready(f(*arguments))
        for name, (f, arguments) in functions.items()
    }


def measure(name: str, case: Case, plan: Plan) -> dict:
    """Measure one case in a batch and, where the plan has singles, alone; and the quality of its answers."""
    batched = interleaved(calls(case), plan.repeats, plan.budget)
    row = {
        "case": name,
        "contacts": len(case.scene.hand.links),
        "dtype": case.posture.angles.dtype.name,
        "batch": plan.batch,
        "threads": 1,
        "batch_microseconds": {part: seconds / plan.batch * 1e6 for part, seconds in batched.items()},
    }
    return row | (alone(case, plan) if plan.singles else {}) | quality(case, plan)


def alone(case: Case, plan: Plan) -> dict:
    """Measure the first poses, each by itself."""
    turns = {}
    for i in range(plan.singles):
        posture, placed = (jax.tree.map(lambda x, i=i: x[i], tree) for tree in (case.posture, case.placed))
        turns |= {(part, i): call for part, call in calls(Case(case.scene, posture, placed)).items()}
    spent = interleaved(turns, plan.repeats, plan.budget / 10, plan.burst)
    micro = {part: [spent[part, i] * 1e6 for i in range(plan.singles)] for part in PARTS}
    return {
        "single_microseconds": {part: float(np.median(times)) for part, times in micro.items()},
        "slowest_single_tick_microseconds": max(micro["tick"]),
    }


def quality(case: Case, plan: Plan) -> dict:
    """Count contacts and verdicts, and compute the errors of the first answers without any of the solver's code."""
    result = jax.device_get(tick(*case))
    closed, best = result.assessment.closed, result.assessment.optimum
    solved = best.verdict <= jaxgrasp.Verdict.OPTIMAL
    row = {
        "sphere_tests": float(result.contacts.tests.mean()),
        "mean_present": float(result.contacts.present.sum(-1).mean()),
        "all_present_share": float((result.contacts.present == 1).all(-1).mean()),
        "active_share": float((best.verdict == jaxgrasp.Verdict.OPTIMAL).mean()),
        "closed_form_verdicts": counts(closed.verdict),
        "optimum_verdicts": counts(best.verdict),
        "mean_newton_steps": float(best.steps.mean()),
        "judged": min(plan.judged, len(solved)),
    }
    first = lambda tree: jax.tree.map(lambda x: x[: plan.judged], tree)  # noqa: E731
    grasp = first(result.grasp)
    arrays = (grasp.points, grasp.normals, grasp.friction, grasp.squeeze)
    problem = Problems(NAME, *arrays, first(result.wrench), feasible=None)
    return row | errors(problem, first(closed), first(best)) | {"max_torque_error": torque_error(case, result)}


def errors(problem: Problems, closed: Solution, best: Solution) -> dict:
    """Return the errors of the forces over the poses that their verdict calls answered; None where there are none."""
    answered = closed.verdict <= jaxgrasp.Verdict.OUTSIDE_CONES
    held = laws.hold(problem, problem.squeeze, best)
    force_errors = force_error(problem, closed.forces)[0]
    balance = R.backward_error(R.centred(problem, problem.squeeze), closed.forces)
    return {
        "wrong": int(laws.any_of(held.broken).sum()),
        "closed_form_force_error": worst(force_errors, answered),
        "closed_form_backward_error": worst(balance, answered),
        "optimum_gap": worst(held.judgement.gap, held.solved),
        "optimum_backward_error": worst(held.judgement.backward_error, held.solved),
        "optimum_violation": worst(held.judgement.violation, held.solved),
    }


def worst(values: np.ndarray, where: np.ndarray) -> float | None:
    return float(values[where].max()) if where.any() else None


def torque_error(case: Case, result: jaxgrasp.grip.StepResult) -> float | None:
    """Return the error against the contacts' Jacobian, relative to a pose's largest torque; None without torques."""
    hand = case.scene.hand
    frames = jaxgrasp.hand.pose_hand(hand, case.posture)
    jacobian = np.asarray(jaxgrasp.hand.contact_jacobian(hand, frames, result.contacts.points), float)
    expected = -np.einsum("blcj,blc->bj", jacobian, result.exerted)
    largest = np.abs(expected).max(-1)
    differences = np.abs(result.torques - expected).max(-1)
    return worst(differences / np.where(largest > 0, largest, 1), largest > 0)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results"), help="folder of the two files")
    parser.add_argument("--quick", action="store_true", help="a few poses of one size: a test, not a measurement")
    options = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    options.out.mkdir(parents=True, exist_ok=True)
    plan = QUICK if options.quick else Plan()
    times = devices.compared(plan.batch, "benchmarks.page.hand_devices")
    rows = [measure(name, case, plan) for name, case in cases(plan).items()]
    # What was traced with 64-bit integers cannot be used without them.
    jax.clear_caches()
    with jax.enable_x64(False):
        held = {name: case for name, case in cases(plan).items() if name.isdecimal() or name == WHOLE_HAND}
        rows += [measure(name, case, plan._replace(singles=0)) for name, case in held.items()]
    radii = [GRIPS[n].radius for n in plan.sizes]
    setting = {
        "radii": radii,
        "whole_radius": WHOLE.radius,
        "mass": MASS,
        "friction": FRICTION,
        "turn": TURN,
        "shift": SHIFT,
    }
    report = {"machine": machine(), "plan": plan._asdict(), "setting": setting, "paper_ms": PAPER, "rows": rows}
    report["devices_microseconds"] = times
    (options.out / f"{NAME}.json").write_text(json.dumps(report, indent=1) + "\n")
    (options.out / f"{NAME}.md").write_text(hand_tables.page(report))


if __name__ == "__main__":
    main()
