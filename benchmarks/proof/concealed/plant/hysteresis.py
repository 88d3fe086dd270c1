"""Four true hystereses. Each maps an array of voltages, from the de-energised state, to displacements.

All are rate-independent, so constant input costs nothing and a monotone stretch may be crossed in one step;
only the Bouc–Wen equation is integrated, by Runge–Kutta in the voltage.
"""

import math
from dataclasses import dataclass
from typing import Protocol

import numba
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Hysteresis(Protocol):
    """A rate-independent operator with a name."""

    family: str

    def respond(self, v: Array, envelope: float = 0.0) -> Array:
        """The displacement, µm; `envelope` bends the rising branch away from the falling one (plays only)."""
        ...


@dataclass(frozen=True)
class Plays:
    """y = a·v + Σ w_i·h_i with h the plays of (possibly) different envelopes up and down.

    h = max(v - e_up·q(v) - r_up, min(v + e_down·q(v) + r_down, h)), q a hump of height one over the range.
    """

    family: str  # "pi" or "generalised_play"
    reversible_um_per_v: float
    r_up: Array
    r_down: Array
    weights: Array
    span_v: float
    envelope_up: float = 0.0
    envelope_down: float = 0.0

    def respond(self, v: Array, envelope: float = 0.0) -> Array:
        up, down = (self.envelope_up + envelope) * self.span_v, self.envelope_down * self.span_v
        return _plays(
            v, self.reversible_um_per_v, self.r_up, self.r_down, self.weights, self.span_v, up, down
        )


@numba.njit(cache=True)
def _plays(v, reversible, r_up, r_down, w, span, up, down):
    y = np.empty(v.size)
    h = np.zeros(r_up.size)
    last, out = 0.0, 0.0
    for t in range(v.size):
        x = v[t]
        if x != last or t == 0:
            hump = max(0.0, 4 * x / span * (1 - x / span))
            rising, falling = x - up * hump, x + down * hump
            out = reversible * x
            for i in range(r_up.size):
                s = h[i]
                if s < rising - r_up[i]:
                    s = rising - r_up[i]
                elif s > falling + r_down[i]:
                    s = falling + r_down[i]
                h[i] = s
                out += w[i] * s
            last = x
        y[t] = out
    return y


@dataclass(frozen=True)
class Preisach:
    """y = a·v + ∬ μ(α, β) γ_αβ, with the integral from Everett's function of the remembered extremes.

    `everett` is tabulated on `grid` and odd about its diagonal, so that a reversal starts without a step.
    """

    family: str
    reversible_um_per_v: float
    grid: Array
    everett: Array

    def respond(self, v: Array, envelope: float = 0.0) -> Array:
        if envelope:
            raise ValueError("a Preisach truth has no envelopes")
        step = self.grid[1] - self.grid[0]
        hysteretic = _preisach(v, self.everett, self.grid[0], step, 0.98 * self.grid[-1])
        return self.reversible_um_per_v * v + hysteretic


@numba.njit(cache=True)
def _everett(table, low, step, alpha, beta):
    a, b = (alpha - low) / step, (beta - low) / step
    n = table.shape[0] - 2
    i, j = min(max(int(a), 0), n), min(max(int(b), 0), n)
    a, b = a - i, b - j
    return (
        table[i, j] * (1 - a) * (1 - b)
        + table[i + 1, j] * a * (1 - b)
        + table[i, j + 1] * (1 - a) * b
        + table[i + 1, j + 1] * a * b
    )


