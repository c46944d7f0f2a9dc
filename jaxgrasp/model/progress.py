"""How whoever waits for a long batch is told how far it has come."""

from collections.abc import Callable

Progress = Callable[[int], object]
"""Is told how many more problems are done, as ``tqdm.update`` is; what it raises ends the work."""
