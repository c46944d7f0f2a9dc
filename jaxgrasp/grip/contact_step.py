"""One step in time of a rigid object among contacts with friction: the contact engine of a held object.

Table, obstacles and the links of the hand are contacts of one form. With u the velocity of the object's point relative
to the contact's own, a contact exerts

    f_n = max(floor, n - k_n u_n),   f_t = t - k_t u_t, cut to Coulomb's cone |f_t| <= mu f_n,

so that springs are implicit in time, and a rigid contact is a very stiff one. Where t = 0 the cut is smooth. The
velocity v at the end of the step balances momentum, M (v - v_free) = dt J' f(v), six equations whatever the number of
contacts, which Newton's method solves. Forces oppose the velocities at the end of the step: friction and rigid contacts
at rest add no energy.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from jaxgrasp.model.arrays import AnyArray, Bool, Float
from jaxgrasp.numerics.geometry import tangents

STAGES = np.array([1e2, 1e3, 1e4, 1e5])
"""Resistance of rigid contacts in units of the object's mass in a step: at the last stage an object sinks under its
weight by a hundred-thousandth of its free fall in the step."""
RIGID = STAGES[-1]
NEWTON_STEPS = 200
"""Largest number of Newton steps, over all stages."""
CLOSE_STEPS = 20
"""Newton steps after which a start is not close."""
TURNS = 8
"""Number of times that the limits of friction follow the normal forces, at each stage."""
LOOSE = 1e8
"""Tolerance of the earlier stages, in units of the last one's."""
TOLERANCE = 1e-22
"""Energy of the last Newton step, relative to that of the free motion."""
LENGTHS = 0.5 ** np.arange(12)
"""Step lengths that Newton's method tries, at once."""


class ContactRows(NamedTuple):
    """Contacts ``(m,)`` of an object; a contact whose forces and resistances are zero is absent."""

    points: Float[Array, "m 3"]
    """Contact points from the object's centre, along the world's axes [m]."""
    normals: Float[Array, "m 3"]
    """Unit normals, into the object."""
    friction: Float[Array, "m"]
    spin_radius: Float[Array, "m"]
    """Moment about the normal that uses as much friction as a tangential force of 1 N [m]; 0 for hard contacts."""
    velocity: Float[Array, "m 3"]
    """Velocity of the contact itself [m/s]."""
    spin: Float[Array, "m"]
    """Angular velocity of the contact itself about the normal [rad/s]."""
    pressed: Float[Array, "m"]
    """Normal force n of an object that moves with the contact [N]."""
    dragged: Float[Array, "m 3"]
    """Tangential force t likewise [N]."""
    twisted: Float[Array, "m"]
    """Moment about the normal likewise [N.m]."""
    floor: Float[Array, "m"]
    """Least normal force [N]."""
    normal_resistance: Float[Array, "m"]
    """k_n [N.s/m]"""
    tangential_resistance: Float[Array, "m"]
    """k_t [N.s/m]"""


class ContactStep(NamedTuple):
    """Motion at the end of a step, and the forces of its contacts."""

    twist: Float[Array, "6"]
    """Velocity of the centre, and angular velocity [m/s, rad/s]."""
    forces: Float[Array, "m 3"]
    """[N]"""
    moments: Float[Array, "m"]
    """Moments about the normals [N.m]."""


class ContactLaw(NamedTuple):
    """Law of m contacts, each along its own axes (normal, two tangents, spin in units of the tangents), in coordinates
    of the motion ``(k,)`` in which the inertia is the matrix ``mass``."""

    rows: Float[Array, "m 4 k"]
    """Velocities along the axes by coordinate."""
    start: Float[Array, "m 4"]
    """Relative velocities without contacts."""
    at_reference: Float[Array, "m 4"]
    """Forces where the object moves with the contact."""
    friction: Float[Array, "m"]
    floor: Float[Array, "m"]
    """Least normal force [N]."""
    normal_resistance: Float[Array, "m"]
    tangential_resistance: Float[Array, "m"]
    mass: Float[Array, "k k"]
    dt: float | AnyArray
    mass_in_step: Array
    """Mass over the length of the step, the unit of rigid contacts' resistance [kg/s]."""
    energy: Array
    """Energy that the tolerance of the solution is relative to [J]."""


class LawStep(NamedTuple):
    """Solution of the law of contacts."""

    forces: Float[Array, "m 4"]
    """Along the contacts' axes [N]."""
    change: Float[Array, "k"]
    """Change of the motion by these forces."""
    solved: Bool[Array, ""]
    """True if the rigid contacts are as stiff as ``RIGID`` says."""


