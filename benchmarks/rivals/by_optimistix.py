"""optimistix's solvers on our dual, judged by our own tests: the same six unknowns, another iteration."""

from functools import partial

import optimistix

import jaxgrasp
from benchmarks.rivals.by_jaxgrasp import rival

TOLERANCE = 1e-8
KINDS = (optimistix.Newton, optimistix.Dogleg, optimistix.LevenbergMarquardt, optimistix.BFGS)

RIVALS = [
    rival(
        f"optimistix {kind.__name__} {TOLERANCE:.0e}",
        "optimistix",
        partial(jaxgrasp.constrained_optimum, solver=kind(rtol=TOLERANCE, atol=TOLERANCE)),
        TOLERANCE,
    )
    for kind in KINDS
]