@numba.njit(cache=True)
def _preisach(v, table, low, step, strongest):
    levels = 400  # of the alternating field that erased the memory of the ceramic
    high, deep, sums = np.empty(levels + v.size), np.empty(levels + v.size), np.empty(levels + v.size)
    n = 0
    for k in range(levels):
        top = strongest * (1 - k / levels)
        bottom = -strongest * (1 - (k + 0.5) / levels)
        before, floor = (sums[n - 1], deep[n - 1]) if n else (0.0, low)
        high[n], deep[n] = top, bottom
        sums[n] = before + _everett(table, low, step, top, floor) - _everett(table, low, step, top, bottom)
        n += 1
    rest = sums[n - 1]
    y = np.empty(v.size)
    rising, peak, last, out = True, 0.0, 0.0, 0.0
    for t in range(v.size):
        x = v[t]
        if x > last:
            if not rising:
                before, floor = (sums[n - 1], deep[n - 1]) if n else (0.0, low)
                high[n], deep[n] = peak, last
                sums[n] = (
                    before + _everett(table, low, step, peak, floor) - _everett(table, low, step, peak, last)
                )
                n += 1
                rising = True
            while n > 0 and x >= high[n - 1]:
                n -= 1
            before, floor = (sums[n - 1], deep[n - 1]) if n else (0.0, low)
            out = before + _everett(table, low, step, x, floor) - rest
        elif x < last:
            if rising:
                peak, rising = last, False
            while n > 0 and x <= deep[n - 1]:
                peak = high[n - 1]
                n -= 1
            before, floor = (sums[n - 1], deep[n - 1]) if n else (0.0, low)
            out = (
                before + _everett(table, low, step, peak, floor) - _everett(table, low, step, peak, x) - rest
            )
        last = x
        y[t] = out
    return y


@dataclass(frozen=True)
class BoucWen:
    """y = d·v - z, dz = α·dv - β·z·|dv| - γ·|z|·dv (Low and Guo, 1995), z in µm."""

    family: str
    d: float
    alpha: float
    beta: float
    gamma: float
    step_v: float

    def respond(self, v: Array, envelope: float = 0.0) -> Array:
        if envelope:
            raise ValueError("a Bouc–Wen truth has no envelopes")
        return self.d * v - _bouc_wen(v, self.alpha, self.beta, self.gamma, self.step_v)


@numba.njit(cache=True)
def _bouc_wen_slope(z, sign, alpha, beta, gamma):
    return alpha - beta * z * sign - gamma * abs(z)


@numba.njit(cache=True)
def _bouc_wen(v, alpha, beta, gamma, step):
    out = np.empty(v.size)
    z, last = 0.0, 0.0
    for t in range(v.size):
        move = v[t] - last
        if move != 0.0:
            count = math.ceil(abs(move) / step)
            h = move / count
            sign = 1.0 if move > 0 else -1.0
            for _ in range(count):
                k1 = _bouc_wen_slope(z, sign, alpha, beta, gamma)
                k2 = _bouc_wen_slope(z + 0.5 * h * k1, sign, alpha, beta, gamma)
                k3 = _bouc_wen_slope(z + 0.5 * h * k2, sign, alpha, beta, gamma)
                k4 = _bouc_wen_slope(z + h * k3, sign, alpha, beta, gamma)
                z += h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
            last = v[t]
        out[t] = z
    return out


def draw_hysteresis(family: str, rng: np.random.Generator, span_v: float, range_um: float) -> Hysteresis:
    """Draw a hysteresis of this family with a loop of 7–14 % at full swing and `range_um` at `span_v`."""
    width = rng.uniform(0.07, 0.14)
    return {
        "pi": _draw_pi,
        "generalised_play": _draw_generalised,
        "preisach": _draw_preisach,
        "bouc_wen": _draw_bouc_wen,
    }[family](rng, span_v, range_um, width)


def _swing(span_v: float) -> Array:
    leg = np.linspace(0, span_v, 200)
    return np.concatenate([leg, leg[::-1], leg, leg[::-1]])


def _loop(y: Array) -> tuple[float, float]:
    """Width of the settled loop and its range, both in the unit of y, from the response to `_swing`."""
    return float(np.max(y[600:][::-1] - y[400:600])), float(np.ptp(y[400:]))


def _proportions(y: Array, span_v: float, range_um: float, width: float) -> tuple[float, float]:
    """Slope and scale that give a·v + s·y the wanted loop."""
    opening, reach = _loop(y)
    slope = max((opening / width - reach) / span_v, 0.05 * reach / span_v)
    scale = range_um / (slope * span_v + reach)
    return slope * scale, scale


