"""The paper's signals have the ranges and rates of its equations, and all others meet their definition."""

import inspect

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from torchpi.errors import ConfigError
from torchpi.excitation.signals import (
    EXCITATIONS,
    TRAJECTORIES,
    fast_trajectory,
    hold,
    make_excitation,
    multisine,
    paper_multisine,
    random_trajectory,
    sine_5hz,
    sine_trajectory,
    slow_trajectory,
    stairs,
    triangles,
)

FS_HZ = 10_000.0


def largest_rate(t: np.ndarray, x: np.ndarray) -> float:
    return float(np.abs(np.gradient(x, t)).max())


class TestThePapersSignals:
    """Ranges and rates as recomputed independently of this project."""

    @pytest.mark.parametrize(
        ("signal", "low", "high", "rate"),
        [
            (paper_multisine, 0.0, 9.632, 1740.0),
            (slow_trajectory, 1.0, 7.0, 94.2),
            (fast_trajectory, 1.0, 7.826, 831.5),
        ],
    )
    def test_ranges_and_rates_are_those_of_the_equations(self, signal, low, high, rate):
        t, x = signal(2.0, 100_000.0)
        assert x.min() == pytest.approx(low, abs=1e-9)
        assert x.max() == pytest.approx(high, abs=6e-4)
        assert largest_rate(t, x) == pytest.approx(rate, rel=1e-3)

    @pytest.mark.parametrize(
        "signal", [paper_multisine, slow_trajectory, fast_trajectory, sine_5hz, sine_trajectory]
    )
    def test_signals_begin_at_rest_at_their_lowest_point(self, signal):
        _t, x = signal(1.0, 100_000.0)
        assert x[0] == pytest.approx(x.min(), abs=1e-12)
        assert abs(x[1] - x[0]) < 1e-5 * np.ptp(x)

    def test_eq_13_repeats_after_a_tenth_of_a_second_and_has_the_papers_5000_points(self):
        _t, u = paper_multisine(0.5)
        assert len(u) == 5000
        np.testing.assert_allclose(u[:4000], u[1000:], atol=1e-12)

    def test_eq_9_and_the_5_hz_sine_match_their_formulas(self):
        t, y = sine_trajectory(1.0, FS_HZ, 50)
        np.testing.assert_allclose(y, 5.5 + 4.5 * np.sin(2 * np.pi * 50 * t - 0.5 * np.pi))
        t, u = sine_5hz()
        np.testing.assert_allclose(u, 5 - 5 * np.cos(10 * np.pi * t), atol=1e-12)


class TestEverySignal:
    @pytest.mark.parametrize("make", [*EXCITATIONS.values(), *TRAJECTORIES.values()])
    def test_time_is_uniform_from_zero_and_the_same_call_gives_the_same_bits(self, make):
        t, x = make(duration_s=2.0, fs_hz=5_000.0)
        assert t.dtype == x.dtype == np.float64
        assert t.shape == x.shape
        np.testing.assert_array_equal(t, np.arange(len(t)) / 5_000.0)
        np.testing.assert_array_equal(x, make(duration_s=2.0, fs_hz=5_000.0)[1])

    @pytest.mark.parametrize("make", EXCITATIONS.values())
    def test_excitations_start_at_0_v_and_stay_within_0_to_10_v(self, make):
        _, u = make()
        assert abs(u[0]) < 1e-9
        assert u.min() > -1e-9 and u.max() < 10 + 1e-9

    @pytest.mark.parametrize("make", [*EXCITATIONS.values(), *TRAJECTORIES.values()])
    def test_every_argument_has_a_default_so_a_command_can_list_it(self, make):
        parameters = inspect.signature(make).parameters
        assert list(parameters)[:2] == ["duration_s", "fs_hz"]
        assert all(p.default is not inspect.Parameter.empty for p in parameters.values())

    @pytest.mark.parametrize("make", [*EXCITATIONS.values(), *TRAJECTORIES.values()])
    @pytest.mark.parametrize("wrong", [{"duration_s": 0.0}, {"duration_s": np.nan}, {"fs_hz": -1.0}])
    def test_arguments_that_give_no_samples_are_refused(self, make, wrong):
        with pytest.raises(ConfigError, match="expected"):
            make(**wrong)


