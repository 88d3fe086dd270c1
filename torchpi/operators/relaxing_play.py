"""The relaxing play: one element for hysteresis whose loops widen with the rate, and for creep.

Domains of a ferroelectric switch at a rate that grows as a power of the driving force (Huber and Fleck,
J. Mech. Phys. Solids 49(4), 2001; Belov and Kreher, J. Eur. Ceram. Soc. 25(12), 2005). With a linear and a
cubic term:

    ḣ = ω (e + e³/r²),   e = x - h

Between samples, with x held, this has a closed form: e⁺ = a e / √(1 + (1 - a²) (e/r)²), a = exp(-ω T). Small
deviations relax at the rate ω; those much larger than r drop at once to r a/√(1 - a²), as in a play.
"""

import numpy as np


def relaxing_play(x: float, r: float, a: float, h: float) -> float:
    """Return h(t) from x(t) and h(t - T)."""
    e = x - h
    s = e / r
    return float(x - a * e / np.sqrt(1.0 + (1.0 - a * a) * s * s))


def relaxing_play_slope(x: float, r: float, a: float, h: float) -> float:
    """Return ∂h(t)/∂h(t - T); ∂h(t)/∂x(t) is 1 minus this."""
    s = (x - h) / r
    q = 1.0 + (1.0 - a * a) * s * s
    return float(a / (q * np.sqrt(q)))
