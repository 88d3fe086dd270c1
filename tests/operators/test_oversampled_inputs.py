"""Plays and amplifiers, computed between the samples."""

import numpy as np

from torchpi.operators.oversampled_inputs import HALF_LENGTH, LOOKAHEAD, OversampledInputs
from torchpi.operators.relaxing_play import relaxing_play


def excess(u: np.ndarray, rate_hz: float, *arguments: object) -> np.ndarray:
    """Return the contributions to a whole signal, (time, inputs, …)."""
    stream = OversampledInputs(u.shape[1], rate_hz, *arguments)
    return stream.advance(np.pad(u, ((0, LOOKAHEAD), (0, 0))))[LOOKAHEAD:]


def play_excess(u: np.ndarray, r: np.ndarray, rates_hz: np.ndarray, rate_hz: float) -> np.ndarray:
    return excess(u, rate_hz, r, rates_hz)


def crossover(u: np.ndarray, widths: np.ndarray, corner_hz: float, rate_hz: float) -> np.ndarray:
    return excess(u, rate_hz, (), (), widths, corner_hz)


def test_windows_give_the_same_bits_as_one_pass() -> None:
    u = np.random.default_rng(0).standard_normal((500, 2))
    arguments = (2, 1000.0, [0.2, 0.7], [3.0, 20.0], [100.0], 200.0)
    whole, parts = OversampledInputs(*arguments).advance(u), OversampledInputs(*arguments)
    found = [parts.advance(part) for part in np.split(u, [1, 2, 9, 300])]
    np.testing.assert_array_equal(np.concatenate(found), whole)


def plays(u: np.ndarray, r: float, rate_hz: float, fs_hz: float) -> np.ndarray:
    """Return the play of the samples alone, without interpolation."""
    h, kept = [0.0], np.exp(-2 * np.pi * rate_hz / fs_hz)
    for x in u:
        h.append(relaxing_play(x, r, kept, h[-1]))
    return np.array(h[1:])


R, RATES_HZ = np.array([0.2, 0.7]), np.array([3.0, 20.0])


def test_for_a_slow_signal_they_equal_the_plays_of_its_samples() -> None:
    t = np.arange(2000) / 2000
    u = np.stack([np.sin(2 * np.pi * 2 * t), 0.5 * np.sin(2 * np.pi * 3 * t)], 1)
    h = np.array([[plays(x, r, hz, 2000.0) for r, hz in zip(R, RATES_HZ, strict=True)] for x in u.T])
    inner = slice(2 * HALF_LENGTH, -2 * HALF_LENGTH)
    found = play_excess(u, R, RATES_HZ, 2000.0)
    np.testing.assert_allclose(found[inner], (np.moveaxis(h, 2, 0) - u[..., None])[inner], atol=5e-3)


def test_plays_follow_reversals_between_samples() -> None:
    # With five samples in two periods, the samples alone reach a different height in each period.
    r, rate_hz, found = np.array([0.3]), np.array([50.0]), []
    for finer in (1, 8):
        t = np.arange(1000 * finer) / finer
        excess = play_excess(np.sin(0.8 * np.pi * t)[:, None], r, rate_hz, 1000.0 * finer)[:, 0, 0]
        inner = slice(300 * finer, 700 * finer)
        found.append(np.mean(excess[inner] * np.exp(-0.8j * np.pi * t[inner])))
    u = np.sin(0.8 * np.pi * np.arange(1000))
    left = (plays(u, 0.3, 50.0, 1000.0) - u)[300:700]
    of_samples = np.mean(left * np.exp(-0.8j * np.pi * np.arange(300, 700)))
    assert abs(found[0] - found[1]) < 0.4 * abs(of_samples - found[1])


def test_without_thresholds_the_output_is_empty() -> None:
    assert play_excess(np.ones((10, 2)), np.zeros(0), np.zeros(0), 1000.0).shape == (10, 2, 0)


RATE_HZ, CORNER_HZ, HZ = 1000.0, 200.0, 40.0


def fundamental(width: float) -> complex:
    """Return the fundamental of the odd part, for a sine of 1 V."""
    t = np.arange(2000) / RATE_HZ
    e = crossover(np.sin(2 * np.pi * HZ * t)[:, None], np.array([width]), CORNER_HZ, RATE_HZ)[1000:1800, 0, 0]
    return complex(2 * np.mean(e * np.exp(-2j * np.pi * HZ * t[1000:1800])))


def test_far_below_its_width_crossover_distortion_is_linear() -> None:
    s, omega, width = 2j * np.pi * HZ, 2 * np.pi * CORNER_HZ, 1e6
    expected = -1j * omega * s / (s + omega) * s / (s + omega) / width
    assert abs(fundamental(width) - expected) < 0.02 * abs(expected)


def test_far_above_its_width_crossover_distortion_is_the_sign_of_the_current() -> None:
    s, omega = 2j * np.pi * HZ, 2 * np.pi * CORNER_HZ
    lagging = -1j * s / (s + omega)  # phasor of the slope, whose sign it follows
    expected = 4 / np.pi * lagging / abs(lagging) * s / (s + omega)
    assert abs(fundamental(1e-3) - expected) < 0.03 * abs(expected)


def test_negating_the_voltage_negates_the_odd_part_and_keeps_the_even_part() -> None:
    u = np.random.default_rng(0).standard_normal((400, 1)).cumsum(0)
    e = crossover(u, np.array([100.0]), CORNER_HZ, RATE_HZ)
    turned = crossover(-u, np.array([100.0]), CORNER_HZ, RATE_HZ)
    np.testing.assert_allclose(turned, e * [-1, 1], atol=1e-12)
