"""How well each recording is predicted by a fit without it, compared with the fit to all recordings."""

from dataclasses import replace

import numpy as np
import pytest

from tests.diagnosis.plants import FS_HZ, NOISE_UM, lag, multisine, triangles
from tests.diagnosis.prepared import prepared
from torchpi.diagnosis.across_recordings import across_recordings
from torchpi.diagnosis.chain import Chain
from torchpi.diagnosis.fit import fit
from torchpi.diagnosis.hypothesis import EffectTerm, Fit, Hypothesis
from torchpi.diagnosis.hysteresis_model import many_plays, preisach
from torchpi.diagnosis.records import seen
from torchpi.diagnosis.reduced_basis import MANY, basis
from torchpi.diagnosis.score import Weighting
from torchpi.recordings.recording import Recording
from torchpi.stage.effects.sensor.sensor_lag import SensorLag

SAMPLES = 6000
STEPS = np.repeat(np.random.default_rng(3).choice([0.0, 10.0], SAMPLES // 500), 500)


def recorded(*voltages: np.ndarray, bend: float = 0.8) -> list[Recording]:
    """Record four plays, two of them through a curve, with a separate offset in each recording."""
    rng, made = np.random.default_rng(1), []
    r, weights = np.array([0.0, 0.7, 2.3, 4.1]), np.array([0.5, 0.3, 0.2, 0.2])
    for k, u in enumerate(voltages):
        y, h = np.empty(len(u)), np.zeros(len(r))
        for tick, v in enumerate(u):
            h = np.maximum(v - r, np.minimum(v + r, h))
            y[tick] = weights @ h + bend * (h[2] ** 2 + h[3] ** 2) / 100 + 0.1 * k
        noise = rng.normal(0, NOISE_UM, len(u))
        made.append(Recording("abc"[k], np.arange(len(u)) / FS_HZ, u, y + noise, FS_HZ))
    return made


def fitted(chain: Chain, hypothesis: Hypothesis) -> Fit:
    now = fit(chain, *basis(chain, hypothesis, None, MANY))
    chain.weighting = Weighting.of(chain.records, now.residuals, None)
    return fit(chain, now.hypothesis, now.weights)


def test_recordings_of_one_kind_predict_one_another() -> None:
    chain = Chain(prepared(recorded(*(multisine(SAMPLES, high_hz=40.0, seed=k) for k in (1, 2, 3)))))
    found = across_recordings(chain, fitted(chain, Hypothesis(preisach(seen(chain.records)))))
    assert [one.recording for one in found] == ["a", "b", "c"]
    assert all(one.predicted and one.fitted_rms_um < 1.3 * NOISE_UM for one in found)


def test_steps_between_two_levels_do_not_predict_minor_loops() -> None:
    chain = Chain(prepared(recorded(STEPS, multisine(SAMPLES, high_hz=40.0))))
    steps, loops = across_recordings(chain, fitted(chain, Hypothesis(preisach(seen(chain.records)))))
    assert loops.fitted_rms_um < 1.3 * NOISE_UM
    assert loops.rms_um > 5 * loops.fitted_rms_um and not loops.predicted
    assert steps.rms_um < loops.rms_um


@pytest.mark.parametrize("left_out", [0, 1])
def test_the_reported_error_is_that_of_a_fit_without_the_recording(left_out: int) -> None:
    """The fit uses the other recording only; the zero is taken from the left-out recording itself."""
    records = prepared(recorded(triangles(SAMPLES), multisine(SAMPLES, high_hz=40.0)))
    chain = Chain(records)
    final = fitted(chain, Hypothesis(many_plays(seen(records))))
    alone = Chain([records[1 - left_out]], Weighting.flat([records[1 - left_out]]))
    kept = chain.weighting.inverse_sd[1 - left_out]
    alone.weighting = replace(alone.weighting, inverse_sd=(kept,))
    hypothesis, _ = basis(chain, final.hypothesis, None, MANY)
    other = fit(alone, hypothesis)
    record = records[left_out]
    shape = hypothesis.nominal.output(record.u, record.period_s, other.weights[: hypothesis.nominal.kept])
    left = record.y - shape
    expected = float(np.std(left[record.train | record.held_out]))
    assert across_recordings(chain, final)[left_out].rms_um == pytest.approx(expected, rel=0.02)


def test_a_recording_is_predicted_even_if_only_that_recording_reveals_a_lag() -> None:
    """Triangles do not reveal a lag, so the parameters of effects are kept when a recording is left out."""
    made = [
        replace(one, y=lag(one.y, FS_HZ, 150.0))
        for one in recorded(triangles(SAMPLES), multisine(SAMPLES, high_hz=40.0), bend=0.0)
    ]
    chain = Chain(prepared(made))
    hypothesis = Hypothesis(many_plays(seen(chain.records))).plus(EffectTerm(SensorLag, {"cutoff_hz": 100.0}))
    final = fitted(chain, hypothesis)
    assert final.train_rms < 1.3 * NOISE_UM
    assert all(one.predicted for one in across_recordings(chain, final))


def test_only_recordings_within_the_voltage_range_of_the_others_are_predicted() -> None:
    """A rest recorded to measure the noise cannot predict a motion."""
    moves, rests = multisine(SAMPLES, high_hz=40.0), np.full(SAMPLES, 5.0)
    for voltages, expected in (
        ((moves,), []),
        ((moves, rests), []),
        ((moves, 0.8 * moves), ["b"]),
        ((moves, 0.95 * moves), ["a", "b"]),
    ):
        chain = Chain(prepared(recorded(*voltages)))
        final = fitted(chain, Hypothesis(many_plays(seen(chain.records))))
        assert [one.recording for one in across_recordings(chain, final)] == expected
