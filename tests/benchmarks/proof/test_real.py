"""Effects put into real recordings: exactly what the label says."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from concealed.cases import write_case
from concealed.real import case, effects
from concealed.real.case import EVERYWHERE, PLANS, SEVERITIES, draw_case, untouched_recordings
from concealed.real.sources import Record, draw_residual, noise_of_periods
from concealed.tracks import DATA

with_data = pytest.mark.skipif(not DATA.is_dir(), reason="the real recordings are not here")
FS = 500.0
NOISE_UM = 0.01


class TestEffects:
    def test_a_sensor_lag_turns_a_sine_by_the_phase_of_one_pole(self):
        t = np.arange(4000) / FS
        record = _record(np.sin(2 * np.pi * 5 * t))
        injection = effects.sensor_lag(_rng(), [record], NOISE_UM)
        strength = 3.0
        cutoff = injection.parameters(strength)["cutoff_hz"][0]
        (lagged,) = injection.inject(strength)
        answer = 1 / (1 + 5j / cutoff)
        exact = np.abs(answer) * np.sin(2 * np.pi * 5 * t + np.angle(answer))
        np.testing.assert_allclose(lagged.y[500:], exact[500:], atol=2e-3)

    @pytest.mark.parametrize("period", [None, 1000])
    def test_delays_of_sensor_and_command_are_the_same_shift(self, period):
        wave = np.tile(np.sin(2 * np.pi * np.arange(1000) / 1000), 2)
        record = replace(_record(wave), u=wave.copy(), period=period)
        (late,) = effects.delay_of_the_sensor(_rng(), [record], NOISE_UM).inject(3.0)
        (early,) = effects.delay_of_the_command(_rng(), [record], NOISE_UM).inject(3.0)
        np.testing.assert_allclose(late.y[3:], wave[:-3])
        np.testing.assert_allclose(early.u[: wave.size - 3], wave[3:])
        assert early.u.size == early.y.size

    def test_readings_before_the_first_sample_are_those_of_the_recording(self):
        whole = np.arange(100.0)
        record = replace(_record(whole[10:]), before=whole[:10])
        np.testing.assert_array_equal(record.read_late(4), whole[6:-4])
        np.testing.assert_array_equal(record.read_late(12)[:3], [0.0, 0.0, 0.0])

    def test_dropouts_are_single_readings(self):
        record = _record(1 + np.zeros(4000))
        for seed in range(4):
            injection = effects.dropouts(_rng(seed), [record], NOISE_UM)
            (injected,) = injection.inject(injection.start)
            changed = np.flatnonzero(injected.y != record.y)
            assert 3 <= changed.size <= 40 and changed[0] > 0

    def test_a_withheld_axis_is_not_in_the_files(self):
        record = replace(_record(np.zeros(10)), aux={"aux_2_v": np.ones(10), "aux_3_v": np.ones(10)})
        (injected,) = effects.withheld(_rng(), [record], NOISE_UM).inject(1.0)
        assert len(injected.aux) == 1

    def test_noise_of_periods_is_that_of_white_noise_on_a_wave(self):
        noise = NOISE_UM * _rng().standard_normal(20_000)
        wave = np.tile(np.sin(2 * np.pi * np.arange(1000) / 1000), 20)
        assert noise_of_periods(wave + noise, 1000) == pytest.approx(NOISE_UM, rel=0.03)

    @pytest.mark.parametrize("kind", sorted(EVERYWHERE))
    def test_every_effect_vanishes_with_its_strength(self, kind):
        wave = np.sin(2 * np.pi * np.arange(4000) / 500) + NOISE_UM * _rng().standard_normal(4000)
        injection = EVERYWHERE[kind](_rng(3), [_record(wave)], NOISE_UM)
        (faint,), (strong,) = injection.inject(injection.low), injection.inject(injection.high)
        assert np.std(faint.y - wave) < 1.5 * NOISE_UM < np.std(strong.y - wave)


@with_data
class TestCases:
    @pytest.mark.parametrize("kind", ["hum", "sensor_nonlinearity", "gain_multiplicative"])
    def test_the_severity_is_the_one_on_the_label(self, kind):
        index = _index(0, "stack_sine", kind)
        case = draw_case(DATA, 0, index)
        with_effect, without = (
            np.concatenate([r["output_um"] - r["output_um"].mean() for r in records])
            for records in (case.recordings, case.untouched)
        )
        gain = with_effect @ without / (without @ without)
        rms = np.sqrt(np.mean((with_effect - gain * without) ** 2))
        assert rms / case.labels["noise_rms_um"] == pytest.approx(case.labels["severity"], rel=1e-6)
        assert SEVERITIES[0] * 0.9 < case.labels["severity"] < SEVERITIES[1] * 1.1

    def test_a_seed_gives_the_same_files_again_and_both_folders_have_the_contract(self, tmp_path):
        number = _index(0, "stack_sine", "axis_recorded")
        for folder in ("first", "again"):
            write_case(draw_case(DATA, 0, number), "case_0001", tmp_path / folder)
        files = sorted(p.relative_to(tmp_path / "first") for p in (tmp_path / "first").rglob("*.csv"))
        assert len(files) == 2
        for file in files:
            assert (tmp_path / "first" / file).read_bytes() == (tmp_path / "again" / file).read_bytes()
            assert (tmp_path / "first" / file).read_text().startswith("time_s,input_v,output_um,aux_v\n")

    def test_cases_with_the_same_untouched_recordings_have_them_alike(self):
        first, second = (_index(3, "motor_a", kind) for kind in ("hum", "ageing"))
        assert untouched_recordings(3, first) == untouched_recordings(3, second) == ("motor_a", False)
        one, other = (draw_case(DATA, 3, index) for index in (first, second))
        assert one.labels["untouched"] == other.labels["untouched"]
        np.testing.assert_array_equal(one.untouched[0]["output_um"], other.untouched[0]["output_um"])

    @pytest.mark.parametrize("seed", range(3))
    def test_residuals_of_real_recordings_have_the_rms_and_the_length_that_were_asked_for(self, seed):
        noise = draw_residual(DATA, _rng(seed))
        pieces = [noise(_rng(k), 30_000, NOISE_UM) for k in range(4)]
        assert all(piece.size == 30_000 for piece in pieces)
        assert np.mean([piece.std() for piece in pieces]) == pytest.approx(NOISE_UM, rel=0.3)

    def test_every_pair_of_recording_and_effect_is_drawn_once_a_seed(self):
        order = np.random.default_rng([5, 1]).permutation(len(PLANS))
        assert sorted(order) == list(range(len(PLANS)))


def _rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def _record(y: np.ndarray) -> Record:
    return Record(np.zeros(y.size), y, {}, FS, None, y[:0])


def _index(seed: int, source: str, kind: str) -> int:
    order = np.random.default_rng([seed, 1]).permutation(len(PLANS))
    return order.tolist().index(PLANS.index((source, kind)))


def test_a_delay_of_one_sample_is_taken_where_even_that_is_severe(monkeypatch):
    """A cut of a motor's record, of which a sample of delay is 62 times the noise, stopped a whole run."""
    monkeypatch.setattr(case, "severity", lambda injection, strength, source: 62.0 * strength)
    samples = SimpleNamespace(low=1, high=5, whole=True)
    assert case._strength(samples, SimpleNamespace(), 4.0) == 1.0
