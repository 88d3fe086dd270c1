"""Columns Φ of the parameters β that the voltage is linear in, and d(Φβ)/dα for the other parameters α.

u = Σ_i (Σ_m θ_im φ_m(ẏ) + Σ_q ψ_iq z_i^q) h_i + u_0,   z_i = h_i / range,   β = (θ, ψ, u_0)
"""

import numpy as np

from torchpi.control.direct_inverse import DirectInverse
from torchpi.identification.inverse_rows import Block, Nonlinear, over_rows, through_plays
from torchpi.operators.rate_weights import squash


class RateFunctions:
    """Rate functions φ and their intermediate values at each row: all (functions, rows).

    Args:
        yd_dot: µm/s, (rows,).
        part: Nonlinear parameters, with the slopes and shifts of the neural head.
        scale_um_s: ẏ_scale.
        functions: Number of functions; those beyond 1 and ẏ are the head's.
    """

    def __init__(self, yd_dot: np.ndarray, part: Nonlinear, scale_um_s: float, functions: int) -> None:
        self.z = yd_dot / scale_um_s
        self.phi = np.ones((functions, len(yd_dot)))
        self.phi[1:2] = self.z
        steps = np.multiply.outer(part.slope[: max(functions - 2, 0)], self.z)
        steps += part.shift[: len(steps), None]
        self.phi[2:] = squash(steps)
        self.of_shift = 1.0 / (1.0 + np.abs(steps)) ** 2  # dφ_{2+j}/d(shift_j)


class InverseColumns:
    """Columns of a compensator, in the order of `projection.linear_columns`.

    Args:
        compensator: The compensator.
        functions: Number of rate functions that the weights have: the first few, or all.
        own_degree: Number of columns of each play's own output function beyond the weighted sum.
    """

    def __init__(self, compensator: DirectInverse, functions: int, own_degree: int) -> None:
        self.plays, self.functions, self.own_degree = len(compensator.plays.r), functions, own_degree
        self.has_offset = bool(compensator.offset.requires_grad)
        self.range_um = float(compensator.range_um)
        self.of_rate = self.plays * functions
        self.of_plays = self.of_rate + self.plays * own_degree
        self.count = self.of_plays + self.has_offset

    def weights(self, beta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return θ, (plays, functions), and ψ, (plays, own degree)."""
        theta, psi = beta[: self.of_rate], beta[self.of_rate : self.of_plays]
        return theta.reshape(self.plays, self.functions), psi.reshape(self.plays, self.own_degree)

    def fill(self, rows: np.ndarray, h: np.ndarray, phi: np.ndarray) -> None:
        """Write Φ into the first columns of `rows`."""
        for m in range(self.functions):
            np.multiply(h, phi[m, :, None], out=rows[:, self._of_function(m)])
        own = h
        for q in range(self.own_degree):
            own = own * (h / self.range_um)
            rows[:, self._of_power(q)] = own
        if self.has_offset:
            rows[:, self.of_plays] = 1.0

    def derivative(
        self,
        block: Block,
        rate: RateFunctions,
        beta: np.ndarray,
        searched: np.ndarray,  # indices into α
    ) -> np.ndarray:  # (rows, searched)
        """Return d(Φβ)/dα with β held fixed."""
        theta, psi = self.weights(beta)
        slopes = rate.phi.T @ theta.T
        for q in range(self.own_degree):
            slopes += (q + 2) * (block.h / self.range_um) ** (q + 1) * psi[:, q]
        through_s: np.ndarray = through_plays(slopes, block.pushed, block.ds)
        if (searched < through_s.shape[1]).all():
            return through_s[:, searched]
        of_shift = (block.h @ theta[:, 2:]) * rate.of_shift.T
        every = [through_s, slopes * block.edge, of_shift * rate.z[:, None], of_shift]
        return np.concatenate(every, 1)[:, searched]

    def size_slopes(self, block: Block, rate: RateFunctions, numbers: int) -> np.ndarray:
        """Return Φ_jᵀ ∂Φ_j/∂α_k over the rows of the block: (columns, numbers of α)."""
        slopes = np.zeros((self.count, numbers))
        weights = [(self._of_function(m), phi[:, None] ** 2 * block.h) for m, phi in enumerate(rate.phi)]
        for q in range(self.own_degree):
            own = (q + 2) * (block.h / self.range_um) ** (2 * q + 2) * block.h
            weights.append((self._of_power(q), own))
        to_r = block.ds.shape[1]
        to_slope, to_shift = to_r + self.plays, to_r + self.plays + len(rate.of_shift)
        for columns, weight in weights:
            of_plays = slopes[columns]
            of_plays[:, :to_r] = over_rows(weight, block.pushed, block.ds)
            of_plays[:, to_r:to_slope][np.diag_indices(self.plays)] = np.sum(weight * block.edge, 0)
        for j, of_shift in enumerate(rate.of_shift * rate.phi[2:]):
            slopes[self._of_function(2 + j), to_slope + j] = (of_shift * rate.z) @ block.h**2
            slopes[self._of_function(2 + j), to_shift + j] = of_shift @ block.h**2
        return slopes

    def _of_function(self, m: int) -> slice:
        """Return the slice of the columns φ_m h_i of all plays."""
        return slice(m, self.of_rate, self.functions)

    def _of_power(self, q: int) -> slice:
        """Return the slice of the columns z_i^(q+1) h_i of all plays."""
        return slice(self.of_rate + q, self.of_plays, self.own_degree)
