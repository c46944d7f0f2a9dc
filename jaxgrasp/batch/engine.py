"""Engine that runs the methods on blocks of equal shape: compiled once a shape, timed by method, on all devices."""

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from threading import Lock

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from jaxgrasp.batch.blocks import Block
from jaxgrasp.model.compared_methods import ComparedMethod
from jaxgrasp.model.limits import Limits
from jaxgrasp.numerics.compiled_code import jit_here
from jaxgrasp.problem.batch_last import ProblemBatch, TorqueBounds
from jaxgrasp.problem.flatten import named_weights
from jaxgrasp.solver import phases

ANSWERED = ("forces", "moments", "verdict", "residual", "objective", "steps", "route", "certificate", "force_bound")
OF_LIMITS = ("normal_multiplier", "torque_multiplier", "certificate_rates")


@dataclass(frozen=True)
class MethodResult:
    """Results of a method on a block of problems."""

    forces: np.ndarray
    """``(B, n, 3)`` [N]."""
    verdict: np.ndarray
    residual: np.ndarray
    objective: np.ndarray
    steps: np.ndarray
    route: np.ndarray
    """Codes of [`jaxgrasp.Route`][]."""
    certificate: np.ndarray
    """``(B, 6)``."""
    force_bound: np.ndarray
    """``(B,)`` [N], as in a Solution."""
    margin: np.ndarray
    """Smallest friction margin of the loaded contacts [rad]; +inf where none is loaded."""
    violation: np.ndarray
    """Largest tangential force beyond friction's limit, max(|t| - mu n) or 0 [N], moments counted as such."""
    moments: np.ndarray | None = None
    """``(B, n)``: of soft fingers [N.m]; this and the following None where there is nothing of the kind."""
    normal_multiplier: np.ndarray | None = None
    """``(B, n)``: multipliers of the bounds of normal forces, as in a Solution."""
    torque_multiplier: np.ndarray | None = None
    """``(B, j)``: multipliers of the bounds of torques."""
    certificate_rates: np.ndarray | None = None
    """``(B, j)``."""


@dataclass
class Times:
    """Seconds spent, compiling apart; those of threads that work side by side add up."""

    compiling: float = 0.0
    solving: dict[str, float] = field(default_factory=dict)
    problems: int = 0


class Engine:
    """Compiled solvers for the blocks of one evaluation, which several threads may run at a time."""

    def __init__(
        self,
        methods: tuple[ComparedMethod, ...],
        devices: int | None = None,
        announce: Callable[[str], None] = lambda text: None,
    ):
        """Create an engine; ``announce`` is told of each number of contacts before its first programs are compiled."""
        self.methods = methods
        self._announce = announce
        self._announced: set[int] = set()
        self.times = Times(solving={method.name: 0.0 for method in methods})
        available = jax.local_devices()
        self._mesh = Mesh(np.array(available[: devices or len(available)]), ("block",))
        self._counting = Lock()

    @property
    def devices(self) -> int:
        return self._mesh.size

    def run(
        self, block: Block, problems: int, methods: tuple[ComparedMethod, ...] | None = None
    ) -> dict[str, dict[str, np.ndarray]]:
        """Run methods on a block, whose size the number of devices divides: fields of results, but for margins.

        ``problems`` of them are the user's, the rest fill the block. ``methods`` are all of the engine's where not
        given.
        """
        methods = self.methods if methods is None else methods
        block = Block(block.rows, *jax.tree.map(self._put, block[1:]))
        contacts = block.grasp.points.shape[-2]
        with self._counting:
            self.times.problems += problems
            if contacts not in self._announced:
                self._announced.add(contacts)
                self._announce(f"compiling for grasps of {contacts} contacts ...")
        results: dict[str, dict[str, np.ndarray]] = {}
        for sharing in dict.fromkeys(method.sharing for method in methods):
            results |= self._run_sharing(sharing, block, methods)
        return {method.name: results[method.name] for method in methods}

    def _run_sharing(
        self, sharing: str, block: Block, methods: tuple[ComparedMethod, ...]
    ) -> dict[str, dict[str, np.ndarray]]:
        selected = [method for method in methods if method.sharing == sharing]
        problem = _problem(sharing, block)
        closed, closed_s = self._timed(phases.solve_closed, problem)
        results = {}
        for method in selected:
            answer, finish_s = closed, 0.0
            if method.constrained:
                answer, finish_s = self._timed(phases.finish_optimum, problem, closed)
            with self._counting:
                self.times.solving[method.name] += closed_s + finish_s
            fields = {name: getattr(answer, name) for name in (*ANSWERED, *(OF_LIMITS if method.constrained else ()))}
            results[method.name] = {name: np.asarray(array) for name, array in fields.items() if array is not None}
        return results

    def _timed(self, function: Callable, *arguments) -> tuple:
        """Run a compiled function and return its results and the seconds that the run took, without compiling."""
        program = _program(function, self._mesh)
        compiled, compiling = program.compiled(arguments)
        start = time.perf_counter()
        result = jax.block_until_ready(compiled(*arguments))
        spent = time.perf_counter() - start
        with self._counting:
            self.times.compiling += compiling
        return (*result, spent) if type(result) is tuple else (result, spent)

    def _put(self, array: np.ndarray) -> Array:
        return jax.device_put(array, NamedSharding(self._mesh, PartitionSpec("block")))


class _Program:
    """A function on the devices of a mesh, compiled once for each set of shapes."""

    def __init__(self, function: Callable, mesh: Mesh):
        rows = PartitionSpec("block")
        if mesh.size > 1:
            # The blocks never talk to each other, so there is nothing for the checker to check.
            function = jax.shard_map(function, mesh=mesh, in_specs=rows, out_specs=rows, check_vma=False)
        self._jitted = jit_here(function)
        self._compiled: dict[tuple, Callable] = {}
        self._compiling = Lock()

    def compiled(self, arguments: tuple) -> tuple[Callable, float]:
        """Return the program for arguments of these shapes and the seconds of compiling, 0 if it is cached."""
        leaves, structure = jax.tree.flatten(arguments)
        key = (structure, *((leaf.shape, leaf.dtype) for leaf in leaves))
        with self._compiling:
            if key in self._compiled:
                return self._compiled[key], 0.0
            start = time.perf_counter()
            self._compiled[key] = self._jitted.lower(*arguments).compile()
            return self._compiled[key], time.perf_counter() - start


@cache
def _program(function: Callable, mesh: Mesh) -> _Program:
    return _Program(function, mesh)


def _problem(sharing: str, block: Block) -> ProblemBatch:
    grasp = jax.tree.map(jnp.asarray, block.grasp)
    limits = jax.tree.map(jnp.asarray, block.limits or Limits())
    return ProblemBatch(
        points=grasp.points,
        normals=grasp.normals,
        friction=grasp.friction,
        squeeze=grasp.squeeze,
        present=grasp.present,
        weights=jnp.asarray(named_weights(grasp, sharing, jnp)),
        wrench=jnp.asarray(block.wrench),
        torsion=grasp.torsion,
        normal_min=limits.normal_min,
        normal_max=limits.normal_max,
        torque_bounds=None if limits.torque_max is None else TorqueBounds(limits.torque_map, limits.torque_max),
    )
