"""White noise whose numbers are the same whether drawn in one piece or one by one."""

import numpy as np
import torch
from torch import Tensor


def white_noise(seed: int, batch: int, time: int) -> Tensor:
    """Return standard normal numbers, (batch, time), float64; each row has its own sequence for any batch."""
    return torch.from_numpy(np.stack([_generator(seed, row).standard_normal(time) for row in range(batch)]))


class NoiseStream:
    """Row 0 of `white_noise`, one number at a time.

    Args:
        seed: Chooses the sequence.
    """

    def __init__(self, seed: int) -> None:
        self.reset(seed)

    def reset(self, seed: int) -> None:
        """Start the sequence of this seed."""
        self.generator = _generator(seed, 0)
        self.ahead: list[float] = []

    def step(self) -> float:
        """Return the next number."""
        if not self.ahead:
            # One call per number would cost more than the number; numpy's sequence is the same either way.
            self.ahead = self.generator.standard_normal(1024)[::-1].tolist()
        return self.ahead.pop()


def _generator(seed: int, row: int) -> np.random.Generator:
    return np.random.default_rng([seed, row])
