"""The differentiator against analytical derivatives: exact in its band, zero phase, no gain above it."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from torchpi.errors import ConfigError, RecordingError
from torchpi.recordings.differentiation import motion_bandwidth, zero_phase_motion

FS_HZ = 10_000.0


def lines(t, frequency, amplitude, phase):
    """Return a multisine and its first two derivatives from their formulas."""
    angle = 2 * np.pi * np.multiply.outer(frequency, t) + np.asarray(phase)[:, None]
    rate = 2 * np.pi * np.asarray(frequency)
    return (
        amplitude @ np.sin(angle),
        (amplitude * rate) @ np.cos(angle),
        -(amplitude * rate**2) @ np.sin(angle),
    )


def relative_error(found, true):
    return np.abs(found - true) / np.ptp(true)


class TestExactness:
    @given(
        frequency=st.lists(st.floats(1, 80), min_size=1, max_size=5),
        phase=st.floats(0, 2 * np.pi),
        offset=st.floats(-1e3, 1e3),
        slope=st.floats(-100, 100),
    )
    def test_derivatives_of_a_multisine_are_exact_in_the_band(self, frequency, phase, offset, slope):
        t = np.arange(6_000) / FS_HZ
        amplitude = np.ones(len(frequency))
        y, y_dot, y_ddot = lines(t, frequency, amplitude, phase + np.arange(len(frequency)))
        smooth, dot, ddot = zero_phase_motion(y + offset + slope * t, FS_HZ, 200)
        inner = slice(300, -300)  # three periods of the bandwidth from the ends
        size = np.sqrt(amplitude @ amplitude) * np.array([1, 2 * np.pi * 80, (2 * np.pi * 80) ** 2])
        np.testing.assert_allclose((smooth - offset - slope * t)[inner], y[inner], atol=1e-3 * size[0])
        np.testing.assert_allclose((dot - slope)[inner], y_dot[inner], atol=1e-3 * size[1])
        np.testing.assert_allclose(ddot[inner], y_ddot[inner], atol=5e-3 * size[2])

    @pytest.mark.parametrize(("bandwidth_hz", "rate", "acceleration"), [(200, 0.02, 0.1), (400, 0.003, 0.03)])
    def test_errors_stay_small_up_to_the_ends(self, bandwidth_hz, rate, acceleration):
        t = np.arange(10_000) / FS_HZ
        y, y_dot, y_ddot = lines(t, [20, 50, 80], np.array([1.0, 2, 2]), 3 * [-np.pi / 2])  # eq. 13
        smooth, dot, ddot = zero_phase_motion(y, FS_HZ, bandwidth_hz)
        assert relative_error(smooth, y).max() < 1e-3
        assert relative_error(dot, y_dot).max() < rate
        assert relative_error(ddot, y_ddot).max() < acceleration

    def test_derivatives_of_a_parabola_are_exact_up_to_the_last_sample(self):
        t = np.arange(2_000) / FS_HZ
        smooth, dot, ddot = zero_phase_motion(3 - 2 * t + 50 * t**2, FS_HZ, 100)
        np.testing.assert_allclose(smooth, 3 - 2 * t + 50 * t**2, atol=1e-9)
        np.testing.assert_allclose(dot, -2 + 100 * t, atol=1e-6)
        np.testing.assert_allclose(ddot, 100, atol=1e-3)

    def test_the_rate_is_zero_where_a_record_starts_and_ends_at_rest(self):
        t = np.arange(20_000) / FS_HZ
        y = np.where((t > 0.2) & (t < 1.8), 1 - np.cos(2 * np.pi * 10 * (t - 0.2)), 0)
        _, dot, _ = zero_phase_motion(y, FS_HZ, 200)
        assert np.abs(dot[:1_500]).max() < 1e-3 and np.abs(dot[-1_500:]).max() < 1e-3
        assert relative_error(dot, np.gradient(y, 1 / FS_HZ)).max() < 0.01

    def test_a_batch_gives_the_same_as_its_records_one_by_one(self):
        batch = np.random.default_rng(0).standard_normal((3, 500)).cumsum(-1)
        for together, alone in zip(
            zero_phase_motion(batch, FS_HZ, 200),
            zip(*(zero_phase_motion(y, FS_HZ, 200) for y in batch), strict=True),
            strict=True,
        ):
            np.testing.assert_allclose(together, np.stack(alone), rtol=1e-9, atol=1e-9)


class TestPhaseAndNoise:
    def test_the_rate_has_no_phase_error(self):
        t = np.arange(20_000) / FS_HZ
        for frequency in (5, 50, 150, 200):
            y, y_dot, _ = lines(t, [frequency], np.ones(1), [0.3])
            _, dot, _ = zero_phase_motion(y, FS_HZ, 200)
            quarter_later = lines(t, [frequency], np.ones(1), [0.3 + np.pi / 2])[1]
            inner = slice(2_000, -2_000)  # whole periods
            in_phase = dot[inner] @ y_dot[inner] / (y_dot[inner] @ y_dot[inner])
            in_quadrature = dot[inner] @ quarter_later[inner] / (y_dot[inner] @ y_dot[inner])
            assert abs(np.arctan2(in_quadrature, in_phase)) < 1e-4

    def test_time_reversal_only_reverses_the_sign_of_the_rate(self):
        y = np.random.default_rng(1).standard_normal(2_000).cumsum()
        smooth, dot, ddot = zero_phase_motion(y, FS_HZ, 300)
        back = zero_phase_motion(y[::-1], FS_HZ, 300)
        for forward, reverse, sign in zip((smooth, dot, ddot), back, (1, -1, 1), strict=True):
            np.testing.assert_allclose(sign * reverse[::-1], forward, atol=1e-9 * np.abs(forward).max())

    @pytest.mark.parametrize("bandwidth_hz", [50, 200, 800])
    def test_the_noise_of_the_rate_is_below_the_stated_gain(self, bandwidth_hz):
        noise = 0.005 * np.random.default_rng(2).standard_normal(100_000)
        _, dot, _ = zero_phase_motion(noise, FS_HZ, bandwidth_hz)
        b = 1.5 * bandwidth_hz
        bound = 2 * np.pi * b * 0.005 * np.sqrt(2 * b / (3 * FS_HZ))
        assert 0.5 * bound < dot[1_000:-1_000].std() < bound

    def test_nothing_passes_above_one_and_a_half_bandwidths(self):
        t = np.arange(20_000) / FS_HZ
        _, dot, _ = zero_phase_motion(np.sin(2 * np.pi * 305 * t), FS_HZ, 200)
        assert np.abs(dot[1_000:-1_000]).max() < 1e-3 * 2 * np.pi * 305


class TestBandwidth:
    @pytest.mark.parametrize("noise_um", [0.002, 0.01, 0.05])
    def test_the_chosen_bandwidth_covers_the_motion_and_little_more(self, noise_um):
        t = np.arange(20_000) / FS_HZ
        y = lines(t, [20, 50, 80], np.array([1.0, 2, 2]), 3 * [-np.pi / 2])[0]
        found = motion_bandwidth(y + noise_um * np.random.default_rng(3).standard_normal(len(t)), FS_HZ)
        assert 80 <= found < 400

    def test_less_noise_gives_a_larger_bandwidth(self):
        t = np.arange(20_000) / FS_HZ
        triangle = np.abs(2 * (10 * t % 1) - 1)
        noise = np.random.default_rng(4).standard_normal(len(t))
        found = [motion_bandwidth(triangle + scale * noise, FS_HZ) for scale in (1e-1, 1e-3, 1e-5)]
        assert found == sorted(found) and found[0] < found[-1] <= FS_HZ / 4

    def test_the_chosen_bandwidth_gives_a_rate_error_near_the_smallest_possible(self):
        t = np.arange(40_000) / FS_HZ
        y, y_dot, _ = lines(t, [32, 40, 50], np.array([1.5, 1, 1]), 3 * [-np.pi / 2])
        noisy = y + 0.004 * np.random.default_rng(5).standard_normal(len(t))

        def error(bandwidth_hz):
            return np.std((zero_phase_motion(noisy, FS_HZ, bandwidth_hz)[1] - y_dot)[1_000:-1_000])

        best = min(error(bandwidth_hz) for bandwidth_hz in np.geomspace(20, 2_000, 40))
        assert error(motion_bandwidth(noisy, FS_HZ)) < 3 * best


class TestBadInput:
    @pytest.mark.parametrize("bandwidth_hz", [0.0, -5.0, 5_000.0, np.nan])
    def test_a_bandwidth_outside_the_spectrum_is_refused(self, bandwidth_hz):
        with pytest.raises(ConfigError, match="below half of the sample rate, 5000 Hz"):
            zero_phase_motion(np.zeros(100), FS_HZ, bandwidth_hz)

    def test_too_few_samples_are_refused(self):
        with pytest.raises(RecordingError, match="expected at least 8"):
            zero_phase_motion(np.zeros(5), FS_HZ, 100)
        with pytest.raises(RecordingError, match="expected at least 8"):
            motion_bandwidth(np.zeros(5), FS_HZ)