def solve_contacts(
    inertia: Float[Array, "6 6"],
    free_twist: Float[Array, "6"],
    contacts: ContactRows,
    dt: float | AnyArray,
    guess: Float[Array, "6"],
    basis: Float[Array, "6 k"] | None = None,
) -> ContactStep:
    """Compute an object's motion at the end of a step among contacts.

    Args:
        inertia: mass and inertia tensor about the centre, along the world's axes [kg, kg.m^2].
        free_twist: motion at the end of the step without contacts [m/s, rad/s].
        contacts: contacts of the object.
        dt: length of the step [s].
        guess: motion from which the search starts, such as that of the step before; the result does not depend on it.
        basis: twists about the centre that a guide leaves to the object; all where not given.
    """
    axes, rows, reference, at_reference = _along_axes(contacts)
    basis = jnp.eye(6, dtype=free_twist.dtype) if basis is None else basis
    size = jnp.sqrt(jnp.maximum(jnp.diagonal(basis.T @ inertia @ basis), 1e-300))
    basis = basis / size
    # Twists that depend on one another are held apart by a trace of mass.
    mass = basis.T @ inertia @ basis
    mass = mass + 1e-12 * jnp.eye(len(mass))
    law = ContactLaw(
        rows=rows @ basis,
        start=rows @ free_twist - reference,
        at_reference=at_reference,
        friction=contacts.friction,
        floor=contacts.floor,
        normal_resistance=contacts.normal_resistance,
        tangential_resistance=contacts.tangential_resistance,
        mass=mass,
        dt=dt,
        mass_in_step=inertia[0, 0] / dt,
        # Energies of motion, and of a step of free fall
        energy=free_twist @ inertia @ free_twist + (dt * dt) * inertia[0, 0],
    )
    step = solve_law(law, jnp.linalg.solve(mass, basis.T @ inertia @ (guess - free_twist)))
    return ContactStep(
        free_twist + basis @ step.change,
        jnp.einsum("mi,mij->mj", step.forces[:, :3], axes),
        contacts.spin_radius * step.forces[:, 3],
    )


def solve_law(law: ContactLaw, start: Float[Array, "k"]) -> LawStep:
    """Solve for the forces that change the motion to the one at which the contacts exert them.

    Args:
        law: contacts, of one object or of several.
        start: change of the motion from which the search starts; the result does not depend on it.
    """
    problem = _Problem(law, ~jnp.any(law.at_reference[:, 1:] != 0, -1))
    scale = TOLERANCE * law.energy
    coupled = _solve_coupled(problem, start, scale)
    result = lax.cond(coupled.stage >= 0, lambda: coupled, lambda: _solve_in_turns(problem, scale))
    softened = problem.softened(jnp.maximum(result.stage, 0))
    forces = softened.evaluate(result.change, jnp.where(result.has_limit, result.limit, jnp.nan)).forces
    change = jnp.linalg.solve(law.mass, law.dt * jnp.einsum("mij,mi->j", law.rows, forces))
    return LawStep(forces, change, result.stage == len(STAGES) - 1)


class _State(NamedTuple):
    """Forces at a change of the motion ``(..., m)``."""

    normal: Array
    presses: Array
    """True where the normal force changes with the velocity."""
    across: Array
    """Tangential force and spin, not cut ``(..., m, 3)``."""
    length: Array
    limit: Array
    longest: Array
    """What the tangential force is divided by, in units of the limit."""
    share: Array
    """Share of it that friction leaves."""

    @property
    def forces(self) -> Array:
        """Return the forces along the contacts' axes ``(..., m, 4)``."""
        return jnp.concatenate([self.normal[..., None], self.share[..., None] * self.across], -1)