class TestByName:
    def test_every_name_makes_its_excitation(self):
        for name, make in EXCITATIONS.items():
            np.testing.assert_array_equal(make_excitation(name, 5_000.0, 2.0)[1], make(2.0, 5_000.0)[1])

    def test_duration_seed_and_options_are_passed_on(self):
        _t, u = make_excitation("multisine", 5_000.0, None, 3, {"high_hz": 80})
        np.testing.assert_array_equal(u, multisine(fs_hz=5_000.0, seed=3, high_hz=80)[1])
        np.testing.assert_array_equal(make_excitation("hold", 100.0, 1.0, seed=3)[1], hold(1.0, 100.0)[1])

    @pytest.mark.parametrize(
        ("name", "options", "says"),
        [
            ("multisin", {}, "perhaps 'multisine'"),
            ("multisine", {"hihg_hz": 3}, "perhaps 'high_hz'"),
            ("paper_multisine", {"fs_hz": 3}, "options are: none"),
            ("stairs", {"steps": "many"}, "steps='many'"),
            ("triangles", {"rates": 3}, "rates=3"),
            ("multisine", {"high_hz": 9_000}, "band"),
        ],
    )
    def test_unknown_names_and_invalid_options_are_refused_in_one_line(self, name, options, says):
        with pytest.raises(ConfigError) as caught:
            make_excitation(name, FS_HZ, 1.0, 0, options)
        assert says in str(caught.value) and "\n" not in str(caught.value)


