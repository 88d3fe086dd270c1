"""A sticking mount is found in the readings, and nothing else is mistaken for one."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import lfilter

from tests.diagnosis.plants import NOISE_UM, Signal, Step, creep, lag, multisine, record, stairs, triangles
from tests.diagnosis.prepared import prepared
from torchpi.cli.predict import predict
from torchpi.diagnosis.chain import Chain
from torchpi.diagnosis.diagnose import diagnose
from torchpi.diagnosis.diagnosis import Diagnosis
from torchpi.diagnosis.fit import fit
from torchpi.diagnosis.hypothesis import Fit, Hypothesis
from torchpi.diagnosis.hysteresis_model import many_plays
from torchpi.diagnosis.records import prepare, seen
from torchpi.diagnosis.stick_slip import MEMORY, jump, one_step_rival, resting, slips, with_rests
from torchpi.recordings.recording import Recording

BREAKAWAY_UM, SLIDING_UM = 0.12, 0.02


def sticking(x: Signal, fs_hz: float = 0.0) -> Signal:
    """Quasi-static stick-slip: the mount stays while |x - y| < J and otherwise moves to x - d."""
    y, at = np.zeros(len(x)), 0.0
    for k, one in enumerate(x):
        if abs(one - at) >= BREAKAWAY_UM:
            at = one - SLIDING_UM * np.sign(one - at)
        y[k] = at
    return y


def recorded(after: Step, before: Step = lambda v, fs_hz: v) -> list[Recording]:
    """Record slow motion, fast motion and rests."""
    inputs = {
        "multisine": multisine(10_000, high_hz=20.0),
        "triangles": triangles(10_000, rate_hz=0.7),
        "stairs": stairs(6_000),
    }
    return [
        record(u, before=before, after=after, name=name, seed=seed)
        for seed, (name, u) in enumerate(inputs.items())
    ]


def retuned(recordings: list[Recording]) -> tuple[Chain, Fit]:
    records = prepared(recordings)
    chain = Chain(records)
    return chain, fit(chain, Hypothesis(many_plays(seen(records))))


@pytest.fixture(scope="module")
def stuck() -> tuple[list[Recording], Diagnosis]:
    torch.set_num_threads(1)
    recordings = recorded(sticking)
    return recordings, diagnose(recordings)


def test_a_sticking_mount_is_named_with_its_jump(stuck: tuple[list[Recording], Diagnosis]) -> None:
    _, found = stuck
    assert [effect.name for effect in found.effects] == ["stiction"]
    numbers = {p.name: p for p in found.effects[0].parameters}
    assert numbers["jump_um"].value == pytest.approx(BREAKAWAY_UM - SLIDING_UM, rel=0.02)
    low, high = numbers["jump_um"].interval_90 or (0.0, 0.0)
    assert low < BREAKAWAY_UM - SLIDING_UM < high
    assert any("stick-slip" in note for note in found.notes)


def test_the_reported_errors_are_those_of_the_identified_stage(
    stuck: tuple[list[Recording], Diagnosis],
) -> None:
    recordings, found = stuck
    errors = np.concatenate([r.y - predict(found.stage, r.u, {}) for r in recordings])
    told = np.sqrt(np.mean(np.concatenate([trace.residual_augmented for trace in found.traces]) ** 2))
    assert np.sqrt(np.mean(errors**2)) == pytest.approx(told, rel=0.15)
    assert found.augmented.heldout_rms_um < 1.05 * found.retuned.heldout_rms_um


@pytest.mark.parametrize(
    ("what", "before", "after"),
    [
        ("nothing", lambda v, fs_hz: v, lambda x, fs_hz: x),
        ("creep", lambda v, fs_hz: v, lambda x, fs_hz: creep(x, fs_hz, 0.02)),
        ("lag", lambda v, fs_hz: lag(v, fs_hz, 60.0), lambda x, fs_hz: x),
        ("curved sensor", lambda v, fs_hz: v, lambda x, fs_hz: x + 2e-3 * x**2),
        ("converter", lambda v, fs_hz: v, lambda x, fs_hz: 0.02 * np.round(x / 0.02)),
    ],
)
def test_no_other_effect_is_mistaken_for_slips(what: str, before: Step, after: Step) -> None:
    chain, now = retuned(recorded(after, before))
    for share in (0.5, 1.0, 2.0):  # of the noise floor, which may be stated wrongly by as much
        assert slips(chain, now, share * NOISE_UM) is None, what


def test_a_lag_of_a_few_samples_is_no_evidence_of_slips() -> None:
    """The rival predicts it from the motion of the chain, even before the chain contains a lag."""
    x = np.cumsum(np.random.default_rng(2).standard_normal(4000))
    late = lfilter([0.2, 0.3, 0.4, 0.1], [1.0], x) - x
    (one,) = prepared([Recording("a", np.arange(4000) / 1e3, x, x + late, 1e3, {})])
    (left,) = one_step_rival([one], [late])
    assert np.abs(left[MEMORY:]).max() < 1e-3 * np.abs(late).max()


@pytest.mark.parametrize("known", [True, False])
def test_a_wrong_reading_is_no_evidence_of_slips(known: bool) -> None:
    """The rival predicts the readings after it nearly as well as without it, not five times worse."""
    rng = np.random.default_rng(3)
    u, noise = np.sin(np.arange(8000) / 300), lfilter([0.1], [1.0, -0.99], rng.standard_normal(8000))
    wrong = rng.choice(8000, 40, replace=False)
    spiked = noise.copy()
    spiked[wrong] += 40 * noise.std()
    right = np.ones(8000, bool)
    right[wrong] = False
    left = []
    for e in (noise, spiked):
        (one,) = prepare([Recording("a", np.arange(8000) / 1e3, u, u + e, 1e3)], [wrong[: 40 * known]])
        left.append(one_step_rival([one], [e])[0][one.train & right])
    assert left[1].std() < 1.15 * left[0].std() < 0.2 * noise.std()
    (rests,) = (one.rests for one in with_rests([one], noise.std()) if one.rests)
    assert rests.stuck[wrong[wrong > 0]].all() == known


def test_the_steps_of_a_coarse_converter_are_not_mistaken_for_slips() -> None:
    """Noise does not dither the steps: a reading rests and jumps, while a lag keeps the chain off it."""
    lsb_um = 0.1
    recordings = [
        Recording(r.name, r.t, r.u, lsb_um * np.round(r.y / lsb_um), r.fs_hz)
        for r in recorded(lambda x, fs_hz: x, lambda v, fs_hz: lag(v, fs_hz, 60.0))
    ]
    chain, now = retuned(recordings)
    assert slips(chain, now, lsb_um / np.sqrt(12), lsb_um) is None


def test_the_jump_is_found_even_if_the_noise_floor_is_wrong_by_a_factor_of_two() -> None:
    chain, now = retuned(recorded(sticking))
    for share in (0.5, 1.0, 2.0):
        found = slips(chain, now, share * NOISE_UM)
        assert found is not None
        assert jump(found, found.fit).value_um == pytest.approx(BREAKAWAY_UM - SLIDING_UM, rel=0.02)


@given(st.lists(st.floats(-1e3, 1e3), min_size=1, max_size=60), st.floats(1e-3, 1e3))
def test_a_reading_near_the_mean_since_the_last_jump_is_at_rest(readings: list[float], least: float) -> None:
    y = np.array(readings)
    at_rest, at_um = resting(y, least)
    assert np.array_equal(at_rest, np.abs(y - at_um) <= least)
    begins = [0, *np.flatnonzero(~at_rest).tolist()]
    for k in np.flatnonzero(at_rest)[1:]:
        begin = max(b for b in begins if b < k)
        assert at_um[k] == pytest.approx(np.mean(y[begin:k]), rel=1e-9, abs=1e-9)
