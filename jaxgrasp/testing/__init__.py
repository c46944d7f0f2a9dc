"""Test problems of every family, and reference solutions that share no code with the solver.

For tests and benchmarks, this package's own and those of other solvers: ``problems.problems(kind, n, count, seed)``,
``limited_problems``, and judges in ``references`` and ``limited_reference``. NumPy, but for ``limited_problems``, which
hands out Grasps; the kinds ``limit_...`` and solved references need Clarabel (extra ``test``).

For people who write cone solvers: ``suite``, a fixed collection of hard problems with references in extended precision.
"""
