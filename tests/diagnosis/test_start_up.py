"""A recording that begins before the stage has settled: which readings count."""

import numpy as np
import pytest
from scipy.signal import lfilter

from tests.diagnosis.plants import NOISE_UM as PLANT_NOISE_UM
from tests.diagnosis.plants import multisine, record
from tests.diagnosis.prepared import prepared
from torchpi.diagnosis import diagnose
from torchpi.diagnosis.records import without_start
from torchpi.diagnosis.start_up import unsettled

SAMPLES = 4000
NOISE = 0.01 * np.random.default_rng(3).standard_normal(SAMPLES)
RING = np.exp(-np.arange(SAMPLES) / 4.0) * np.cos(np.arange(SAMPLES))


@pytest.mark.parametrize(
    ("left", "count"),
    [
        (NOISE, (0, 0)),
        (NOISE + 2.0 * RING, (20, 80)),  # switched on before the first sample
        (NOISE + 2.0 * np.roll(RING, 5), (0, 0)),  # the response to a recorded voltage
        (NOISE + 2.0 * np.exp(-np.arange(SAMPLES) / 200.0), (0, 0)),  # as slow as creep
    ],
)
def test_only_a_short_transient_that_begins_at_the_first_reading_is_left_out(
    left: np.ndarray, count: tuple[int, int]
) -> None:
    (found,) = unsettled(prepared([record(multisine(SAMPLES))]), [left])
    assert count[0] <= found <= count[1]


def test_start_up_readings_count_neither_in_a_fit_nor_in_an_error() -> None:
    one, other = prepared([record(multisine(SAMPLES)), record(multisine(SAMPLES, 900.0))])
    cut, same = without_start([one, other], [30, 0])
    assert same is other
    assert not cut.train[:30].any() and not cut.held_out[:30].any()
    assert np.array_equal(cut.train[30:], one.train[30:]) and np.array_equal(cut.held_out, one.held_out)
    spoilt = cut.y.copy()
    spoilt[:30] += 5.0
    assert np.array_equal(cut.coefficients(spoilt[None]), cut.coefficients(cut.y[None]))


def test_a_step_before_the_recording_does_not_hide_a_lag_and_is_reported() -> None:
    def late(x: np.ndarray, fs_hz: float) -> np.ndarray:
        return np.asarray(lfilter([0.3], [1, -0.7], x)) + 3.0 * RING

    found = diagnose([record(multisine(SAMPLES), after=late)])
    names = {name for effect in found.effects for name in (effect.name, *effect.alternatives)}
    assert names & {"amplifier_lag", "sensor_lag"}
    assert found.verdict == "explained" and found.augmented.train_rms_um < 1.2 * PLANT_NOISE_UM
    begun = next(cell for cell in found.where if cell.domain == "time" and cell.range[0] == 0.0)
    assert begun.share < 0.3
    assert any("settling after a motion before the recording" in note for note in found.notes)
