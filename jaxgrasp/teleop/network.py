"""A network as the simulation has it: each message is late by a delay and a random jitter, or is lost."""

import heapq
import itertools
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float


@dataclass(frozen=True)
class NetworkModel:
    """Faults of a network, the same both ways.

    Raises:
        ValueError: for times that are negative, and a loss that is not from 0 to below 1.
    """

    delay: float = 0.0
    """One-way delay [s]."""
    jitter: float = 0.0
    """Largest random delay that is added, uniform from 0 [s]."""
    loss: float = 0.0
    """Share of messages that are lost."""

    def __post_init__(self) -> None:
        for name in ("delay", "jitter"):
            if not 0 <= getattr(self, name) < np.inf:
                raise ValueError(f"{name} is {getattr(self, name)}: expected a time, 0 or more [s]")
        if not 0 <= self.loss < 1:
            raise ValueError(f"loss is {self.loss}: expected a share from 0 to below 1")


class SimulatedLink:
    """Direction of a network in virtual time; only the newest message counts, as over a NetworkLink."""

    def __init__(self, model: NetworkModel, rng: np.random.Generator) -> None:
        """Create a link on which nothing is on its way."""
        self._model, self._rng = model, rng
        self._numbers = itertools.count()
        self._on_way: list[tuple[float, int, Float[np.ndarray, size]]] = []
        self._latest: tuple[int, Float[np.ndarray, size]] | None = None
        self.arrived_at = -np.inf
        """Time at which the newest message arrived [s]."""

    def send(self, timestamp: float, values: Float[np.ndarray, "size"]) -> None:
        """Send a message."""
        number = next(self._numbers)
        if self._model.loss and self._rng.random() < self._model.loss:
            return
        late = self._model.delay + (self._model.jitter * self._rng.random() if self._model.jitter else 0.0)
        heapq.heappush(self._on_way, (timestamp + late, number, np.array(values, float)))

    def receive(self, timestamp: float) -> Float[np.ndarray, "size"] | None:
        """Return the newest message that has arrived by now, by its number; None before the first."""
        while self._on_way and self._on_way[0][0] <= timestamp + 1e-9:
            arrival, number, values = heapq.heappop(self._on_way)
            if self._latest is None or number > self._latest[0]:
                self._latest, self.arrived_at = (number, values), arrival
        return None if self._latest is None else self._latest[1]
