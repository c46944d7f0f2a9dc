"""Evaluation of many grasps: grasp files, streams, solvers on blocks, results and their summaries."""

from typing import TYPE_CHECKING as _TYPE_CHECKING

if _TYPE_CHECKING:
    from jaxgrasp.batch.batch_evaluator import BatchEvaluator

__all__ = ["BatchEvaluator"]


def __getattr__(name: str):
    # Loads on first use: whoever only reads files needs no solver.
    if name != "BatchEvaluator":
        raise AttributeError(f"module 'jaxgrasp.batch' has no attribute {name!r}")
    from jaxgrasp.batch.batch_evaluator import BatchEvaluator

    return BatchEvaluator


def __dir__() -> list[str]:
    return __all__
