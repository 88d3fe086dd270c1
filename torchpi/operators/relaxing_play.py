"""A play that relaxes: hysteresis whose loops widen with the rate, and creep, as one element.

Domains of a ferroelectric switch at a rate that grows as a power of what drives them (Huber and Fleck,
J. Mech. Phys. Solids 49(4), 2001; Belov and Kreher, J. Eur. Ceram. Soc. 25(12), 2005). With a linear and a
cubic term:

    ḣ = ω (e + e³/r²),   e = x - h

Between samples, with x held, this has a closed form: e⁺ = a e / √(1 + (1 - a²) (e/r)²), a = exp(-ω T). Small
motions relax at the rate ω, ones that are much larger than r at once down to r a/√(1 - a²), as a play would.
"""

import numpy as np


def relaxing_play(x: float, r: float, a: float, h: float) -> float:
    """One step: h(t) from x(t) and h(t - T)."""
    e = x - h
    s = e / r
    return float(x - a * e / np.sqrt(1.0 + (1.0 - a * a) * s * s))


def relaxing_play_slope(x: float, r: float, a: float, h: float) -> float:
    """∂h(t)/∂h(t - T); the slope for x is what is left of 1."""
    s = (x - h) / r
    q = 1.0 + (1.0 - a * a) * s * s
    return float(a / (q * np.sqrt(q)))
