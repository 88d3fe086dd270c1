"""The best linear approximation of a stage of several axes, and modes fitted to it.

Frequency response at one amplitude: Pintelon and Schoukens, System Identification, 2012, ch. 3. Its poles:
vector fitting (Gustavsen and Semlyen, IEEE Trans. Power Delivery 14(3), 1999), here in z, so that the
behaviour between samples is part of the fit.
"""

from collections.abc import Sequence

import numpy as np

ITERATIONS = 20
LEAST_DAMPING = 0.003
"""Least damping ratio of a mode; sharper ones would fit the noise of single lines."""
BROAD = ((1.0, 0.03), (0.6, 1.0), (0.005, 3.0), (0.3, 0.2), (0.5, 0.2))
"""Broad poles: frequency as a share of the highest, and damping."""
WINDOW = 4096
"""Maximum length of a window, samples."""
RIDGE = 1e-12
"""Ridge as a share of each column's square."""


def windowed(u: Sequence[np.ndarray], y: Sequence[np.ndarray]) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Cut records without periods into half-overlapping windows of one length: (samples, channels) each.

    A Hann window leaves little of the transient of a mode from before it (Pintelon and Schoukens, ch. 2).
    """
    length = min(WINDOW, 2 * (min(map(len, u)) // (u[0].shape[1] + 1)))
    shape = np.hanning(length + 1)[:length, None]
    cut = [
        [
            shape * (x[k : k + length] - x.mean(0))
            for x in record
            for k in range(0, len(x) - length + 1, length // 2)
        ]
        for record in (u, y)
    ]
    return cut[0], cut[1]


def best_linear_approximation(
    u: Sequence[np.ndarray], y: Sequence[np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """Estimate the frequency response from the realisations of one amplitude.

    Args:
        u: (samples, inputs) each, whole periods; at least as many realisations as inputs.
        y: (samples, outputs) each.

    Returns:
        z on the unit circle, (lines,), and the response, (lines, inputs, outputs), at the excited lines.
    """
    spectra = np.stack([np.fft.rfft(one, axis=0)[1:-1] for one in u], 1)  # (lines, realisations, inputs)
    answers = np.stack([np.fft.rfft(one, axis=0)[1:-1] for one in y], 1)
    power = np.square(np.abs(spectra)).sum((1, 2))
    excited = power > 1e-4 * np.median(power[power > 1e-6 * power.max()])
    spectra, answers = spectra[excited], answers[excited]
    across = spectra.conj().swapaxes(1, 2)
    response = np.linalg.solve(across @ spectra, across @ answers)
    z = np.exp(2j * np.pi * (1 + np.flatnonzero(excited)) / len(u[0]))
    return z, response


def fitted_poles(z: np.ndarray, response: np.ndarray, pairs: int) -> np.ndarray:
    """Return common poles of all channels of a response, (pairs,), complex, of positive imaginary part.

    Vector fitting finds the modes in the band. If many poles are wanted, a few broad ones are added: they
    represent modes beyond the band, amplifiers and delays, and a fit to the recordings adjusts them.
    """
    channels = response.reshape(len(z), -1)
    last = float(np.angle(z).max())
    broad = min(len(BROAD), pairs // 4)
    spread = np.linspace(last / (pairs - broad), last, pairs - broad + 2)[1:-1]
    poles = np.exp((-0.01 + 1j) * spread)
    for _ in range(ITERATIONS):
        poles = _relocated(z, channels, poles)
    return np.concatenate([poles, [np.exp(last * (-damping + 1j) * at) for at, damping in BROAD[:broad]]])


def _relocated(z: np.ndarray, channels: np.ndarray, poles: np.ndarray) -> np.ndarray:
    """One step of vector fitting: the zeros of the fitted weight function, reflected into the unit circle."""
    columns = partial_fractions(z, poles)
    both = np.concatenate([columns, np.ones((len(z), 1))], 1)
    kept, rows, right = both.shape[1], [], []
    for channel in channels.T:
        matrix = _real(np.concatenate([both, -columns * channel[:, None]], 1))
        scale = np.linalg.norm(matrix, axis=0)
        q, r = np.linalg.qr(matrix / scale)
        rows.append(r[kept:, kept:] * scale[kept:])
        right.append(q[:, kept:].T @ _real(channel[:, None])[:, 0])
    weights = np.linalg.lstsq(np.concatenate(rows), np.concatenate(right), rcond=None)[0]
    state, drive = np.zeros((len(weights), len(weights))), np.zeros(len(weights))
    for m, pole in enumerate(poles):
        state[2 * m : 2 * m + 2, 2 * m : 2 * m + 2] = [[pole.real, pole.imag], [-pole.imag, pole.real]]
        drive[2 * m] = 2.0
    zeros = np.linalg.eigvals(state - np.outer(drive, weights))
    zeros = np.where(np.abs(zeros) > 1, 1 / zeros.conj(), zeros)
    limit = np.exp(-LEAST_DAMPING * np.abs(np.angle(zeros)) - 1e-4)
    zeros *= np.minimum(1, limit / np.maximum(np.abs(zeros), 1e-9))
    pairs = zeros[zeros.imag > 1e-9]
    real = np.sort(zeros[np.abs(zeros.imag) <= 1e-9].real)
    # Two real poles also make a pair of states; they are kept slightly apart.
    twos = zip(real[::2], real[1::2], strict=True)
    joined = [complex(np.mean(two), 1e-3 + np.ptp(two) / 2) for two in twos]
    every = np.concatenate([pairs, np.array(joined, dtype=complex)])
    return every[np.argsort(np.angle(every))]


def partial_fractions(z: np.ndarray, poles: np.ndarray) -> np.ndarray:
    """Return (lines, 2 pairs): the response of each pair of poles with a residue of 1, and of j."""
    direct, mirrored = 1 / (z[:, None] - poles), 1 / (z[:, None] - poles.conj())
    return np.stack([direct + mirrored, 1j * (direct - mirrored)], 2).reshape(len(z), -1)


def modes_of(z: np.ndarray, response: np.ndarray, poles: np.ndarray) -> dict[str, np.ndarray]:
    """Return `poles`, `drive`, `seen` and `direct` of modes, each with the nearest residue of rank one."""
    lines, inputs, outputs = response.shape
    columns = np.concatenate([partial_fractions(z, poles), np.ones((lines, 1))], 1)
    matrix, right = _real(columns), _real(response.reshape(lines, -1))
    scale = np.linalg.norm(matrix, axis=0)
    unit = matrix / scale
    gram = unit.T @ unit
    gram[np.diag_indices_from(gram)] += RIDGE
    solved = (np.linalg.solve(gram, unit.T @ right) / scale[:, None]).reshape(-1, inputs, outputs)
    pairs = len(poles)
    drive, seen = np.zeros((pairs, 2, inputs)), np.zeros((outputs, pairs, 2))
    for m in range(pairs):
        left, values, across = np.linalg.svd(solved[2 * m] + 1j * solved[2 * m + 1])
        turn = np.exp(-0.5j * np.angle((left[:, 0] ** 2).sum()))
        b, c = left[:, 0] * turn, across[0] * values[0] / turn
        drive[m] = b.real, b.imag
        seen[:, m] = np.stack([2 * c.real, -2 * c.imag], 1)
    return {
        "poles": np.stack([poles.real, poles.imag], 1),
        "drive": drive,
        "seen": seen,
        "direct": solved[-1].T.copy(),
    }


def _real(matrix: np.ndarray) -> np.ndarray:
    return np.concatenate([matrix.real, matrix.imag])
