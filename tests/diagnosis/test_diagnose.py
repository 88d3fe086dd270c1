"""From recordings to a diagnosis: effects that are present are named, and no others."""

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
import torch
from scipy.signal import lfilter

from tests.diagnosis.plants import (
    FS_HZ,
    NOISE_UM,
    creep,
    multisine,
    pair,
    record,
    resonance,
    stairs,
    triangles,
)
from tests.diagnosis.prepared import prepared
from torchpi.diagnosis import long_recordings
from torchpi.diagnosis.chain import Chain
from torchpi.diagnosis.diagnose import diagnose
from torchpi.diagnosis.diagnosis import Diagnosis
from torchpi.diagnosis.fit import fit
from torchpi.diagnosis.hypothesis import EffectTerm, Hypothesis
from torchpi.diagnosis.hysteresis_model import many_plays
from torchpi.diagnosis.notes import history_notes
from torchpi.diagnosis.records import seen
from torchpi.diagnosis.reduced_basis import reduced
from torchpi.diagnosis.search import Search
from torchpi.diagnosis.wrong_readings import (
    error_about,
    expected_beyond,
    no_tail,
    off_all_around,
    wrong_readings,
)
from torchpi.recordings.faults import dropouts
from torchpi.recordings.identity import recordings_sha256
from torchpi.recordings.recording import Recording
from torchpi.stage import Stage
from torchpi.stage.beside import difference
from torchpi.stage.effects.amplifier.delay import Delay

MODE = (310.0, 0.03)


def ringing(x: np.ndarray, fs_hz: float) -> np.ndarray:
    return resonance(x, fs_hz, *MODE)


@pytest.fixture(scope="module")
def of_a_mode() -> tuple[list[Recording], Diagnosis]:
    torch.set_num_threads(1)
    recordings = pair(3000, after=ringing)
    return recordings, diagnose(recordings)


def names(found: Diagnosis) -> list[str]:
    return [effect.name for effect in found.effects]


def test_nothing_is_named_where_nothing_is_missing() -> None:
    found = diagnose(pair(3000))
    assert found.verdict == "nothing_missing" and found.effects == ()
    assert found.augmented.heldout_rms_um < 1.1 * NOISE_UM
    assert "Nothing is missing" in found.says


def test_a_mode_is_named_with_its_frequency_and_damping(of_a_mode: tuple[list[Recording], Diagnosis]) -> None:
    _, found = of_a_mode
    assert found.verdict == "explained" and names(found) == ["resonance"]
    (effect,) = found.effects
    assert {p.name: p.value for p in effect.parameters} == pytest.approx(
        {"frequency_hz": MODE[0], "damping_ratio": MODE[1]}, rel=0.05
    )
    assert effect.probability > 0.9 and effect.share > 0.9
    for parameter in effect.parameters:
        low, high = parameter.interval_90 or (0.0, 0.0)
        assert low < parameter.value < high
    assert found.augmented.heldout_rms_um < 1.1 * NOISE_UM < 0.5 * found.retuned.heldout_rms_um
    assert "resonance" in found.says


def test_the_stage_recognises_the_recordings_of_a_compensator_that_held_one_out(
    of_a_mode: tuple[list[Recording], Diagnosis],
) -> None:
    recordings, found = of_a_mode
    assert found.stage.identified is not None
    assert found.stage.identified.recordings_sha256 == recordings_sha256(recordings)
    assert difference(found.stage, recordings_sha256(recordings)) is None
    assert difference(found.stage, recordings_sha256(recordings[:-1])) is None
    others = pair(200, after=ringing)
    assert "different recordings" in str(difference(found.stage, recordings_sha256(others)))


def test_the_residual_is_located_at_the_mode(of_a_mode: tuple[list[Recording], Diagnosis]) -> None:
    _, found = of_a_mode
    cells = [cell for cell in found.where if cell.domain == "frequency"]
    loudest = max(cells, key=lambda cell: cell.share)
    assert loudest.range[0] < 400 and loudest.range[1] > 150


def test_the_identified_stage_predicts_an_unseen_recording_to_the_noise(
    of_a_mode: tuple[list[Recording], Diagnosis], tmp_path: Path
) -> None:
    _, found = of_a_mode
    found.stage.save(tmp_path / "stage.pt")
    stage = Stage.load(tmp_path / "stage.pt")
    other = record(multisine(4000, seed=9), after=ringing)
    with torch.no_grad():
        y = stage.at_sample_rate(FS_HZ)(torch.from_numpy(other.u)[None])[0][0].numpy()
    assert np.sqrt(np.mean((other.y - y) ** 2)) < 1.15 * NOISE_UM


