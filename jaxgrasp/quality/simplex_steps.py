"""Steps of the revised simplex method on many small programs side by side: minimise costs.x, columns x = right, x >= 0.

A program's columns are its caller's affair, and may be as many as a cone has edges: this holds its basis alone, the
inverse of its columns and how much there is of each.
"""

import numpy as np

FLAT = 1e-11
"""Rate at which a basic column gives way under which it does not."""


class SimplexBases:
    """Bases of ``L`` programs with ``m`` rows; at first of artificial columns, which are unit vectors or less them."""

    def __init__(self, right: np.ndarray, cost: float):
        """Programs of right sides ``(L, m)``, whose artificial columns have a cost."""
        signs = np.where(right < 0, -1.0, 1.0)
        self.inverse = np.eye(right.shape[1]) * signs[:, None, :]
        """``(L, m, m)``."""
        self.amounts = np.abs(right)
        """``(L, m)``: of the basic columns."""
        self.costs = np.full(right.shape, cost)
        """``(L, m)``."""
        self.columns = np.full(right.shape, -1)
        """``(L, m)``: whatever number the caller gives its columns, -1 for artificial ones."""

    def multipliers(self) -> np.ndarray:
        """``(L, m)``: a column is worth taking in where its product with these exceeds its cost."""
        return np.matmul(self.costs[:, None], self.inverse)[:, 0]

    def by_contact(self, which: np.ndarray, tangentials: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
        """What the columns of some programs ``(l,)`` come to for each contact: normal forces ``(l, n)`` and tangential
        ones ``(l, n, 3)``, where columns below ``count`` are wrenches of the contact of that number, of the
        ``tangentials`` (L, m, 3)."""
        own = self.amounts[which][..., None] * (self.columns[which][..., None] == np.arange(count))
        return own.sum(1), np.einsum("gkn,gkj->gnj", own, tangentials[which])

    def artificial(self) -> np.ndarray:
        """``(L,)``: how much of artificial columns there is."""
        return np.sum(np.where(self.columns < 0, self.amounts, 0), 1)

    def enter(self, which: np.ndarray, columns: np.ndarray, costs: np.ndarray, names: np.ndarray) -> np.ndarray:
        """Bring a column ``(l, m)`` into the bases of some programs ``(l,)``.

        Returns:
            ``(l,)``: the place in the basis that it took, -1 where nothing gives way to it.
        """
        rates = np.matmul(self.inverse[which], columns[..., None])[..., 0]
        # What is artificial and used up goes first, in whichever way it would move.
        spent = (self.columns[which] < 0) & (self.amounts[which] <= FLAT) & (np.abs(rates) > 1e-7)
        gives = (rates > FLAT) | spent
        ratios = np.where(gives, self.amounts[which] / np.where(gives, rates, 1), np.inf)
        ratios = np.where(spent, -1, ratios)
        every = np.arange(len(which))
        # Of those that give way at once the largest rate loses the fewest digits.
        tied = ratios <= ratios.min(1, keepdims=True) + FLAT
        place = np.argmax(np.where(tied, np.abs(rates), -1), 1)
        fine = np.isfinite(ratios[every, place])
        every, place, which = every[fine], place[fine], which[fine]
        row = self.inverse[which, place] / rates[every, place][:, None]
        step = self.amounts[which, place] / rates[every, place]
        self.inverse[which] -= rates[every][..., None] * row[:, None]
        self.inverse[which, place] = row
        self.amounts[which] = np.maximum(self.amounts[which] - rates[every] * step[:, None], 0)
        self.amounts[which, place] = step
        self.costs[which, place], self.columns[which, place] = costs[every], names[every]
        taken = np.full(len(fine), -1)
        taken[fine] = place
        return taken
