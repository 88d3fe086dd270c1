"""Long recordings are analysed as means of their samples, and the report says so."""

import numpy as np
import pytest

from torchpi.diagnosis import diagnose, long_recordings
from torchpi.diagnosis.long_recordings import at_a_lower_rate, rings_above
from torchpi.diagnosis.readings import Readings
from torchpi.diagnosis.records import prepare
from torchpi.recordings.recording import Recording


def recording(samples: int) -> Recording:
    t = np.arange(samples) / 1e4
    u = 5.0 - 5.0 * np.cos(2 * np.pi * t / t[-1] * 3)
    return Recording("long", t, u, 0.8 * u, 1e4, aux={"aux_v": u**2}, simulated=0.7 * u)


def test_short_recordings_stay_unchanged():
    one, wrong = recording(5000), [np.array([3])]
    kept, left, notes = at_a_lower_rate([one], wrong)
    assert kept == [one] and left == wrong and notes == ()


def test_long_recordings_become_means_at_a_lower_rate_and_a_note_says_so(monkeypatch):
    monkeypatch.setattr(long_recordings, "AT_MOST", 10_000)
    one = recording(39_999)
    (kept,), (left,), (note,) = at_a_lower_rate([one], [np.zeros(0, int)])
    assert len(kept) == 39_999 // 4 and kept.fs_hz == 2500.0 and len(left) == 0
    np.testing.assert_allclose(kept.u[7], one.u[28:32].mean())
    np.testing.assert_allclose(kept.y, 0.8 * kept.u)
    np.testing.assert_allclose(kept.simulated, 0.7 * kept.u)
    np.testing.assert_allclose(np.diff(kept.t), 1 / kept.fs_hz)
    assert kept.aux["aux_v"].shape == kept.u.shape
    assert "39,999 samples" in note and "1.25e+03 Hz" in note


def test_an_excluded_reading_is_replaced_by_the_one_before_it(monkeypatch):
    monkeypatch.setattr(long_recordings, "AT_MOST", 10_000)
    one = recording(40_000)
    one.y[8001] = 1e6
    (kept,), (left,), _ = at_a_lower_rate([one], [np.array([8001])])
    assert np.abs(kept.y - 0.8 * kept.u).max() < 1e-2 and len(left) == 0


def test_averaging_a_step_causes_no_overshoot(monkeypatch):
    monkeypatch.setattr(long_recordings, "AT_MOST", 10_000)
    one = recording(40_000)
    one.u[:] = np.where(np.arange(40_000) < 20_001, 1.0, 4.0)
    (kept,), _, _ = at_a_lower_rate([one], [np.zeros(0, int)])
    assert (np.diff(kept.u) >= 0).all() and kept.u.min() == 1.0 and kept.u.max() == 4.0


def test_a_fast_voltage_is_cut_short_if_averaging_would_move_its_turning_points(monkeypatch):
    """Plays depend on turning points; means of two shift those of a chirp up to a tenth of the rate."""
    monkeypatch.setattr(long_recordings, "AT_MOST", 30_000)
    slow, chirp = recording(20_000), recording(20_000)
    chirp.u[:] = 5 * np.sin(2 * np.pi * 0.05 * np.arange(20_000) ** 2 / 20_000)
    (means, first), (_, left), (averaged, cut) = at_a_lower_rate(
        [slow, chirp], [np.zeros(0, int), np.array([7, 15_000])]
    )
    assert means.fs_hz == 5e3 and "averaged over 2 at a time" in averaged
    assert first.fs_hz == 1e4 and np.array_equal(first.u, chirp.u[:10_000]) and left.tolist() == [7]
    assert first.aux["aux_v"].shape == first.simulated.shape == first.u.shape
    assert "the first 1 s of 2 s" in cut and "too fast" in cut


def stairs(samples: int, rings: float, noise_um: float = 1e-3) -> Recording:
    """Steps of 1 V up and down each second, after which a 3.1 kHz mode rings by this share of a step."""
    one, step = recording(samples), np.arange(samples) // 10_000
    one.u[:] = np.where(step % 4 < 2, step % 4, 4 - step % 4)
    since = np.arange(samples) % 10_000
    one.y[:] = 0.8 * one.u + np.random.default_rng(0).normal(0, noise_um, samples)
    sign = np.sign(np.diff(one.u, prepend=0.0))[step * 10_000]
    one.y[:] -= rings * 0.8 * sign * np.exp(-since / 100) * np.cos(2 * np.pi * 0.31 * since)
    return one