def test_recordings_at_two_sample_rates_yield_one_stage() -> None:
    found = diagnose(
        [
            record(multisine(2500), after=ringing, name="slow"),
            record(triangles(5000, fs_hz=5000.0), after=ringing, fs_hz=5000.0, seed=3, name="fast"),
        ]
    )
    assert names(found) == ["resonance"]
    assert found.effects[0].parameters[0].value == pytest.approx(MODE[0], rel=0.01)
    assert found.stage.sample_rate_hz == pytest.approx(5000.0)


def test_a_missing_input_is_found_in_its_auxiliary_column() -> None:
    other = 3 * lfilter([0.1], [1, -0.9], np.random.default_rng(5).standard_normal((2, 2500)))
    idle = np.random.default_rng(6).standard_normal((2, 2500))
    us = (multisine(2500), triangles(2500))
    recordings = [
        record(u, after=lambda x, fs_hz, a=a: x + 0.05 * a, aux={"aux_2": a, "aux_3": b}, name=name, seed=i)
        for i, (u, a, b, name) in enumerate(zip(us, other, idle, "ab", strict=True))
    ]
    found = diagnose(recordings)
    assert names(found) == ["cross_coupling"]
    assert found.effects[0].parameters[0].value == pytest.approx(0.05, rel=0.01)
    assert found.stage.aux_names == ("aux_2",)


def test_every_step_is_logged() -> None:
    said: list[str] = []
    diagnose([record(multisine(1000))], log=said.append)
    assert [
        word for word in ("nominal", "round", "decide", "model", "locate") if not any(word in s for s in said)
    ] == []


def test_a_repeated_diagnosis_gives_the_same_answer() -> None:
    recordings = [record(multisine(1500))]
    first, second = diagnose(recordings), diagnose([replace(one, y=one.y.copy()) for one in recordings])
    assert first.says == second.says and json.dumps(first.notes) == json.dumps(second.notes)


def test_creep_is_tried_even_if_the_displacement_is_modelled_as_held() -> None:
    chain = Chain(prepared(pair(2000, after=lambda x, fs_hz: creep(x, fs_hz, 0.05))))
    search = Search(chain, lambda sentence: None)
    stepped = reduced(chain, fit(chain, Hypothesis(many_plays(search.seen), held=True)))
    assert "creep" in dict(search.effects(stepped))


def test_a_reading_within_the_recent_motion_is_late_and_one_outside_it_is_wrong() -> None:
    model = np.concatenate([np.zeros(50), np.full(50, 8.0)])
    late, wrong = model.copy(), model.copy()
    late[52], wrong[70], wrong[30] = 3.0, 3.0, -5.0
    assert off_all_around(late, late - model, np.array([52])) < 0
    np.testing.assert_allclose(off_all_around(wrong, wrong - model, np.array([30, 70])), 5.0)


def test_the_first_swing_of_an_unmodelled_ring_is_not_a_wrong_reading() -> None:
    noise = 0.01 * np.random.default_rng(0).standard_normal(400)
    ringing = noise + np.where(np.arange(400) < 200, 0.0, np.cos(2.1 * (np.arange(400) - 200)))
    lone = noise.copy()
    lone[200] += 1.0
    k = np.array([200])
    assert error_about(ringing, k) > 0.3 and error_about(lone, k) < 0.02


def test_two_pole_creep_is_named_creep_and_not_drift() -> None:
    def two_poles(x: np.ndarray, fs_hz: float) -> np.ndarray:
        for gain, tau_s in ((0.03, 0.3), (0.03, 5.0)):
            a = np.exp(-1 / (fs_hz * tau_s))
            x = x + gain * lfilter([0.5 * (1 - a), 0.5 * (1 - a)], [1, -a], x)
        return x

    rig = {"after": two_poles, "fs_hz": 500.0}
    u = stairs(4000), triangles(4000, 0.7, 500.0)
    found = diagnose([record(one, **rig, seed=k, name="ab"[k]) for k, one in enumerate(u)])
    assert names(found) == ["creep"]
    assert found.augmented.heldout_rms_um < 1.3 * NOISE_UM


@pytest.mark.parametrize("freedom", [3.0, 5.0, 1e6])
def test_the_expected_number_of_outliers_matches_a_heavy_tailed_distribution(freedom: float) -> None:
    error = np.abs(np.random.default_rng(1).standard_t(freedom, 40_000))
    limit = np.quantile(error, [0.999])
    assert expected_beyond(limit, error) == pytest.approx(40, rel=0.5)
    lost = np.concatenate([error, np.full(40, 1e3)])
    assert expected_beyond(np.array([1e3]), lost) < 0.01


def test_dropouts_change_neither_the_held_out_error_nor_the_held_out_samples() -> None:
    whole = pair(2000)
    wrong = [replace(one, y=one.y.copy()) for one in whole]
    for one in wrong:
        one.y[[300, 700, 1100, 1950]] += 20.0
    found, clean = diagnose(wrong, effects=[]), diagnose(whole, effects=[])
    assert [effect.name for effect in found.effects] == ["dropouts"]
    assert found.retuned.heldout_rms_um == pytest.approx(clean.retuned.heldout_rms_um, rel=0.05)
    for trace in found.traces:
        assert np.array_equal(trace.heldout, np.arange(2000) >= 1700)


