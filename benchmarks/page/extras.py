"""Ratios of this package's own routes: what batching, sharing a grasp, derivatives and friction cost."""

import time
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import jaxgrasp
from benchmarks.page import devices
from benchmarks.page.clock import interleaved
from benchmarks.page.errors import chosen, first
from benchmarks.page.times import needs_cones, ordinary
from jaxgrasp import Grasp, Verdict
from jaxgrasp.testing import problems as P
from jaxgrasp.testing import references as R
from jaxgrasp.testing.references import Contacts, Problems


class Plan(NamedTuple):
    """Sizes and repetitions; all but the first two parts have five contacts."""

    sizes: tuple[int, ...] = (3, 5, 10, 20)
    batch: int = 1_000
    shared: int = 100
    batches: tuple[int, ...] = (1_000, 10_000, 100_000, 1_000_000)
    repeats: int = 15
    budget: float = 5.0


QUICK = Plan(sizes=(5,), batch=32, shared=8, batches=(32, 64), repeats=3, budget=0.5)
CONTACTS = 5


@jax.jit
def optimum(grasp: Grasp, wrench: jax.Array) -> jaxgrasp.Solution:
    return jaxgrasp.constrained_optimum(grasp, wrench)


@jax.jit
def closed(grasp: Grasp, wrench: jax.Array) -> jaxgrasp.Solution:
    return jaxgrasp.closed_form(grasp, wrench)


mapped = jax.jit(jax.vmap(jaxgrasp.constrained_optimum))


def _forces_by_squeeze(grasp: Grasp, wrench: jax.Array) -> Callable[[jax.Array], jax.Array]:
    def forces(squeeze: jax.Array) -> jax.Array:
        return jaxgrasp.constrained_optimum(Grasp(grasp.points, grasp.normals, grasp.friction, squeeze), wrench).forces

    return forces


def _jacobian(differentiate: Callable) -> Callable:
    def single(grasp: Grasp, wrench: jax.Array) -> jax.Array:
        return differentiate(_forces_by_squeeze(grasp, wrench))(grasp.squeeze)

    return jax.jit(jax.vmap(single))


forward, reverse = _jacobian(jax.jacfwd), _jacobian(jax.jacrev)


@jax.jit
def batch_forward(grasp: Grasp, wrench: jax.Array) -> jax.Array:
    """Return the Jacobians of a batch, one push forward of the whole batch for each squeeze."""
    forces, squeeze = _forces_by_squeeze(grasp, wrench), grasp.squeeze
    directions = [jnp.zeros_like(squeeze).at[:, i].set(1) for i in range(squeeze.shape[1])]
    return jnp.stack([jax.jvp(forces, (squeeze,), (direction,))[1] for direction in directions], -1)


@jax.jit
def batch_reverse(grasp: Grasp, wrench: jax.Array) -> jax.Array:
    """Return the Jacobians of a batch, one pull back of the whole batch for each force component."""
    forces, pull = jax.vjp(_forces_by_squeeze(grasp, wrench), grasp.squeeze)
    components = jnp.eye(forces[0].size).reshape(-1, *forces.shape[1:])
    rows = jax.vmap(lambda component: pull(jnp.broadcast_to(component, forces.shape))[0], out_axes=1)(components)
    return rows.reshape(*forces.shape, -1)


def on_device(problem: Problems) -> tuple[Grasp, jax.Array]:
    points, normals, friction, squeeze, wrench = jax.device_put([getattr(problem, name) for name in R.ARRAYS])
    return Grasp(points, normals, friction, squeeze), wrench


def _call(function: Callable, grasp: Grasp, wrench: jax.Array) -> Callable[[], object]:
    return lambda: jax.block_until_ready(function(grasp, wrench))