class TestMultisine:
    def spectrum(self, u: np.ndarray, fs_hz: float, periods: int) -> tuple[np.ndarray, np.ndarray]:
        whole = np.abs(np.fft.rfft(u)) / len(u)
        return np.fft.rfftfreq(len(u), 1 / fs_hz)[::periods], whole

    @given(
        periods=st.integers(1, 4),
        odd=st.booleans(),
        holes=st.booleans(),
        seed=st.integers(0, 1000),
    )
    def test_the_spectrum_has_only_the_promised_lines(self, periods, odd, holes, seed):
        _, u = multisine(
            2.0 * periods,
            2_000.0,
            periods=periods,
            odd_lines=odd,
            detection_lines=holes,
            seed=seed,
            ramp_in_s=0,
        )
        frequency, spectrum = self.spectrum(u, 2_000.0, periods)
        np.testing.assert_allclose(np.delete(spectrum, np.s_[::periods]), 0, atol=1e-12)
        lines = spectrum[::periods]
        present = np.flatnonzero(lines[1:] > 1e-9) + 1
        np.testing.assert_allclose(lines[present], lines[present[0]], rtol=1e-9)  # a flat spectrum
        assert frequency[present[0]] >= 1 and frequency[present[-1]] <= 200
        for mains in (50, 60):
            assert not np.any(np.abs(frequency[present] % mains) < 1e-9)
        if odd:
            assert np.all(present % 2 == 1)
        possible = sum(
            1 for k in range(2, 401) if (not odd or k % 2) and not (k / 2) % 50 == 0 and not (k / 2) % 60 == 0
        )
        assert len(present) == (possible - possible // 4 if holes else possible)

    def test_a_multisine_fills_its_range_or_has_the_given_rms(self):
        _, u = multisine(low_v=1, high_v=8)
        assert (u[2000:].min(), u[2000:].max()) == (1, 8)
        _, u = multisine(rms_v=1.0, ramp_in_s=0)
        assert np.sqrt(np.mean((u - 5) ** 2)) == pytest.approx(1.0)
        with pytest.raises(ConfigError, match="rms_v"):
            multisine(rms_v=4)

    def test_the_ramp_is_smooth_and_leaves_the_periods_unchanged(self):
        _t, u = multisine(2.0, ramp_in_s=0.2, periods=2)
        assert len(u) == 22_000
        np.testing.assert_array_equal(u[2_000:12_000], u[12_000:])
        np.testing.assert_array_equal(u[2_000:], multisine(2.0, ramp_in_s=0, periods=2)[1])
        assert np.abs(np.diff(u, 2)).max() < 1.1 * np.abs(np.diff(u[2_000:], 2)).max()

    def test_above_the_corner_frequency_all_lines_have_the_same_rate(self):
        _, u = multisine(2.0, 2_000.0, periods=1, corner_hz=20, ramp_in_s=0)
        frequency, lines = self.spectrum(u, 2_000.0, 1)
        present = lines[1:] > 1e-9
        frequency, lines = frequency[1:][present], lines[1:][present]
        np.testing.assert_allclose(lines[frequency <= 20], lines[0])
        np.testing.assert_allclose((lines * frequency)[frequency >= 20], 20 * lines[0])

    def test_an_empty_band_is_refused(self):
        with pytest.raises(ConfigError, match="no line"):
            multisine(0.1, low_hz=3, high_hz=5)
        with pytest.raises(ConfigError, match="band"):
            multisine(low_hz=10, high_hz=6_000)


class TestTriangles:
    def test_triangles_have_the_promised_rates(self):
        _t, u = triangles(30.0, rates=(1, 4))
        slopes = np.abs(np.diff(u)) * FS_HZ
        usual = np.sort(slopes)
        slow, fast = np.median(usual[usual < usual.max() / 2]), np.median(usual[usual > usual.max() / 2])
        assert fast / slow == pytest.approx(4, rel=1e-6)

    def test_major_and_minor_loops_reach_their_levels(self):
        _t, u = triangles(30.0, amplitudes=(1.0, 0.5), minor_biases=(0.3,), minor_amplitude=0.2, rates=(1,))
        slope = np.sign(np.diff(u))
        turns = u[1:-1][slope[1:] * slope[:-1] < 0]
        for level in (10, 5, 4, 2, 0):
            assert np.abs(turns - level).min() < 2e-3
        assert u.max() == pytest.approx(10, abs=2e-3)

    def test_levels_outside_the_range_are_refused(self):
        with pytest.raises(ConfigError, match="minor_amplitude"):
            triangles(minor_biases=(0.95,), minor_amplitude=0.3)


class TestStairs:
    @given(st.integers(1, 12), st.floats(-1, 4), st.floats(5, 9))
    def test_every_level_is_held_for_the_same_time_up_and_down(self, steps, low, high):
        _, u = stairs(2.0, 5_000.0, low, high, steps)
        levels = np.concatenate((np.arange(steps + 1), np.arange(steps)[::-1])) / steps
        np.testing.assert_allclose(u, u[::-1], atol=(high - low) / steps + 1e-9)
        changes = np.flatnonzero(np.diff(u)) + 1
        assert len(changes) == 2 * steps
        lengths = np.diff(np.concatenate(([0], changes, [len(u)])))
        assert np.ptp(lengths) <= 1
        np.testing.assert_allclose(u[np.concatenate(([0], changes))], low + (high - low) * levels)

    def test_an_eased_step_neither_jumps_nor_overshoots(self):
        _, u = stairs(2.0, rise_s=0.02)
        assert np.abs(np.diff(u)).max() < 2 * 1.9 / 200
        assert (u.min(), u.max()) == (0, 10)
        with pytest.raises(ConfigError, match="rise_s"):
            stairs(2.0, rise_s=1)


class TestHoldAndRandom:
    def test_a_hold_arrives_smoothly_and_stays(self):
        _t, u = hold(1.0, level_v=7, ramp_in_s=0.1)
        assert len(u) == 11_000
        assert np.all(u[1_000:] == 7)
        assert np.abs(np.diff(u)).max() < 7 * 1.9 / 1_000

    @given(st.integers(0, 10_000))
    def test_a_random_trajectory_begins_at_rest_and_stays_in_its_range_and_band(self, seed):
        _t, y = random_trajectory(2.0, 2_000.0, 1.5, 6.5, 2, 40, seed)
        assert y[0] == 1.5 and abs(y[1] - y[0]) < 1e-3
        assert y.min() >= 1.5 and y.max() <= 6.5
        later = y[200:] - y[200:].mean()
        power = np.abs(np.fft.rfft(later * np.hanning(len(later)))) ** 2
        frequency = np.fft.rfftfreq(len(later), 1 / 2_000.0)
        assert power[frequency > 45].sum() < 1e-4 * power.sum()

    def test_different_seeds_give_different_trajectories(self):
        assert not np.array_equal(random_trajectory(seed=0)[1], random_trajectory(seed=1)[1])