def test_wrong_readings_are_found_beside_a_temporary_model_error() -> None:
    """A bump of a second is no tail of the noise, however large: single readings stand out from it."""
    rig = [record(multisine(8000), name="a", after=lambda x, fs_hz: x + bump(len(x)))]
    rig[0].y[[300, 900, 2700, 4100]] += 20.0
    assert "dropouts" in [effect.name for effect in diagnose(rig, effects=[]).effects]


def test_readings_left_out_without_being_named_are_counted_in_a_note() -> None:
    """Of a tail as heavy as Cauchy's, readings that stand apart are left out, but not named."""
    tail = NOISE_UM * np.random.default_rng(1).standard_t(1.0, 4000)
    found = diagnose([record(multisine(4000), name="a", after=lambda x, fs_hz: x + tail)], effects=[])
    assert "dropouts" not in [effect.name for effect in found.effects]
    assert any("a: readings that do not count because they stand apart" in note for note in found.notes)
    quiet = diagnose([record(multisine(4000), name="a")], effects=[])
    assert not any("stand apart" in note for note in quiet.notes)


def test_zeros_in_a_motion_as_fast_as_the_sampling_are_wrong_readings() -> None:
    """Each zero lies between its neighbours and is recognised only because the same value recurs."""
    rig = [record(np.random.default_rng(0).uniform(0, 9, 4000), name="a")]
    clean = diagnose(rig, effects=[])
    lost = np.arange(50, 4000, 60)
    rig[0].y[lost] = 0.0
    found = diagnose(rig, effects=[])
    (effect,) = found.effects
    assert effect.name == "dropouts"
    assert effect.parameters[0].value == pytest.approx(len(lost) / 4000, rel=0.02)
    assert found.retuned.train_rms_um < 2 * clean.retuned.train_rms_um


def test_wrong_readings_in_a_fast_motion_are_seen_in_the_residual_and_left_out_of_the_fit() -> None:
    rig = [record(np.random.default_rng(0).uniform(0, 9, 4000), name="a")]
    clean = diagnose(rig, effects=[])
    lost = np.arange(100, 4000, 300)
    rig[0].y[lost] += np.resize([8.0, -8.0], len(lost))
    assert len(dropouts(rig[0].y, rig[0].u)) < len(lost) / 2
    found = diagnose(rig, effects=[])
    (effect,) = found.effects
    assert effect.name == "dropouts" and effect.parameters[0].value == pytest.approx(len(lost) / 4000)
    assert found.retuned.train_rms_um == pytest.approx(clean.retuned.train_rms_um, rel=0.02)


@pytest.mark.parametrize(("outside", "within"), [(10, 3), (3, 10)])
def test_readings_within_the_recent_motion_may_be_late_unless_most_others_lie_outside(
    outside: int, within: int
) -> None:
    rng, n = np.random.default_rng(3), 20_000
    motion, places = rng.uniform(-1, 1, n), np.arange(500, n, 1000)
    residual = 1e-3 * rng.normal(size=n)
    residual[places[:outside]] = 5.0
    inside = places[outside : outside + within]
    residual[inside] = motion[inside - 2] - motion[inside]
    every = np.ones(n, dtype=bool)
    rig = SimpleNamespace(u=motion, y=motion + residual, train=every, held_out=~every)
    final = SimpleNamespace(residuals=[residual])
    (found,) = wrong_readings([rig], [np.zeros(0, dtype=int)], final)
    assert found.tolist() == places[: 13 if outside > within else outside].tolist()


@pytest.mark.parametrize("missing", [False, True])
def test_readings_that_were_filled_in_are_not_wrong(missing: bool) -> None:
    rng, n = np.random.default_rng(3), 20_000
    residual, off, counts = 1e-3 * rng.normal(size=n), np.arange(100, n, 900), np.ones(n, dtype=bool)
    residual[off], counts[off] = 2.0, not missing
    motion = 0.1 * np.sin(np.arange(n) / 500)
    rig = SimpleNamespace(u=motion, y=motion + residual, train=counts, held_out=np.zeros(n, dtype=bool))
    final = SimpleNamespace(residuals=[residual])
    (found,) = wrong_readings([rig], [np.zeros(0, dtype=int)], final)
    assert found.tolist() == ([] if missing else off.tolist())


