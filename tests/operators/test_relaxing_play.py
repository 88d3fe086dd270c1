"""The relaxing play."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from torchpi.operators.relaxing_play import relaxing_play, relaxing_play_slope

R, OMEGA = 0.3, 2 * np.pi * 5.0


def test_between_samples_it_follows_its_differential_equation() -> None:
    # dh/dt = ω (e + e³/r²) with x held: integrated numerically, and by the closed form in one step.
    def rate(t: float, h: np.ndarray) -> np.ndarray:
        e = 1.0 - h
        return OMEGA * (e + e**3 / R**2)

    step = 0.01
    exact = solve_ivp(rate, (0, step), [-0.4], rtol=1e-10, atol=1e-12).y[0, -1]
    assert relaxing_play(1.0, R, np.exp(-OMEGA * step), -0.4) == pytest.approx(exact, rel=1e-7)


def test_its_slope_matches_finite_differences() -> None:
    a = np.exp(-0.1)
    above, below = relaxing_play(0.5, R, a, 0.1 + 1e-6), relaxing_play(0.5, R, a, 0.1 - 1e-6)
    assert relaxing_play_slope(0.5, R, a, 0.1) == pytest.approx((above - below) / 2e-6, rel=1e-6)


def test_small_motions_lag_as_a_first_order_low_pass_and_large_ones_far_less() -> None:
    def lag(amplitude: float, hz: float) -> float:
        """Return the lag of the fundamental behind the input, rad."""
        t = np.arange(4000) / 1000
        h, a = [0.0], np.exp(-OMEGA / 1000)
        for x in amplitude * np.sin(2 * np.pi * hz * t):
            h.append(relaxing_play(x, R, a, h[-1]))
        return float(-np.angle(1j * np.mean(h[2001:] * np.exp(-2j * np.pi * hz * t[2000:]))))

    assert lag(1e-6, 2.0) == pytest.approx(np.arctan(2.0 / 5.0), rel=0.02)
    assert lag(1e-6, 2.0) < lag(1e-6, 8.0)
    assert lag(10.0, 2.0) < 0.2 * lag(1e-6, 2.0)
