"""What `predict` says of a reference that the compensator cannot follow."""

import numpy as np
import pytest

from torchpi import Compensator, DirectInverse
from torchpi.errors import RecordingError, RecordingWarning

SECONDS = np.arange(2000) / 1000
REFERENCE = 3 - 3 * np.cos(2 * np.pi * SECONDS)  # µm


@pytest.fixture
def compensator() -> Compensator:
    """1 µm/V: 10 µm are reached, 8 µm were recorded."""
    trained = {
        "range_um": (0.0, 8.0), "rates_um_s": (-30.0, 30.0), "voltages_v": (0.0, 10.0),
        "voltage_rates_v_s": (-30.0, 30.0),
    }  # fmt: skip
    inverse = DirectInverse(1e-3, [0.0], degree=1, rate="none", trained=trained).requires_grad_(False)
    inverse.weights.theta[0, 0] = 1.0
    return Compensator(inverse)


def test_a_reference_that_is_reached_gives_its_voltage_without_a_word(compensator: Compensator) -> None:
    assert np.allclose(compensator.predict(REFERENCE), REFERENCE)
    assert np.allclose(compensator.predict(np.zeros(5)), 0.0)


@pytest.mark.parametrize(("factor", "largest"), [(1e3, "6000"), (3.0, "18"), (-1.0, "-6")])
def test_a_reference_beyond_what_is_reached_is_refused(
    compensator: Compensator, factor: float, largest: str
) -> None:
    message = f"reference_um: sample 500 is {largest} µm, outside the range of this compensator, 0 to 10 µm"
    with pytest.raises(RecordingError, match=message):
        compensator.predict(factor * REFERENCE)


def test_a_reference_in_mm_is_warned_of(compensator: Compensator) -> None:
    with pytest.warns(RecordingWarning, match=r"goes no further than 0\.006 µm .*; if it is in mm, multiply"):
        compensator.predict(1e-3 * REFERENCE)


def test_samples_beyond_the_recordings_are_counted(compensator: Compensator) -> None:
    with pytest.warns(
        RecordingWarning, match="of 2000 samples lie beyond the displacements or rates recorded"
    ):
        compensator.predict(1.4 * REFERENCE)
    with pytest.warns(RecordingWarning, match=r"1 of 101 samples lie beyond .*, 1 of them were held back"):
        compensator.predict(np.r_[REFERENCE[:100], 5.0])
