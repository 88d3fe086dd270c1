"""The next recording separates the open causes, stays within the recorded ranges, and says why."""

from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from torchpi.diagnosis.deciding_excitation import stretch
from torchpi.diagnosis.next_recording import LEAST_RATE, MOST_SAMPLES, _decision, next_recording
from torchpi.diagnosis.splits import SHOWS, SPLITS
from torchpi.stage.effects.effect import DataRange

NAMES = (
    "amplifier_lag slew_limit voltage_saturation delay input_nonlinearity hysteresis_asymmetry "
    "incongruent_loops hysteresis_operator rate_dependent_hysteresis creep leakage resonance second_mode "
    "load_change backlash stiction cross_coupling sensor_lag sensor_nonlinearity quantization hum "
    "thermal_drift ageing"
).split()
USUAL = DataRange(10_000.0, 10.0, 0.0, 10.0, 1700.0, -0.1, 8.0, {})


def swings(u: np.ndarray) -> np.ndarray:
    """Return the amplitude spectrum of the voltage without its mean."""
    return np.abs(np.fft.rfft(u - u.mean())) / len(u)


@st.composite
def recordings(draw: st.DrawFn) -> DataRange:
    low_v = draw(st.floats(-100, 100))
    span_v = draw(st.sampled_from([0.0, 0.01, 1.0, 10.0, 170.0]))
    fs_hz = 10 ** draw(st.floats(-1, 6))
    rate_v_s = draw(st.sampled_from([0.0, 1e-3, 1.0, 1e3, 1e7]))
    return DataRange(fs_hz, 1.0, low_v, low_v + span_v, rate_v_s, 0.0, 1.0, {})


@settings(max_examples=80, deadline=None)
@given(
    recordings(), st.lists(st.sampled_from([*NAMES, "unheard_of"]), max_size=4, unique=True), st.booleans()
)
def test_the_excitation_stays_within_the_recorded_voltages_and_rates(seen, names, unexplained):
    said, (t, u) = next_recording(names, seen, unexplained=unexplained)
    assert said.why and said.excitation and "\n" not in said.why + said.excitation
    assert u[0] == u[-1] == 0 and len(t) == len(u) <= 2 * MOST_SAMPLES and np.all(np.isfinite(u))
    low_v, high_v = min(0.0, seen.low_v), max(0.0, seen.high_v)
    span_v = high_v - low_v
    assert u.min() >= low_v - 1e-9 * span_v and u.max() <= high_v + 1e-9 * span_v
    fs_hz = 1 / t[1]
    halvings = np.log2(seen.fs_hz / fs_hz)
    assert halvings == pytest.approx(round(halvings), abs=1e-9)
    bears_v_s = max(seen.max_rate_v_s, LEAST_RATE * span_v / stretch(seen.fs_hz))
    assert np.abs(np.diff(u)).max() * fs_hz <= bears_v_s * (1 + 1e-6)


def test_determining_the_hysteresis_comes_before_open_causes():
    said, (_, u) = next_recording(["hum"], USUAL, determined=False)
    assert said.why.startswith("Minor loops")
    turning = np.flatnonzero(np.diff(np.sign(np.diff(u[np.diff(u, prepend=np.nan) != 0]))))
    assert len(turning) > 10


@pytest.mark.parametrize("pair", list(combinations(NAMES, 2)))
def test_every_pair_has_a_reason_whichever_of_the_two_is_likelier(pair):
    one, other = _decision(pair, False), _decision(pair[::-1], False)
    if frozenset(pair) in SPLITS:
        assert one == other
    else:
        assert "look alike" in one.why and "look alike" in other.why


def test_the_tables_cover_the_names_of_the_contract_and_no_others():
    assert set(SHOWS) == set(NAMES)
    assert set().union(*SPLITS) <= set(NAMES)
    assert all(len(pair) == 2 for pair in SPLITS)


def test_the_leading_pair_decides_the_next_recording():
    said, _ = next_recording(["creep", "thermal_drift", "amplifier_lag", "delay"], USUAL)
    assert "drift depends on time alone" in said.why


@pytest.mark.parametrize(
    ("names", "measure"),
    [
        (["amplifier_lag", "sensor_lag"], "aux_amplifier_v"),
        (["sensor_nonlinearity", "input_nonlinearity"], "aux_reference_um"),
        (["load_change"], "without it"),
        (["delay"], "aux_amplifier_v"),
        (["cross_coupling"], "aux_other_v"),
    ],
)
def test_another_measurement_is_suggested_if_voltage_and_displacement_cannot_decide(names, measure):
    assert measure in next_recording(names, USUAL)[0].why


def test_high_frequencies_separate_a_lag_from_a_delay():
    _, (_, u) = next_recording(["amplifier_lag", "delay"], USUAL)
    f_hz, lines = np.fft.rfftfreq(len(u), 1e-4), swings(u)
    assert np.sqrt(np.sum(lines[(f_hz > 1000) & (f_hz < 2000)] ** 2)) > 0.03 * np.sqrt(np.sum(lines**2))


def test_one_frequency_at_three_amplitudes_and_full_rate_separates_a_lag_from_a_slew_limit():
    _, (_, u) = next_recording(["slew_limit", "amplifier_lag"], USUAL)
    peaks = np.round(u[1:-1][(np.diff(u[:-1]) > 0) & (np.diff(u[1:]) <= 0)] - 5, 1)
    sizes, counts = np.unique(peaks, return_counts=True)
    assert set(sizes[counts >= 20]) == {1.2, 2.5, 5.0} or set(sizes[counts >= 20]) == {1.3, 2.5, 5.0}
    assert np.abs(np.diff(u)).max() * 1e4 > 0.85 * USUAL.max_rate_v_s


def test_rests_at_the_same_levels_up_and_down_separate_creep_from_drift():
    _, (t, u) = next_recording(["thermal_drift", "creep"], USUAL)
    runs = np.split(u, np.flatnonzero(np.diff(u)) + 1)
    rests = [round(run[0], 6) for run in runs if len(run) * t[1] > 10]
    assert rests == [*rests[-2::-1], 0.0] and len(rests) == 6


def test_a_hold_of_three_decades_separates_the_kinds_of_creep():
    _, (t, u) = next_recording(["creep"], USUAL)
    runs = np.split(u, np.flatnonzero(np.diff(u)) + 1)
    assert max(len(run) for run in runs) * t[1] >= 100  # from 0.1 s on


def test_strokes_from_tiny_to_large_separate_backlash_from_stiction():
    _, (_, u) = next_recording(["backlash", "stiction"], USUAL)
    turns = u[1:-1][np.diff(u[:-1]) * np.diff(u[1:]) < 0]
    strokes = np.abs(np.diff(turns))
    assert strokes.min() < 0.2 and strokes.max() > 3


def test_recordings_at_rest_at_0_v_yield_a_rest_and_a_reference_to_torchpi_excite():
    said, (_, u) = next_recording(["hum"], DataRange(1000.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, {}))
    assert np.all(u == 0) and "torchpi excite" in said.excitation


def test_the_reason_says_whether_no_question_is_open_or_the_cause_has_no_name():
    assert "No question is open" in next_recording([], USUAL)[0].why
    assert "no name" in next_recording([], USUAL, unexplained=True)[0].why
