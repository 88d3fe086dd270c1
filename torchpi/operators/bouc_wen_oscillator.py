"""A mode with Bouc–Wen hysteresis in its feedback, driven by a sampled force: the compiled step.

    m ÿ + c ẏ + k y + z = u
    ż = α ẏ - g |ẏ| |z|^(ν-1) z - d ẏ |z|^ν

Bouc 1967; Wen, J. Engineering Mechanics 102(2), 1976. The letters are those of Noël and Schoukens,
"Hysteretic benchmark with a dynamic nonlinearity", 2016, with g = βγ and d = βδ: only these products of β, γ
and δ enter. Properties of the model: Ikhouane and Rodellar, Systems with Hysteresis, 2007.

The classical Runge–Kutta method of order 4 integrates the equations in a number of equal steps per sample;
between samples the force is interpolated with `interpolation_taps`.
"""

from typing import Literal, NamedTuple, get_args

import numpy as np

from torchpi.operators.compiled import njit

BetweenSamples = Literal["band_limited", "linear", "held"]
BETWEEN_SAMPLES: tuple[str, ...] = get_args(BetweenSamples)
HALF_WIDTH = 16
"""Samples on either side from which a band-limited force is interpolated, accurate to 1e-5 up to 0.8 of the
Nyquist frequency."""
KAISER = 10.0
LARGEST_M, LARGEST_N = 1e3, 1e12
"""Displacement and force beyond which a solution has diverged."""


class BoucWenParameters(NamedTuple):
    """Parameters of the equations, in SI units and in the kernel's order."""

    mass_kg: float
    """m."""
    damping_n_s_m: float
    """c."""
    stiffness_n_m: float
    """k, of the elastic part."""
    hysteretic_stiffness_n_m: float
    """α, of the hysteretic part about z = 0."""
    dissipation: float
    """g = βγ, which widens the loop; N^(1-ν)/m."""
    hardening: float
    """d = βδ, which bends the loop: the slope of z rises along the loop where d < -g; N^(1-ν)/m."""
    exponent: float
    """ν."""


def half_width(between: BetweenSamples) -> int:
    """Return how many samples either side of a sampling interval needs; a step lags by one less than that."""
    return HALF_WIDTH if between == "band_limited" else 1


def interpolation_taps(between: BetweenSamples, steps: int) -> np.ndarray:
    """Weights of the samples around an interval, (2 steps + 1, 2 half widths), at equal fractions of it.

    Args:
        between: `band_limited`, a sinc in a Kaiser window; `linear`; or `held`, zero-order hold.
        steps: Integration steps per interval; the method needs the midpoint of each as well.
    """
    half = half_width(between)
    fraction = np.arange(2 * steps + 1)[:, None] / (2 * steps)
    distance = fraction - np.arange(1 - half, half + 1)  # from each sample to the point, in samples
    if between == "held":
        return np.ascontiguousarray(np.broadcast_to([1.0, 0.0], distance.shape))
    if between == "linear":
        return 1.0 - np.abs(distance)
    inside = np.sqrt(np.maximum(1.0 - (distance / half) ** 2, 0.0))
    taps = np.sinc(distance) * np.i0(KAISER * inside) / np.i0(KAISER)
    normalised: np.ndarray = taps / taps.sum(1, keepdims=True)
    return normalised


@njit
def hysteretic_slope(z: float, v: float, alpha: float, g: float, d: float, nu: float) -> float:
    """Return ż."""
    size = abs(z)
    power = size if nu == 1.0 else size**nu
    signed = power if z >= 0.0 else -power
    return alpha * v - g * abs(v) * signed - d * v * power


@njit
def bouc_wen_oscillator(
    u: np.ndarray,  # (time,), N
    taps: np.ndarray,  # (2 steps + 1, width)
    parameters: np.ndarray,  # (7,), in the order of BoucWenParameters
    step_s: float,  # integration step
    past: int,  # samples of u before these
    before: np.ndarray,  # (width,), the last of those; updated in place, like the state
    state: np.ndarray,  # (3,): y in m, ẏ in m/s, z in N
    y: np.ndarray,  # (time,), m, written: y[n] belongs to the sample width/2 - 1 before u[n]
) -> bool:
    """Fill `y`; return False if it diverges. Before its first sample the force has its first value."""
    m, c, k, alpha, g, d, nu = parameters
    width, steps = len(before), len(taps) // 2
    half, sixth = step_s / 2.0, step_s / 6.0
    x, v, z = state
    for n in range(len(u)):
        if past + n == 0:
            before[:] = u[n]
        for i in range(width - 1):
            before[i] = before[i + 1]
        before[width - 1] = u[n]
        if past + n >= width // 2:  # the interval begins at a given sample of the force
            f2 = 0.0
            for i in range(width):
                f2 += taps[0, i] * before[i]
            for s in range(steps):
                f0, f1, f2 = f2, 0.0, 0.0
                for i in range(width):
                    f1 += taps[2 * s + 1, i] * before[i]
                    f2 += taps[2 * s + 2, i] * before[i]
                a0 = (f0 - c * v - k * x - z) / m
                w0 = hysteretic_slope(z, v, alpha, g, d, nu)
                v1 = v + half * a0
                z1 = z + half * w0
                a1 = (f1 - c * v1 - k * (x + half * v) - z1) / m
                w1 = hysteretic_slope(z1, v1, alpha, g, d, nu)
                v2 = v + half * a1
                z2 = z + half * w1
                a2 = (f1 - c * v2 - k * (x + half * v1) - z2) / m
                w2 = hysteretic_slope(z2, v2, alpha, g, d, nu)
                v3 = v + step_s * a2
                z3 = z + step_s * w2
                a3 = (f2 - c * v3 - k * (x + step_s * v2) - z3) / m
                w3 = hysteretic_slope(z3, v3, alpha, g, d, nu)
                x += sixth * (v + 2.0 * v1 + 2.0 * v2 + v3)
                v += sixth * (a0 + 2.0 * a1 + 2.0 * a2 + a3)
                z += sixth * (w0 + 2.0 * w1 + 2.0 * w2 + w3)
        if not (abs(x) < LARGEST_M and abs(z) < LARGEST_N):
            return False
        y[n] = x
    state[0], state[1], state[2] = x, v, z
    return True