def extras(plan: Plan) -> dict:
    return {
        "closed_form_optimal": [_no_active_cone(n, plan) for n in plan.sizes],
        "price_of_friction": [_price(n, sharing, plan) for n in plan.sizes for sharing in ("squeeze", "uniform")],
        "routes": _routes(plan),
        "batches": _batches(plan),
        "compiling": [_compiling(n, plan) for n in plan.sizes],
        "devices": devices.compared(max(plan.batches) // 10),
    }


def _no_active_cone(n: int, plan: Plan) -> dict:
    """Compare the optimum with the closed form itself on a batch whose closed forms are all optimal."""
    problem = ordinary(n, 4 * plan.batch)
    index = np.flatnonzero(~needs_cones(problem, problem.squeeze))[: plan.batch]
    grasp, wrench = on_device(chosen(problem, np.resize(index, plan.batch)))
    spent = interleaved(
        {"optimum": _call(optimum, grasp, wrench), "closed": _call(closed, grasp, wrench)}, plan.repeats, plan.budget
    )
    verdicts = np.asarray(optimum(grasp, wrench).verdict)
    return {
        "n": n,
        "batch": plan.batch,
        "all_closed_form_optimal": bool((verdicts == Verdict.CLOSED_FORM_OPTIMAL).all()),
        "optimum_microseconds": spent["optimum"] / plan.batch * 1e6,
        "closed_form_microseconds": spent["closed"] / plan.batch * 1e6,
        "ratio": spent["optimum"] / spent["closed"],
    }


def _price(n: int, sharing: str, plan: Plan) -> dict:
    """Compare each closed form with its own optimum, where a cone is active."""
    problem = ordinary(n, plan.batch)
    weights = problem.weights(sharing)
    grasp, wrench = on_device(problem)
    free = jax.device_get(jaxgrasp.closed_form(grasp, wrench, weights))
    held = jax.device_get(jaxgrasp.constrained_optimum(grasp, wrench, weights))
    active = held.verdict == Verdict.OPTIMAL
    price = (held.objective - free.objective) / held.objective
    largest = np.linalg.norm(held.forces, axis=-1).max(-1)
    distances = np.linalg.norm(held.forces - free.forces, axis=-1).max(-1) / largest
    outside = R.judge(problem, weights, free.forces, free.multiplier).violation.astype(float)
    return {
        "n": n,
        "sharing": sharing,
        "active_share": float(active.mean()),
        "median_price": float(np.median(price[active])),
        "median_force_distance": float(np.median(distances[active])),
        "max_force_distance": float(distances[active].max()),
        "median_violation": float(np.median(outside[active])),
    }


def _routes(plan: Plan) -> dict:
    """Measure the microseconds a problem, or a Jacobian, by each route; five contacts."""
    problem = ordinary(CONTACTS, plan.batch)
    grasp, wrench = on_device(problem)
    # The same problems three times: only what is known to be shared differs.
    many, wrenches = on_device(_loads_of_one_grasp(problem, plan.shared))
    shared_grasp = jax.tree.map(lambda array: array[:1], many)
    single = jax.tree.map(lambda array: array[0], many)
    calls = {
        "batch": (_call(optimum, grasp, wrench), plan.batch),
        "vmap": (_call(mapped, grasp, wrench), plan.batch),
        "one grasp, many wrenches": (_call(optimum, shared_grasp, wrenches), plan.shared),
        "the same as separate grasps": (_call(optimum, many, wrenches), plan.shared),
        "the same in separate calls": (lambda: [_call(optimum, single, load)() for load in wrenches], plan.shared),
        "vmap of jacfwd, forces by squeeze": (_call(forward, grasp, wrench), plan.batch),
        "vmap of jacrev, forces by squeeze": (_call(reverse, grasp, wrench), plan.batch),
        "the same by jvp of the whole batch": (_call(batch_forward, grasp, wrench), plan.batch),
        "the same by vjp of the whole batch": (_call(batch_reverse, grasp, wrench), plan.batch),
    }
    spent = interleaved({name: call for name, (call, _) in calls.items()}, plan.repeats, plan.budget)
    return {name: spent[name] / count * 1e6 for name, (_, count) in calls.items()}


def _loads_of_one_grasp(problem: Problems, count: int) -> Problems:
    """Repeat the first grasp ``count`` times, each time with another load that it can hold."""
    rng = np.random.default_rng(0)
    repeated = chosen(problem, np.zeros(count, int))
    press = repeated.squeeze * np.exp(rng.uniform(-1.5, 1.5, repeated.squeeze.shape))
    contacts = Contacts(repeated.points, repeated.normals, repeated.friction, repeated.squeeze)
    return repeated._replace(wrench=P.exact_wrench(repeated.points, P.allowed_forces(rng, contacts, press)))


def _batches(plan: Plan) -> dict[str, float]:
    """Measure the microseconds a problem by the batch's size; five contacts."""
    problem = ordinary(CONTACTS, max(plan.batches))
    microseconds = {}
    for size in plan.batches:
        call = _call(optimum, *on_device(first(problem, size)))
        microseconds[str(size)] = interleaved({size: call}, plan.repeats, plan.budget)[size] / size * 1e6
    return microseconds


def _compiling(n: int, plan: Plan) -> dict:
    """Measure the seconds to trace and compile each solver for one shape, without a cache on disk."""
    arguments = on_device(ordinary(n, plan.batch))
    row: dict = {"n": n}
    cache_setting = jax.config.jax_enable_compilation_cache
    jax.config.update("jax_enable_compilation_cache", False)
    try:
        for name, function in {"closed_form": jaxgrasp.closed_form, "optimum": jaxgrasp.constrained_optimum}.items():
            jax.clear_caches()
            start = time.perf_counter()
            jax.jit(function).lower(*arguments).compile()
            row[name] = time.perf_counter() - start
    finally:
        jax.config.update("jax_enable_compilation_cache", cache_setting)
    return row