@pytest.mark.parametrize("heavy", [False, True])
def test_a_recording_with_a_larger_residual_is_not_taken_for_a_tail_of_the_noise(heavy: bool) -> None:
    """One reading is off by twenty times the residual of fast motion; none if the sensor has heavy tails."""
    rng, n = np.random.default_rng(3), 20_000
    quiet, loud = 1e-3 * rng.normal(size=n), 0.1 * np.sin(1.7 * np.arange(n)) * rng.normal(1.0, 0.1, n)
    if heavy:
        quiet, loud = 1e-3 * rng.standard_t(1.0, n), 1e-3 * rng.standard_t(1.0, n)
    loud[7000] = 2.0
    motion = 0.1 * np.sin(np.arange(n) / 500)
    counts = {"train": np.ones(n, dtype=bool), "held_out": np.zeros(n, dtype=bool)}
    records = [SimpleNamespace(u=motion, y=motion + each, **counts) for each in (quiet, loud)]
    final = SimpleNamespace(residuals=[quiet, loud])
    found = wrong_readings(records, [np.zeros(0, dtype=int), np.array([7000])], final)
    assert [each.tolist() for each in found] == [[], [] if heavy else [7000]]


def test_a_reading_far_beyond_a_heavy_tail_is_wrong_and_the_tail_itself_is_not() -> None:
    """Readings that stand out together are a tail; one that is not part of it must not be hidden by it."""
    rest = np.abs(np.random.default_rng(1).standard_t(3.0, 40_000))
    tail = np.sort(rest)[-30:]
    assert no_tail(tail, rest) == np.inf
    assert no_tail(np.append(tail, 3000.0), rest) == 3000.0
    assert no_tail(np.append(tail, [2000.0, 3000.0]), rest) == 2000.0
    assert no_tail(np.zeros(3), rest) == np.inf


def test_bursts_that_end_hide_no_wrong_readings_beyond_them() -> None:
    """A motor's friction makes one reading in thirty up to thirty times as large, but none larger."""
    rng = np.random.default_rng(1)
    rest = np.where(rng.random(20_000) < 0.03, rng.uniform(0, 30, 20_000), np.abs(rng.normal(size=20_000)))
    bursts = np.sort(rest)[-20:]
    assert no_tail(bursts, rest) == np.inf
    assert no_tail(np.append(bursts, np.full(6, 100.0)), rest) == 100.0


@pytest.mark.parametrize("freedom", [1.5, 3.0, 1e6])
def test_the_largest_of_heavy_tailed_noise_are_no_wrong_readings(freedom: float) -> None:
    for seed in range(20):
        rest = np.abs(np.random.default_rng(seed).standard_t(freedom, 16_000))
        assert no_tail(np.sort(rest)[-20:], rest) == np.inf


def bump(samples: int) -> np.ndarray:
    return 4.0 * np.exp(-(((np.arange(samples) - 0.7 * samples) / (0.05 * samples)) ** 2))


def test_the_converter_step_is_that_of_the_readings_and_not_of_their_means(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(long_recordings, "AT_MOST", 9000)
    lsb_um = 0.31
    read = [replace(one, y=lsb_um * np.round(one.y / lsb_um)) for one in pair(8000)]
    (found,) = diagnose(read, effects=[]).effects
    assert found.name == "quantization"
    assert found.parameters[0].value == pytest.approx(lsb_um, rel=1e-6)


@pytest.mark.parametrize(("share", "names"), [(0.3, ["quantization"]), (0.12, [])])
def test_quantisation_is_named_from_a_fifth_of_the_noise_on(share: float, names: list[str]) -> None:
    lsb_um = share * np.sqrt(12) * NOISE_UM
    read = [replace(one, y=lsb_um * np.round(one.y / lsb_um)) for one in pair(4000)]
    found = diagnose(read, effects=[])
    assert [effect.name for effect in found.effects] == names
    assert any("grid" in note for note in found.notes)


def test_a_remaining_tone_is_not_called_noise() -> None:
    """The tone lies above the mains harmonics, where no effect on the list can model it."""

    def tone(x: np.ndarray, fs_hz: float) -> np.ndarray:
        return x + 2 * NOISE_UM * np.sin(2 * np.pi * 762.0 * np.arange(len(x)) / fs_hz)

    found = diagnose([record(multisine(4000), after=tone)])
    assert found.verdict == "unexplained" and found.effects == ()
    assert "at 762 Hz" in found.says and "Nothing is missing" not in found.says


def test_what_was_retuned_is_noted_for_the_numbers_that_the_fitted_form_still_has() -> None:
    chain = Chain(prepared([record(multisine(500))]))
    before = EffectTerm(Delay, {"delay_s": 5e-5, "after_lag": 1.0})
    h = Hypothesis(many_plays(seen(chain.records)), (EffectTerm(Delay, {"delay_s": 1e-4}),))
    search = cast(Search, SimpleNamespace(start=[before], left_out=[]))
    assert history_notes(search, fit(chain, h, iterations=0)) == ("Retuned: delay delay_s 5e-05 → 0.0001.",)