class _Problem(NamedTuple):
    """Law of contacts as equations for the change of the motion by all contacts."""

    law: ContactLaw
    is_smooth: Bool[Array, "m"]
    """True for contacts whose friction passes smoothly from rest to sliding, which needs fewer Newton steps."""

    def evaluate(self, change: Float[Array, "*t k"], limit: Float[Array, "m"] | None = None) -> _State:
        """Compute forces; friction is cut to the limits given, else, and where they are NaN, to those of the normal
        forces."""
        law = self.law
        relative = law.start + jnp.einsum("mij,...j->...mi", law.rows, change)
        along = law.at_reference[:, 0] - law.normal_resistance * relative[..., 0]
        normal = jnp.maximum(along, law.floor)
        across = law.at_reference[:, 1:] - law.tangential_resistance[:, None] * relative[..., 1:]
        length = jnp.sqrt(jnp.sum(across**2, -1))
        following = law.friction * normal
        limit = following if limit is None else jnp.where(jnp.isnan(limit), following, limit)
        # t L / max(|t|, L), and where nothing is dragged at the contact's own velocity t L / sqrt(t^2 + L^2)
        longest = jnp.where(self.is_smooth, jnp.sqrt(length**2 + limit**2), jnp.maximum(length, limit))
        share = jnp.where(longest > 0, limit / jnp.where(longest > 0, longest, 1), 0)
        return _State(normal, along > law.floor, across, length, limit, longest, share)

    def residual(self, change: Float[Array, "*t k"], state: _State) -> Float[Array, "*t k"]:
        """Compute the momentum that the forces miss."""
        # M (v - v_free) - dt J' f
        law = self.law
        return change @ law.mass - law.dt * jnp.einsum("mij,...mi->...j", law.rows, state.forces)

    def softened(self, stage: Array) -> "_Problem":
        """Return the problem with contacts no stiffer than those of a stage."""
        cap = jnp.asarray(STAGES)[stage] * self.law.mass_in_step
        k_n, k_t = self.law.normal_resistance, self.law.tangential_resistance
        softened = self.law._replace(
            normal_resistance=jnp.minimum(k_n, cap), tangential_resistance=jnp.minimum(k_t, cap)
        )
        return self._replace(law=softened)

    def potential(self, change: Float[Array, "t k"], limit: Float[Array, "m"]) -> Float[Array, "t"]:
        """Compute the convex function whose derivative is the residual with constant limits of friction."""
        law, state = self.law, self.evaluate(change, limit)
        k_n, k_t = law.normal_resistance, law.tangential_resistance
        relative = law.start + jnp.einsum("mij,tj->tmi", law.rows, change)
        # n^2 / (2 k) of the normal force above its floor, and Huber's function of the tangential force
        above = jnp.where(k_n > 0, (state.normal - law.floor) ** 2 / (2 * jnp.where(k_n > 0, k_n, 1)), 0)
        bounded = jnp.minimum(state.length, state.limit)
        huber = state.length * bounded - bounded**2 / 2
        huber = jnp.where(self.is_smooth, state.limit * (state.longest - state.limit), huber)
        rubbed = jnp.where(k_t > 0, huber / jnp.where(k_t > 0, k_t, 1), 0)
        work = jnp.sum(above - law.floor * relative[..., 0] + rubbed, -1)
        return jnp.einsum("ti,ij,tj->t", change, law.mass, change) / 2 + law.dt * work

    def slope(self, state: _State, couples: bool = True) -> Float[Array, "k k"]:
        """Compute the derivative of the residual; without that of the limits of friction where they are constant."""
        law = self.law
        k_n = jnp.where(state.presses, law.normal_resistance, 0)
        k_t = law.tangential_resistance * state.share
        unit = state.across / jnp.where(state.length > 0, state.length, 1)[:, None]
        ratio = state.length / jnp.where(state.longest > 0, state.longest, 1)
        # - d f_t / d u_t = k_t s (1 - r^2 q q'), - d f_t / d u_n = mu k_n q r^3; r is 0 or 1 where not smooth
        turning = jnp.where(self.is_smooth, ratio, jnp.where(state.length > state.limit, 1, 0))
        tangential = jnp.eye(3) - (turning**2)[:, None, None] * unit[:, :, None] * unit[:, None, :]
        block = jnp.zeros((*ratio.shape, 4, 4)).at[:, 0, 0].set(k_n)
        block = block.at[:, 1:, 1:].set(k_t[:, None, None] * tangential)
        if couples:
            coupling = (law.friction * k_n * turning**3)[:, None] * unit
            block = block.at[:, 1:, 0].set(coupling)
        return law.mass + law.dt * jnp.einsum("mij,mik,mkl->jl", law.rows, block, law.rows)


class _Solution(NamedTuple):
    """Change of the motion that solves a stage."""

    change: Array
    stage: Array
    """-1 where none was solved."""
    limit: Array
    """Limits of friction."""
    has_limit: Array
    """True where friction was cut to these limits, else it follows the normal forces."""


def _none_solved(problem: _Problem) -> _Solution:
    change = jnp.zeros(len(problem.law.mass), problem.law.mass.dtype)
    limit = jnp.zeros(problem.law.start.shape[0], problem.law.mass.dtype)
    return _Solution(change, jnp.full((), -1, jnp.int32), limit, jnp.asarray(False))


class _Search(NamedTuple):
    """Newton's method at a stage."""

    steps: Array
    stage: Array
    change: Array
    solution: _Solution