def _thresholds(rng: np.random.Generator, span_v: float) -> Array:
    count = int(rng.integers(60, 201))
    law = rng.choice(["exponential", "uniform", "gamma"])
    if law == "exponential":
        r = rng.exponential(rng.uniform(0.08, 0.25), count)
    elif law == "uniform":
        r = rng.uniform(0, rng.uniform(0.4, 0.7), count)
    else:
        r = rng.gamma(2.0, rng.uniform(0.05, 0.12), count)
    return np.sort(r[r < 0.95]) * span_v


def _draw_plays(rng, span_v, range_um, width, family, share_down, up, down):
    r = _thresholds(rng, span_v)
    r_down = r * share_down(r.size)
    shape = Plays(family, 0.0, r, r_down, rng.uniform(0.2, 1.8, r.size), span_v, up, down)
    slope, scale = _proportions(shape.respond(_swing(span_v)), span_v, range_um, width)
    return Plays(family, slope, r, r_down, shape.weights * scale, span_v, up, down)


def _draw_pi(rng: np.random.Generator, span_v: float, range_um: float, width: float) -> Plays:
    return _draw_plays(rng, span_v, range_um, width, "pi", np.ones, 0.0, 0.0)


def _draw_generalised(rng: np.random.Generator, span_v: float, range_um: float, width: float) -> Plays:
    up, down = rng.uniform(0.0, 0.06, 2)
    return _draw_plays(
        rng, span_v, range_um, width, "generalised_play", lambda n: rng.uniform(0.5, 1.5, n), up, down
    )


def _draw_preisach(rng: np.random.Generator, span_v: float, range_um: float, width: float) -> Preisach:
    grid = np.linspace(-1.3, 1.3, 261)
    alpha, beta = np.meshgrid(grid, grid, indexing="ij")
    half, centre = (alpha - beta) / 2, (alpha + beta) / 2
    middle, spread = rng.uniform(0.1, 0.6), rng.uniform(0.25, 0.6)
    coercive, broad = rng.uniform(0.0, 0.25), rng.uniform(0.12, 0.3)
    tilt = rng.uniform(-0.3, 0.3)
    a, b = (centre - middle) / spread, (half - coercive + tilt * centre * 0.2) / broad
    density = np.exp(-0.5 * (a * a + b * b)) if rng.random() < 0.5 else 1 / ((1 + a * a) * (1 + b * b))
    density = np.where(half >= 0, density, 0.0)
    # E(α, β): the relays switched between β and α, by sums over the rows above β and the columns below α.
    below = np.cumsum(density, axis=0)
    above = np.cumsum(below[:, ::-1], axis=1)[:, ::-1]
    everett = np.where(half > 0, above, 0.0)
    everett = everett - everett.T
    shape = Preisach("preisach", 0.0, grid * span_v, everett)
    slope, scale = _proportions(shape.respond(_swing(span_v)), span_v, range_um, width)
    return Preisach("preisach", slope, grid * span_v, everett * scale)


def _draw_bouc_wen(rng: np.random.Generator, span_v: float, range_um: float, width: float) -> BoucWen:
    beta = rng.uniform(2.0, 8.0) / span_v
    gamma = rng.uniform(-0.4, 0.2) * beta
    # With α in units of d, the loop of d·v - α·ζ(v) opens in proportion to α.
    zeta = _bouc_wen(_swing(span_v), 1.0, beta, gamma, span_v / 500)
    low, high = 0.0, 5.0
    for _ in range(40):
        alpha = 0.5 * (low + high)
        opening, reach = _loop(_swing(span_v) - alpha * zeta)
        low, high = (alpha, high) if opening < width * reach else (low, alpha)
    scale = range_um / reach
    return BoucWen("bouc_wen", scale, alpha * scale, beta, gamma, span_v / 500)
