"""The worst margin of a task is raised within bounds: known summits, an independent optimiser, bad input."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import minimize

import jaxgrasp
from jaxgrasp import Grasp
from jaxgrasp.grip import Task
from jaxgrasp.sensitivity import Output, cylinder_task, friction_reserve, raise_worst

TIMES = (np.arange(24) + 0.5) / 6
FINGERS = ("thumb", "index", "middle", "ring", "little")
BY_B = Output("friction_margin", "B")
SINGLE = Grasp(jnp.zeros((1, 3)), jnp.array([[0.0, 0.0, 1.0]]), jnp.ones(1), jnp.ones(1))


def toy_at(parameters, time):
    """Return a grasp and a wrench that carries the inputs of the toy margins below."""
    place, lift = parameters["place"], parameters["lift"]
    return SINGLE, jnp.stack([place[0], place[1], lift, time, 0 * time, 0 * time])


def toy(place=(0.3, -0.2), lift=1.0) -> Task:
    return Task({"place": jnp.array(place), "lift": lift}, toy_at)


def nearest_ends(_, wrench):
    """Return the margin of a point among targets that move with time from -1 to 3; its worst is largest at 1."""
    return -((wrench[..., 0] - wrench[..., 3]) ** 2)


def ridge(_, wrench):
    return wrench[..., 0] ** 2 - wrench[..., 1] ** 2


def lost_at_once(_, wrench):
    lost = jnp.full_like(wrench[..., 0], -jnp.inf)
    return jnp.stack([wrench[..., 0], lost], -1)


def nowhere_beyond(_, wrench):
    """Return a margin that rises towards a cliff at 1, beyond which it is NaN."""
    rise = wrench[..., 0] + 0 * wrench[..., 3]
    return jnp.where(rise < 1, rise, jnp.nan)


def no_limit(_, wrench):
    bounded = -((wrench[..., 0] - 0.5) ** 2) * jnp.ones_like(wrench[..., 3])
    return jnp.stack([bounded, jnp.full_like(bounded, jnp.inf)], -1)


def recomputed(task: Task, times: np.ndarray, margin) -> np.ndarray:
    return np.asarray(jax.tree.leaves(margin(*jax.vmap(task)(jnp.asarray(times))))[0])


def test_a_known_summit():
    solution = raise_worst(toy(), np.linspace(-1, 3, 9), nearest_ends, {"place[0]": (-2, 2)})
    assert solution.moves.keys() == {"place[0]"}
    np.testing.assert_allclose(solution.values, 1, atol=1e-3)
    np.testing.assert_allclose([solution.worst_before, solution.worst], [-(2.7**2), -4], rtol=1e-3)
    np.testing.assert_array_equal(solution.task.parameters["place"][1], -0.2)


def test_it_leaves_a_ridge_for_the_bounds():
    solution = raise_worst(toy((0.0, 0.0)), [0.0, 1.0], ridge, {"place": (np.array([-3, -1]), np.array([3, 1]))})
    assert solution.worst_before == 0
    assert solution.worst == pytest.approx(9, rel=1e-2)
    assert np.all(np.abs(solution.values) <= [3, 1])


def test_infinite_margins_limit_nothing():
    solution = raise_worst(toy(), [0.0, 1.0], no_limit, {"place[0]": (0, 2)})
    np.testing.assert_allclose(solution.values, 0.5, atol=1e-3)
    assert np.isposinf(solution.margins[:, 1]).all()


def test_what_is_no_number_is_not_entered():
    solution = raise_worst(toy(), [0.0, 1.0], nowhere_beyond, {"place[0]": (-2, 2)})
    assert 0.3 < solution.worst < 1


@pytest.mark.parametrize("unit", [1e8, 1.0, 1e-6])
def test_the_summit_does_not_depend_on_the_unit(unit):
    """Nor on margins that are far from the worst, nor on a start at which all are alike."""

    def rivals(_, wrench):
        x, y = wrench[..., 0], wrench[..., 1]
        return unit * jnp.stack([x, 1 - x - (y - 0.6) ** 2, 0.8 - (x - y) ** 2, 1e4 + 0 * x], -1)

    solution = raise_worst(toy((0.1, 0.3)), [0.0], rivals, {"place": (0, 1)})
    np.testing.assert_allclose(solution.worst, unit * 0.5, rtol=1e-3)
    alike = raise_worst(toy((0.2, 0.1)), [0.0], lambda _, w: unit * w[..., :2] * jnp.array([1, 2]), {"place": (0, 1)})
    np.testing.assert_allclose(alike.worst, unit, rtol=1e-3)


def test_large_margins_keep_their_sums():
    within = {"place": (-2, 2)}
    solution = raise_worst(toy(), [0.0], lambda _, w: 1e3 * (w[..., :1] - w[..., 1:2]), within, totals=["place"])
    np.testing.assert_allclose(solution.values.sum(), 0.1, atol=1e-12)
    np.testing.assert_allclose(solution.worst, 1e3 * (2 - -1.9), rtol=1e-3)


def test_never_worse_than_the_start():
    solution = raise_worst(toy((1.0, 0.0)), np.linspace(-1, 3, 9), nearest_ends, {"place[0]": (-2, 4)})
    assert solution.worst >= solution.worst_before == -4


def test_sums_stay_and_nothing_else_moves():
    within = {"place": (-5, np.array([5, 0.1]))}
    solution = raise_worst(toy((0.3, -0.2)), np.linspace(-1, 3, 9), nearest_ends, within, totals=["place"])
    np.testing.assert_allclose(solution.values.sum(), 0.1, atol=1e-12)
    np.testing.assert_allclose(solution.values[0], 1, atol=1e-3)
    assert solution.task.parameters["lift"] == 1.0


@pytest.fixture(scope="module")
def by_contributions():
    """Improve the paper's task by method B, with free contributions of constant sum."""
    within = {"contributions": (0.05, 4.0)}
    return raise_worst(
        cylinder_task(), TIMES, BY_B, within, totals=["contributions"], labels={"contributions": FINGERS}
    )


