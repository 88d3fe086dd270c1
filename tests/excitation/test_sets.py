"""The set for a diagnosis stays within the user's limits and has the structure that the analysis needs."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from torchpi.errors import ConfigError
from torchpi.excitation.limits import DriveLimits
from torchpi.excitation.sets import (
    LEAST_HIGH_HZ,
    PERIOD_S,
    PERIODS,
    SMALL,
    STAIR_HOLDS_S,
    diagnostic_excitations,
)
from torchpi.recordings.recording import Recording, check_recording
from torchpi.stage import Stage


@st.composite
def stages(draw: st.DrawFn) -> DriveLimits:
    """Limits of stages of many sizes, each of which allows a rate high enough for its range and band."""
    high_hz = draw(st.floats(LEAST_HIGH_HZ, 400))
    low_v, high_v = draw(
        st.sampled_from([(0, 10), (-2, 12), (0, 150), (-5, 5), (-0.03, 0.12), (-10, 0), (0, 7.5)])
    )
    rate_v_s = (high_v - low_v) * draw(st.floats(100, 3000))
    return DriveLimits(low_v, high_v, rate_v_s, high_hz * draw(st.floats(4, 10)), high_hz)


def one_period(u: np.ndarray, limits: DriveLimits, share: float) -> int:
    """Return where the first period begins, which is where the approach before two equal periods ends."""
    samples = round(PERIOD_S * limits.sample_rate_hz)
    repeats = np.flatnonzero(u[samples:] != u[:-samples])
    gaps = np.diff(repeats)
    start = int(repeats[np.argmax(gaps)]) + 1
    assert gaps.max() - 1 >= (PERIODS - 1) * samples
    assert np.ptp(u[start : start + samples]) == pytest.approx(share * limits.span_v, rel=1e-9)
    return start


@settings(max_examples=40, deadline=None)
@given(stages(), st.integers(0, 1000))
def test_every_excitation_keeps_to_the_limits_and_begins_and_ends_at_0_v(limits, seed):
    for t, u in diagnostic_excitations(limits, seed).values():
        assert t.dtype == u.dtype == np.float64
        np.testing.assert_array_equal(t, np.arange(len(u)) / limits.sample_rate_hz)
        assert u[0] == u[-1] == 0
        tolerance = 1e-9 * limits.span_v
        assert u.min() >= limits.min_voltage_v - tolerance and u.max() <= limits.max_voltage_v + tolerance
        rate_v_s = np.abs(np.diff(u)) * limits.sample_rate_hz
        assert rate_v_s.max() <= limits.max_rate_v_s * (1 + 1e-9)


@settings(max_examples=20, deadline=None)
@given(stages())
def test_the_set_takes_about_a_minute_and_ends_with_a_repeated_multisine(limits):
    made = diagnostic_excitations(limits)
    names = list(made)
    assert (names[0], names[-1]) == ("hold", "multisine_again")
    assert 45 < sum(len(u) for _, u in made.values()) / limits.sample_rate_hz < 90
    np.testing.assert_array_equal(made["multisine_again"][1], made["multisine_large"][1])


@settings(max_examples=30, deadline=None)
@given(stages(), st.integers(0, 1000))
def test_the_multisine_is_periodic_with_odd_lines_of_which_a_quarter_and_the_mains_are_omitted(limits, seed):
    made = diagnostic_excitations(limits, seed)
    samples = round(PERIOD_S * limits.sample_rate_hz)
    present = {}
    for name, share in (("multisine_large", 1.0), ("multisine_small", SMALL)):
        u = made[name][1]
        start = one_period(u, limits, share)
        lines = np.abs(np.fft.rfft(u[start : start + samples])) / samples
        present[name] = np.flatnonzero(lines[1:] > 1e-9 * limits.span_v) + 1
    lines = present["multisine_large"]
    np.testing.assert_array_equal(present["multisine_small"], lines)
    spacing_hz = limits.sample_rate_hz / samples
    assert np.all(lines % 2 == 1)
    assert lines[-1] * spacing_hz <= limits.high_hz * (1 + 1e-9)
    for mains_hz in (50, 60):
        away = np.abs(lines * spacing_hz - np.maximum(1, np.round(lines * spacing_hz / mains_hz)) * mains_hz)
        assert away.min() > 0.4 * spacing_hz
    possible = np.arange(1, int(limits.high_hz / spacing_hz) + 1, 2)
    left_out = np.setdiff1d(possible, lines)
    assert len(left_out) == pytest.approx(len(possible) / 4, abs=1 + len(possible) / 20)
    assert np.diff(left_out).max() <= 2 * 8  # spread over the whole band


@settings(max_examples=20, deadline=None)
@given(stages())
def test_stairs_hold_the_same_levels_up_and_down_for_1_to_20_s(limits):
    u = diagnostic_excitations(limits)["stairs"][1]
    edges = np.flatnonzero(np.diff(u)) + 1
    runs = np.split(u, edges)
    rests = [(run[0], len(run) / limits.sample_rate_hz) for run in runs if len(run) >= limits.sample_rate_hz]
    fractions = [(level - limits.min_voltage_v) / limits.span_v for level, _ in rests]
    np.testing.assert_allclose(fractions, [0.25, 0.5, 0.75, 1, 0.75, 0.5, 0.25, 0], atol=1e-12)
    for (_, held_s), wanted_s in zip(rests, STAIR_HOLDS_S, strict=True):
        assert 1 <= wanted_s <= held_s <= 20


@settings(max_examples=20, deadline=None)
@given(stages())
def test_triangles_have_three_rates_and_reach_three_amplitudes_and_two_biases(limits):
    limits = replace(limits, sample_rate_hz=50 * limits.high_hz)
    u = diagnostic_excitations(limits)["triangles"][1]
    x = (u - limits.min_voltage_v) / limits.span_v
    slopes = np.abs(np.diff(x)) * limits.sample_rate_hz
    straight = slopes[:-1][(np.abs(np.diff(slopes)) < 1e-6 * slopes[:-1]) & (slopes[:-1] > 0.1)]
    rates, samples = np.unique(np.round(straight, 4), return_counts=True)
    rates = rates[samples > 100]  # not where a rounded corner happens to be straight
    assert np.sum(rates[1:] > 1.5 * rates[:-1]) == 3 - 1
    turns = x[1:-1][np.diff(x[:-1]) * np.diff(x[1:]) <= 0]
    for level in (1.0, 0.6, 0.3, 0.2, 0.4, 0.8, 0.0):
        assert np.abs(turns - level).min() < 0.02


@settings(max_examples=20, deadline=None)
@given(stages())
def test_almost_no_power_lies_above_twice_the_highest_frequency(limits):
    for _, u in diagnostic_excitations(replace(limits, sample_rate_hz=10 * limits.high_hz)).values():
        power = np.abs(np.fft.rfft(u - u.mean())) ** 2
        beyond = np.fft.rfftfreq(len(u), 0.1 / limits.high_hz) > 2 * limits.high_hz
        assert power[beyond].sum() < 1e-6 * power.sum()


@pytest.mark.parametrize(
    ("low_v", "high_v", "level_v"), [(0, 10, 7), (-5, 5, -3.5), (-3, 8, 5.6), (-4, 0, -2.8)]
)
def test_the_hold_rests_for_5_s_away_from_0_v(low_v, high_v, level_v):
    limits = DriveLimits(low_v, high_v)
    held = np.isclose(diagnostic_excitations(limits)["hold"][1], level_v, rtol=1e-12)
    assert 5 <= held.sum() / limits.sample_rate_hz < 5.002


def test_recordings_of_every_excitation_pass_the_check_without_a_warning():
    stage = Stage.from_yaml(Path(__file__).parents[2] / "configs" / "stage" / "default.yaml")
    for name, (t, u) in diagnostic_excitations(DriveLimits()).items():
        _, y = stage.simulate(torch.from_numpy(u)[None])
        check_recording(Recording(name, t, u, y[0].detach().numpy(), stage.sample_rate_hz))


def test_the_same_seed_gives_the_same_bits_and_another_seed_other_phases():
    limits = DriveLimits(sample_rate_hz=2_000.0)
    first, again, other = (diagnostic_excitations(limits, seed) for seed in (3, 3, 4))
    for name, (_, u) in first.items():
        np.testing.assert_array_equal(u, again[name][1])
    a, b = first["multisine_large"][1], other["multisine_large"][1]
    assert len(a) != len(b) or not np.array_equal(a, b)


@pytest.mark.parametrize(
    ("limits", "says"),
    [
        ({"min_voltage_v": 1.0}, "min_voltage_v is 1 V, expected 0 V or less"),
        ({"min_voltage_v": -5.0, "max_voltage_v": -1.0}, "max_voltage_v is -1 V, expected 0 V or more"),
        ({"min_voltage_v": 0.0, "max_voltage_v": 0.0}, "expected the lower limit first"),
        ({"max_voltage_v": np.inf}, "from 0 to inf V"),
        ({"max_rate_v_s": 0.0}, "max_rate_v_s is 0, expected more than 0"),
        ({"sample_rate_hz": np.nan}, "sample_rate_hz is nan"),
        ({"sample_rate_hz": 500.0}, "sample_rate_hz is 500 Hz, expected 800 Hz or more"),
        ({"high_hz": 5.0}, "high_hz is 5 Hz, expected 20 Hz or more"),
        ({"max_rate_v_s": 50.0}, "max_rate_v_s is 50 V/s, expected"),
    ],
)
def test_contradictory_limits_are_refused_in_one_line_with_the_value_needed(limits, says):
    with pytest.raises(ConfigError) as caught:
        diagnostic_excitations(DriveLimits(**limits))
    assert says in str(caught.value) and "\n" not in str(caught.value)


@settings(max_examples=20, deadline=None)
@given(stages(), st.integers(0, 100))
def test_the_rate_that_the_error_asks_for_is_sufficient(limits, seed):
    slow = replace(limits, max_rate_v_s=0.1 * limits.span_v)
    with pytest.raises(ConfigError) as caught:
        diagnostic_excitations(slow, seed)
    wanted_v_s = float(str(caught.value).partition("expected ")[2].split()[0])
    diagnostic_excitations(replace(limits, max_rate_v_s=wanted_v_s), seed)
