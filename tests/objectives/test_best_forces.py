"""Forces by an objective: known answers, balance, cones, limits and bounds, bad options."""

import jax
import numpy as np
import pytest

from benchmarks.limited_problems import LimitedProblems, limited_problems
from jaxgrasp import OBJECTIVES, BestForces, Grasp, Verdict, best_forces

COUNT, N, JOINTS = 24, 4, 5
KINDS = ("ordinary", "low_friction", "some_zero_squeeze", "coincident_some", "far_frame", "combined")


def made_of(kind: str, *, limited: bool, seed: int = 2) -> LimitedProblems:
    """With limits, or with ones that are none: one piece of compiled code serves both."""
    made = limited_problems(kind, N, COUNT, seed, soft=True, bounded=True, joints=JOINTS)
    if limited:
        return made
    none = {name: np.full_like(getattr(made, name), np.inf) for name in ("normal_max", "torque_max")}
    return made._replace(normal_min=np.zeros_like(made.normal_min), **none)


def solve(made: LimitedProblems, objective: str, **given) -> BestForces:
    return jax.device_get(best_forces(made.grasp, made.problem.wrench, objective, limits=made.limits, **given))


def achieved(made: LimitedProblems, objective: str, forces: np.ndarray, moments: np.ndarray) -> np.ndarray:
    """An objective of given forces, from its definition."""
    g = made.grasp
    lever = np.where(g.friction > 0, g.torsion / np.where(g.friction > 0, g.friction, 1), 0)
    spin = np.where(lever > 0, moments / np.where(lever > 0, lever, 1), 0)
    size = np.sqrt((forces**2).sum(-1) + spin**2)
    if objective == "least_norm":
        return np.sqrt((size**2).sum(-1))
    if objective == "least_maximal_force":
        return size.max(-1)
    pushes = np.concatenate([forces, moments[..., None]], -1)
    return np.linalg.norm(np.einsum("bnc,bncj->bj", pushes, made.torque_map), axis=-1)


@pytest.mark.parametrize("friction", [0.2, 0.5, 1.5])
def test_two_antipodal_contacts_have_known_answers(friction):
    grasp = Grasp(
        points=[[0.03, 0, 0], [-0.03, 0, 0]],
        normals=[[-1, 0, 0], [1, 0, 0]],
        friction=[friction] * 2,
        squeeze=[9, 11.0],
    )
    load = np.array([0, 0, 2.0, 0, 0, 0])
    each = np.sqrt(1 + 1 / friction**2)
    assert np.isclose(best_forces(grasp, load, "least_maximal_force").value, each, rtol=1e-8)
    assert np.isclose(best_forces(grasp, load, "least_norm").value, np.sqrt(2) * each, rtol=1e-8)


@pytest.mark.parametrize("limited", [False, True])
@pytest.mark.parametrize("kind", KINDS)
def test_forces_are_allowed_and_worth_what_is_said(kind, limited):
    made = made_of(kind, limited=limited)
    g, w = made.grasp, made.problem.wrench
    for objective in OBJECTIVES:
        found = solve(made, objective)
        solved = found.verdict == Verdict.OPTIMAL
        assert solved.mean() > 0.9, objective
        torque = np.cross(g.points, found.forces).sum(1) + (found.moments[..., None] * g.normals).sum(1)
        wrench = np.concatenate([found.forces.sum(1), torque], -1)
        scale = np.abs(found.forces).max((1, 2)) * (1 + np.abs(g.points).max((1, 2))) + np.abs(w).max(1)
        assert (np.abs(wrench - w).max(1) < 1e-7 * scale)[solved].all(), objective
        press = (found.forces * g.normals).sum(-1)
        slack = 1e-6 * np.abs(found.forces).max((1, 2))[:, None] + 1e-6 * np.linalg.norm(w[:, :3], axis=-1)[:, None]
        lean = np.linalg.norm(found.forces - press[..., None] * g.normals, axis=-1)
        assert (lean <= g.friction * press + slack)[solved].all(), objective
        if limited:
            assert (press >= made.normal_min - slack)[solved].all(), objective
            assert (press <= made.normal_max + slack)[solved].all()
            pushes = np.concatenate([found.forces, found.moments[..., None]], -1)
            size = np.abs(made.torque_map).sum((1, 2)) * np.abs(pushes).max((1, 2))[:, None]
            turned = np.abs(np.einsum("bnc,bncj->bj", pushes, made.torque_map))
            assert (turned <= made.torque_max + 1e-6 * size)[solved].all()
        value = achieved(made, objective, found.forces, found.moments)
        nothing = 1e-8 * np.linalg.norm(w[:, :3], axis=-1)
        assert (np.abs(value - found.value) <= 1e-7 * value + nothing)[solved].all(), objective
        assert (found.bound <= found.value * (1 + 1e-9) + nothing)[solved].all(), objective


@pytest.mark.usefixtures("unchecked")
def test_bad_options_are_named():
    grasp = Grasp([[0.03, 0, 0], [-0.03, 0, 0]], [[-1.0, 0, 0], [1, 0, 0]], [0.5, 0.5], [9.0, 9.0])
    load = np.zeros(6)
    with pytest.raises(ValueError, match="objective is 'smallest': expected one of least_norm"):
        best_forces(grasp, load, "smallest")
    with pytest.raises(ValueError, match="torque_map is None"):
        best_forces(grasp, load, "least_torque")
    with pytest.raises(ValueError, match="wrench has shape"):
        best_forces(grasp, np.zeros(5), "least_norm")