@pytest.mark.slow
def test_contributions_of_the_papers_task(by_contributions):
    improved = by_contributions
    assert improved.worst > improved.worst_before + 0.25
    np.testing.assert_allclose(improved.values.sum(), improved.values_before.sum(), rtol=1e-12)
    assert np.all((improved.values > 0.05) & (improved.values < 4))
    np.testing.assert_allclose(recomputed(improved.task, TIMES, BY_B), improved.margins, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(improved.moves["contributions[index]"], (0.1, improved.values[1]))
    # Fingers side by side opposite a thumb share the load in proportion: what turns through all directions leans out
    # of each cone's axis by the arcsine of weight over total squeeze, and no sharing can do much about that.
    squeeze = 1000 * 2.5e-3 * float(improved.values_before.sum())
    assert improved.worst == pytest.approx(np.arctan(0.5) - np.arcsin(10 / squeeze), abs=0.01)


@pytest.mark.slow
def test_an_independent_optimiser_climbs_no_higher(by_contributions):
    """SLSQP on the epigraph: the largest t with every margin at least t, by exact derivatives too."""
    task = cylinder_task()

    @jax.jit
    def margins(values):
        held = jaxgrasp.grip.HeldCylinder(**{**vars(task.parameters.held), "contributions": values})
        carried = jaxgrasp.grip.carrying(held, task.parameters.path, task.parameters.gravity)
        return BY_B(*jax.vmap(carried)(jnp.asarray(TIMES)))["friction_margin"].ravel()

    slopes = jax.jit(jax.jacfwd(margins))
    start = np.asarray(by_contributions.values_before)
    above = {
        "type": "ineq",
        "fun": lambda x: np.asarray(margins(x[:-1])) - x[-1],
        "jac": lambda x: np.c_[np.asarray(slopes(x[:-1])), -np.ones(len(TIMES) * 5)],
    }
    same_sum = {"type": "eq", "fun": lambda x: x[:-1].sum() - start.sum(), "jac": lambda x: np.r_[np.ones(5), 0]}
    best = -np.inf
    for seed in range(4):
        begin = np.clip(start * np.random.default_rng(seed).uniform(0.5, 1.5, 5), 0.06, 3.9)
        optimum = minimize(
            lambda x: -x[-1],
            np.r_[begin, -1.0],
            jac=lambda x: np.r_[np.zeros(5), -1],
            bounds=[(0.05, 4.0)] * 5 + [(None, None)],
            constraints=[above, same_sum],
            method="SLSQP",
            options={"maxiter": 200},
        )
        if abs(optimum.x[:-1].sum() - start.sum()) < 1e-6:
            best = max(best, float(margins(optimum.x[:-1]).min()))
    assert best > by_contributions.worst_before
    assert by_contributions.worst > best - 2e-3


@pytest.mark.slow
def test_places_that_hold_what_the_papers_task_lets_slip():
    """The paper's grasp, as completed here, cannot hold its load all the way round; one that reaches about can."""
    azimuths = cylinder_task().parameters.held.azimuths
    solution = raise_worst(cylinder_task(), TIMES, friction_reserve, {"azimuths": (azimuths - 0.6, azimuths + 0.6)})
    assert solution.worst_before < 0.7
    assert solution.worst > 1.1
    between = recomputed(solution.task, TIMES + 0.08, friction_reserve)
    assert between.min() > 1
    optimum = jaxgrasp.constrained_optimum(*jax.vmap(solution.task)(jnp.asarray(TIMES)))
    assert np.all(optimum.verdict <= jaxgrasp.Verdict.OPTIMAL)


@pytest.mark.parametrize(
    "change, message",
    [
        ({"within": {"plaice": (0, 1)}}, "name 'plaice' is unknown: did you mean 'place'?"),
        ({"within": {}}, "no names of parameters are given"),
        ({"within": {"place": (0, 1)}}, r"place\[1\] is -0.2: expected between its finite bounds 0 and 1"),
        ({"within": {"place[0]": (1, 0)}}, r"place\[0\] is 0.3: expected between its finite bounds 1 and 0"),
        ({"within": {"place[0]": (np.nan, 1)}}, r"place\[0\] is 0.3: expected between its finite bounds nan and 1"),
        ({"within": {"place": (-1, 1), "place[1]": (-1, 1)}}, r"within has place\[1\] twice"),
        ({"within": {"place": (np.zeros(3) - 1, 1)}}, "a bound of place has 3 entries: expected one, or 2"),
        ({"within": {"place": 1.0}}, r"within has 1.0 for place: expected \(the least, the largest\)"),
        ({"totals": ["lift"]}, "totals has lift, which is not in within"),
        ({"totals": "lift"}, "totals is 'lift' of type str: expected a list, not one text"),
        ({"totals": ["place", "place[1]"]}, r"totals has place\[1\] twice"),
        ({"within": {"place": (-np.inf, 1)}}, r"place\[0\] is 0.3: expected between its finite bounds -inf and 1"),
        ({"labels": {"plaice": ("x", "y")}}, "plaice"),
        ({"margin": lost_at_once}, r"lost_at_once\[1\] is -inf at times\[0\], 0 s: expected a number"),
        ({"steps": 0}, "steps is 0: expected a whole number, 1 or more"),
        ({"times": [1.0, 0.0]}, r"times\[1\] is 0: expected more than times\[0\], 1"),
    ],
)
def test_bad_input(unchecked, change, message):
    good = {"task": toy(), "times": [0.0, 1.0], "margin": ridge, "within": {"place": (-1, 1)}}
    with pytest.raises((TypeError, ValueError), match=message):
        raise_worst(**{**good, **change})