@pytest.mark.parametrize(("rings", "cut"), [(0.0, False), (0.001, False), (0.3, True)])
def test_a_recording_that_rings_too_fast_for_averaging_is_cut_short(monkeypatch, rings, cut):
    monkeypatch.setattr(long_recordings, "AT_MOST", 30_000)
    one = stairs(60_000, rings)
    (kept,), _, (note,) = at_a_lower_rate([one], [np.zeros(0, int)])
    assert kept.fs_hz == (1e4 if cut else 5e3) and len(kept) == 30_000
    assert ("rings too fast" in note) == cut


@pytest.mark.parametrize("colour", ["1/f", "1/f²"])
def test_slow_noise_is_not_mistaken_for_ringing(colour):
    one = stairs(60_000, 0.0)
    white = np.random.default_rng(1).normal(0, 0.01, 60_000)
    spectrum = np.fft.rfft(white) / np.maximum(np.arange(30_001), 1) ** (1.0 if colour == "1/f²" else 0.5)
    one.y[:] += np.fft.irfft(spectrum) * 100
    assert not any(rings_above(one, factor) for factor in (2, 5, 15))


def test_the_command_of_the_previous_tick_is_one_controller_tick_back_and_not_one_mean(monkeypatch):
    monkeypatch.setattr(long_recordings, "AT_MOST", 10_000)
    one = recording(40_001)
    kept, left, _ = at_a_lower_rate([one], [np.zeros(0, int)])
    (record,) = prepare(kept, left, as_recorded=[one])
    assert record.tick_s == 1e-4 and record.period_s == 5e-4 and len(record.u) == 8000
    np.testing.assert_allclose(record.commanded(1)[7], one.u[34:39].mean(), rtol=1e-12)
    np.testing.assert_allclose(record.commanded(0)[7], one.u[35:40].mean(), rtol=1e-12)
    np.testing.assert_allclose(record.simulated[-1][7], one.simulated[36:41].mean(), rtol=1e-12)


@pytest.mark.parametrize(("first", "across"), [(20_001, [5000]), (20_000, [4999, 5000]), (0, [])])
def test_means_across_a_step_do_not_count_at_any_convention_of_timing(monkeypatch, first, across):
    monkeypatch.setattr(long_recordings, "AT_MOST", 10_000)
    one = recording(40_000)
    if first:
        one.u[:] = np.where(np.arange(40_000) < first, 1.0, 4.0) + 0.1 * (np.arange(40_000) < 100)
    readings = Readings.of([one])
    assert [each.tolist() for each in readings.out] == [across]
    (record,) = readings.records()
    assert not record.train[across].any()
    assert record.train.sum() + record.held_out.sum() == 10_000 - len(across)
    assert ("Means across a step of the voltage do not count." in readings.notes) == bool(across)
    assert [each.tolist() for each in readings.apart] == [[]]


def test_no_lag_is_named_where_means_straddle_the_steps_of_a_stage_that_reads_before_it_writes(monkeypatch):
    """The mean of what a hysteresis makes of two voltages is not what it makes of their mean."""
    monkeypatch.setattr(long_recordings, "AT_MOST", 6_000)
    rng = np.random.default_rng(5)
    u = np.repeat(rng.uniform(0.0, 8.0, 600), 20)
    r, h, y = np.linspace(0.0, 4.0, 20), np.zeros(20), np.empty(len(u))
    for k, v in enumerate(np.append(u[0], u[:-1])):
        h = np.maximum(v - r, np.minimum(v + r, h))
        y[k] = h.sum() / 20
    one = Recording("late", np.arange(len(u)) / 1e4, u, y + 1e-3 * rng.standard_normal(len(u)), 1e4)
    found = diagnose([one])
    assert [effect.name for effect in found.effects] == [] and found.stage.alignment == 1


def test_no_lag_is_named_in_a_long_recording_that_reads_before_it_writes(monkeypatch):
    """In means of five, the previous tick is a fifth of a sample back, which no whole-sample shift covers."""
    monkeypatch.setattr(long_recordings, "AT_MOST", 6_000)
    rng = np.random.default_rng(3)
    t = np.arange(30_000) / 1e4
    u = 4 - 4 * np.cos(2 * np.pi * 4 * t) + np.sin(2 * np.pi * 23 * t)
    u[:1000] = u[-1000:] = 0.0
    before = np.append(u[0], u[:-1])
    one = Recording("late", t, u, 0.8 * before + 1e-3 * rng.standard_normal(len(t)), 1e4)
    found = diagnose([one])
    assert [effect.name for effect in found.effects] == [] and found.verdict == "nothing_missing"
    assert found.stage.alignment == 1 and any("previous tick" in note for note in found.notes)
    assert found.augmented.heldout_rms_um < 0.6e-3
    assert found.stage.sample_rate_hz == 1e4
    left = one.y - found.stage.simulate(u[None])[0]
    assert (left - left.mean()).std() < 1.1e-3