def _solve_coupled(problem: _Problem, start: Array, scale: Array) -> _Solution:
    """Solve by Newton's method: at the last stage from a close start, else from none by all stages.

    From far away, stiff friction has too many kinks for Newton's method; from the solution of a softer contact it takes
    a few steps.
    """
    mobility = jnp.linalg.inv(problem.law.mass)
    none, last = _none_solved(problem), len(STAGES) - 1

    def step(search: _Search) -> _Search:
        stage = search.stage
        current = problem.softened(stage)
        state = current.evaluate(search.change)
        towards = -jnp.linalg.solve(current.slope(state), current.residual(search.change, state))
        trials = search.change + jnp.asarray(LENGTHS, towards.dtype)[:, None] * towards
        errors = current.residual(trials, current.evaluate(trials))
        best = trials[jnp.argmin(jnp.einsum("ki,ij,kj->k", errors, mobility, errors))]
        is_solved = towards @ problem.law.mass @ towards <= _tolerances(scale)[stage]
        old, steps = search.solution, search.steps + 1
        solution = old._replace(
            change=jnp.where(is_solved, best, old.change), stage=jnp.where(is_solved, stage, old.stage)
        )
        # A start that was not close is given up.
        begins = (steps == CLOSE_STEPS) & ~is_solved
        return _Search(steps, jnp.where(begins, 0, stage + is_solved), jnp.where(begins, none.change, best), solution)

    first = _Search(jnp.zeros((), jnp.int32), jnp.full((), last, jnp.int32), start, none)
    return lax.while_loop(lambda s: (s.steps < NEWTON_STEPS) & (s.solution.stage < last), step, first).solution


def _solve_in_turns(problem: _Problem, scale: Array) -> _Solution:
    """Solve with limits of friction that are constant, each a convex problem, and follow the normal forces in turn.

    Friction opposes the motion whatever its limit, so that no turn gains energy.
    """

    def newton(current: _Problem, change: Array, limit: Array, tolerance: Array) -> tuple[Array, Array]:
        def step(state: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
            count, change, _ = state
            forces = current.evaluate(change, limit)
            matrix = current.slope(forces, couples=False)
            towards = -jnp.linalg.solve(matrix, current.residual(change, forces))
            trials = change + jnp.asarray(LENGTHS, towards.dtype)[:, None] * towards
            best = trials[jnp.argmin(current.potential(trials, limit))]
            return count + 1, best, towards @ problem.law.mass @ towards

        first = (jnp.zeros((), jnp.int32), change, jnp.full_like(tolerance, jnp.inf))
        _, change, energy = lax.while_loop(lambda s: (s[0] < NEWTON_STEPS) & (s[2] > tolerance), step, first)
        return change, energy <= tolerance

    def turn(state: tuple[Array, Array, Array, _Solution]) -> tuple[Array, Array, Array, _Solution]:
        count, change, limit, old = state
        stage = count // TURNS
        current = problem.softened(stage)
        change, is_solved = newton(current, change, limit, _tolerances(scale)[stage])
        new = _Solution(change, stage, limit, jnp.asarray(True))
        solution = jax.tree.map(lambda a, b: jnp.where(is_solved, a, b), new, old)
        return count + 1, change, problem.law.friction * current.evaluate(change).normal, solution

    none = _none_solved(problem)
    first = (jnp.zeros((), jnp.int32), none.change, none.limit, none)
    return lax.while_loop(lambda s: s[0] < TURNS * len(STAGES), turn, first)[3]


def _tolerances(scale: Array) -> Array:
    """Return the energies of the last step of each stage."""
    return scale * jnp.asarray([LOOSE] * (len(STAGES) - 1) + [1.0])


def _along_axes(contacts: ContactRows) -> tuple[Array, Array, Array, Array]:
    """Return the contacts' axes ``(m, 3, 3)``, the rows of their velocities by the twist ``(m, 4, 6)``, and along them
    their own velocities and the forces of an object that moves with them ``(m, 4)``."""
    axes = jnp.stack([contacts.normals, *tangents(contacts.normals)], 1)
    turning = jnp.cross(contacts.points[:, None], axes)
    radius = contacts.spin_radius[:, None]
    spins = jnp.concatenate([jnp.zeros_like(axes[:, 0]), radius * contacts.normals], 1)
    rows = jnp.concatenate([jnp.concatenate([axes, turning], -1), spins[:, None]], 1)
    reference = jnp.einsum("mij,mj->mi", axes, contacts.velocity)
    dragged = jnp.einsum("mij,mj->mi", axes[:, 1:], contacts.dragged)
    twisted = jnp.where(radius > 0, contacts.twisted[:, None] / jnp.where(radius > 0, radius, 1), 0)
    return (
        axes,
        rows,
        jnp.concatenate([reference, radius * contacts.spin[:, None]], 1),
        jnp.concatenate([contacts.pressed[:, None], dragged, twisted], 1),
    )
