"""How `predict` responds to a reference that the compensator cannot follow."""

import numpy as np
import pytest

from torchpi import Compensator, DirectInverse
from torchpi.errors import RecordingError, RecordingWarning

SECONDS = np.arange(2000) / 1000
REFERENCE = 3 - 3 * np.cos(2 * np.pi * SECONDS)  # µm


@pytest.fixture
def compensator() -> Compensator:
    """A compensator of 1 µm/V that reaches 10 µm, of which 8 µm were recorded."""
    trained = {
        "range_um": (0.0, 8.0),
        "rates_um_s": (-30.0, 30.0),
        "voltages_v": (0.0, 10.0),
        "voltage_rates_v_s": (-30.0, 30.0),
    }
    inverse = DirectInverse(1e-3, [0.0], degree=1, rate="none", trained=trained).requires_grad_(False)
    inverse.weights.theta[0, 0] = 1.0
    return Compensator(inverse)


def test_a_reachable_reference_gives_its_voltage_without_a_warning(compensator: Compensator) -> None:
    assert np.allclose(compensator.predict(REFERENCE), REFERENCE)
    assert np.allclose(compensator.predict(np.zeros(5)), 0.0)


@pytest.mark.parametrize(("factor", "largest"), [(1e3, "6000"), (3.0, "18"), (-1.0, "-6")])
def test_an_unreachable_reference_is_refused(compensator: Compensator, factor: float, largest: str) -> None:
    message = f"reference_um: sample 500 is {largest} µm, outside the range of this compensator, 0 to 10 µm"
    with pytest.raises(RecordingError, match=message):
        compensator.predict(factor * REFERENCE)


def test_a_reference_in_mm_causes_a_warning(compensator: Compensator) -> None:
    with pytest.warns(RecordingWarning, match=r"reaches only 0\.006 µm .*; if it is in mm, multiply"):
        compensator.predict(1e-3 * REFERENCE)


def test_samples_beyond_the_recorded_range_are_counted_in_a_warning(compensator: Compensator) -> None:
    with pytest.warns(
        RecordingWarning, match="of 2000 samples lie beyond the recorded displacements or rates"
    ):
        compensator.predict(1.4 * REFERENCE)
    with pytest.warns(RecordingWarning, match=r"1 of 101 samples lie beyond .*, 1 of them were held back"):
        compensator.predict(np.r_[REFERENCE[:100], 5.0])
