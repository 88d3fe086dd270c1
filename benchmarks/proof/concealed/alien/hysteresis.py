"""Seven truths besides plays, each rate-independent, from the de-energised state; all in literature.

Preisach with a log-normal density of coercivities (Füzi, 1999) and with a random continuum; Bouc–Wen with its
exponent (Wen, 1976); Duhem's in the form of Coleman and Hodgdon (1986); domain walls after Jiles and Atherton
(1986; for ceramics Smith and Ounaies, 2000); Krasnosel'skii–Pokrovskii kernels (Banks, Kurdila and Webb,
1997); generalised plays with tanh envelopes (Al Janaideh, Rakheja and Su, 2009).
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numba
import numpy as np
from concealed.plant.hysteresis import Preisach, _proportions, _swing, draw_hysteresis
from concealed.plant.physics import Array
from scipy.ndimage import gaussian_filter

FAMILIES = (
    "pi", "preisach", "random_continuum", "bouc_wen", "duhem", "jiles_atherton", "krasnoselskii_pokrovskii",
    "generalised_play",
)  # fmt: skip
STEP = 1 / 400  # of the span, of the integrations over voltage


@dataclass(frozen=True)
class Truth:
    """slope · v + scale · shape(v), of a family."""

    family: str
    slope: float  # µm/V
    scale: float
    shape: Callable[[Array], Array]

    def respond(self, v: Array) -> Array:
        """The displacement, µm, of a voltage from the de-energised state."""
        return self.slope * v + self.scale * self.shape(v)


def draw_truth(family: str, rng: np.random.Generator, span_v: float, range_um: float) -> Truth:
    """A loop of 6–18 % at full swing, `range_um` at `span_v`."""
    if family == "pi":
        return Truth(family, 0.0, 1.0, draw_hysteresis("pi", rng, span_v, range_um).respond)
    shape = _SHAPES[family](rng, span_v)
    return Truth(
        family, *_proportions(shape(_swing(span_v)), span_v, range_um, rng.uniform(0.06, 0.18)), shape
    )


def _preisach(rng: np.random.Generator, span_v: float) -> Callable[[Array], Array]:
    half, centre = _plane()
    coercive, spread = rng.uniform(0.1, 0.3), rng.uniform(0.5, 0.9)
    middle, broad = rng.uniform(-0.1, 0.5), rng.uniform(0.3, 0.7)
    log = np.log(np.maximum(half, 1e-3) / coercive) / spread
    return _relays(
        np.exp(-0.5 * (log**2 + ((centre - middle) / broad) ** 2)) / np.maximum(half, 0.02), span_v
    )


def _random_continuum(rng: np.random.Generator, span_v: float) -> Callable[[Array], Array]:
    half, _ = _plane()
    bumps = gaussian_filter(rng.standard_normal(half.shape), rng.uniform(6, 20))
    density = np.exp(rng.uniform(0.5, 1.2) * bumps / bumps.std() - half / rng.uniform(0.15, 0.4))
    return _relays(density, span_v)


def _plane() -> tuple[Array, Array]:
    grid = np.linspace(-1.3, 1.3, 261)
    alpha, beta = np.meshgrid(grid, grid, indexing="ij")
    return (alpha - beta) / 2, (alpha + beta) / 2


def _relays(density: Array, span_v: float) -> Callable[[Array], Array]:
    grid = np.linspace(-1.3, 1.3, 261)
    density = np.where(np.subtract.outer(grid, grid) >= 0, density, 0.0)
    density /= density.sum()
    above = np.cumsum(np.cumsum(density, axis=0)[:, ::-1], axis=1)[:, ::-1]
    everett = np.where(np.subtract.outer(grid, grid) > 0, above, 0.0)
    return Preisach("preisach", 0.0, grid * span_v, everett - everett.T).respond


def _bouc_wen(rng: np.random.Generator, span_v: float) -> Callable[[Array], Array]:
    beta, n = rng.uniform(1.0, 4.0), rng.uniform(1.0, 2.5)
    gamma = rng.uniform(-0.5, 0.5) * beta
    # The restoring force lags the displacement: the displacement is what is left of the voltage.
    lag, mix = lambda v: _wen(v / span_v, beta, gamma, n), rng.uniform(0.2, 0.6)
    return lambda v: v / span_v - mix * lag(v)


@numba.njit(cache=True)
def _wen(v, beta, gamma, n):
    z, last, out = 0.0, 0.0, np.empty(v.size)
    for t in range(v.size):
        move = v[t] - last
        if move != 0.0:
            count = math.ceil(abs(move) / STEP)
            h, sign = move / count, 1.0 if move > 0 else -1.0
            for _ in range(count):  # Heun
                a = abs(z) ** n
                k = 1 - a * (beta * sign * (1.0 if z > 0 else -1.0) + gamma)
                p = z + h * k
                a = abs(p) ** n
                z += 0.5 * h * (k + 1 - a * (beta * sign * (1.0 if p > 0 else -1.0) + gamma))
            last = v[t]
        out[t] = z
    return out


def _duhem(rng: np.random.Generator, span_v: float) -> Callable[[Array], Array]:
    alpha, stiff, bend = rng.uniform(1.0, 4.0), rng.uniform(0.2, 0.7), rng.uniform(0.5, 1.5)
    return lambda v: _coleman_hodgdon(v / span_v, alpha, stiff, bend)


@numba.njit(cache=True)
def _coleman_hodgdon(v, alpha, stiff, bend):
    """dx = α |dv| [f(v) - x] + g dv, f = tanh(b v)/b, g = its share `stiff`."""
    x, last, out = 0.0, 0.0, np.empty(v.size)
    for t in range(v.size):
        move = v[t] - last
        if move != 0.0:
            count = math.ceil(abs(move) / STEP)
            h = move / count
            for i in range(count):
                here = last + (i + 0.5) * h
                slope = stiff * (1 - math.tanh(bend * here) ** 2)
                x += abs(h) * alpha * (math.tanh(bend * here) / bend - x) + slope * h
            last = v[t]
        out[t] = x
    return out


def _jiles_atherton(rng: np.random.Generator, span_v: float) -> Callable[[Array], Array]:
    a, k = rng.uniform(0.4, 1.2), rng.uniform(0.08, 0.3)
    coupling, reversible = rng.uniform(0.0, 0.1), rng.uniform(0.1, 0.4)
    return lambda v: _domain_walls(v / span_v, a, k, coupling, reversible)


@numba.njit(cache=True)
def _domain_walls(v, a, k, coupling, reversible):
    irreversible, last, out = 0.0, 0.0, np.empty(v.size)
    total = 0.0
    for t in range(v.size):
        move = v[t] - last
        if move != 0.0:
            count = math.ceil(abs(move) / STEP)
            h, sign = move / count, 1.0 if move > 0 else -1.0
            for i in range(count):
                field = (last + (i + 0.5) * h + coupling * total) / a
                free = 1 / math.tanh(field) - 1 / field if abs(field) > 1e-3 else field / 3
                ahead = free - irreversible
                if ahead * sign > 0:  # walls move only towards the anhysteretic curve
                    irreversible += h * ahead / (sign * k - coupling * ahead)
                total = reversible * free + (1 - reversible) * irreversible
            last = v[t]
        out[t] = total
    return out


def _kernels(rng: np.random.Generator, span_v: float) -> Callable[[Array], Array]:
    count = int(rng.integers(80, 200))
    centre, half = rng.uniform(-0.9, 0.9, count), rng.gamma(2.0, rng.uniform(0.06, 0.15), count)
    weights, width = rng.uniform(0.2, 1.8, count) / count, rng.uniform(0.2, 0.8)
    return lambda v: _ridges(v / span_v, centre + half, centre - half, weights, width)


@numba.njit(cache=True)
def _ridges(v, up, down, weights, width):
    """Σ w h, h = max{r(v - up), min{r(v - down), h}}, r a ramp from -1 to 1 of this width."""
    h, out, last, total = np.zeros(up.size), np.empty(v.size), math.nan, 0.0
    rest = 0.0
    for i in range(up.size):  # de-energised: in the middle of what zero volts allow
        low, high = min(max(-up[i] / width, -1.0), 1.0), min(max(-down[i] / width, -1.0), 1.0)
        h[i] = 0.5 * (low + high)
        rest += weights[i] * h[i]
    for t in range(v.size):
        if v[t] != last:
            total = 0.0
            for i in range(h.size):
                low = min(max((v[t] - up[i]) / width, -1.0), 1.0)
                high = min(max((v[t] - down[i]) / width, -1.0), 1.0)
                h[i] = max(low, min(high, h[i]))
                total += weights[i] * h[i]
            last = v[t]
        out[t] = total - rest
    return out


def _generalised(rng: np.random.Generator, span_v: float) -> Callable[[Array], Array]:
    count = int(rng.integers(40, 120))
    r = np.sort(rng.exponential(rng.uniform(0.1, 0.3), count))
    weights = rng.uniform(0.2, 1.8, count) / count
    up, down = rng.uniform(0.6, 1.4, 2)
    shift = rng.uniform(-0.1, 0.1)
    return lambda v: envelopes(v / span_v, r, weights, up, down, shift)


@numba.njit(cache=True)
def envelopes(v, r, weights, up, down, shift):
    """Σ w h of plays between two envelopes, tanh of another slope each, moved apart by `shift`."""
    h, out, last, total = np.zeros(r.size), np.empty(v.size), 0.0, 0.0
    for t in range(v.size):
        if v[t] != last:
            rising = (math.tanh(up * v[t] + shift) - math.tanh(shift)) / up
            falling = (math.tanh(down * v[t] - shift) + math.tanh(shift)) / down
            total = 0.0
            for i in range(r.size):
                h[i] = max(rising - r[i], min(falling + r[i], h[i]))
                total += weights[i] * h[i]
            last = v[t]
        out[t] = total
    return out


_SHAPES: dict[str, Callable[[np.random.Generator, float], Callable[[Array], Array]]] = {
    "preisach": _preisach,
    "random_continuum": _random_continuum,
    "bouc_wen": _bouc_wen,
    "duhem": _duhem,
    "jiles_atherton": _jiles_atherton,
    "krasnoselskii_pokrovskii": _kernels,
    "generalised_play": _generalised,
}
