"""Problems of every kind, and references to judge answers by that share nothing with the solver.

For tests and benchmarks, this package's own and those of other solvers. NumPy alone; the kinds ``limit_...`` and the
references of limited hands need Clarabel (extra ``test``).
"""
