"""Diagnoses of third-party recordings say what is known of these, and nothing that cannot be known.

The recordings lie beside a checkout in `../shared/data`, with their licences.
"""

from pathlib import Path

import numpy as np
import pytest

from torchpi import RecordingOptions, read_recording
from torchpi.diagnosis.diagnose import diagnose
from torchpi.diagnosis.diagnosis import Diagnosis
from torchpi.recordings.recording import Recording

DATA = Path(__file__).parents[2].parent / "shared" / "data"
STATIC = {"hysteresis_operator", "rate_dependent_hysteresis", "backlash", "stiction"}
LATE = {"amplifier_lag", "sensor_lag", "delay"}

needs_data = pytest.mark.skipif(not DATA.is_dir(), reason="the real recordings are not beside this checkout")


def groups(found: Diagnosis) -> list[set[str]]:
    return [{effect.name, *effect.alternatives} for effect in found.effects]


@needs_data
def test_a_current_loop_is_late_and_has_no_hysteresis() -> None:
    """Commanded to measured current, A as V and µm: about 0.48 ms late, 0.86 of the gain at 250 Hz."""
    bench = np.load(DATA / "motor_bench" / "type_a.npz")
    fs_hz, period = float(bench["fs_hz"]), int(bench["period"])
    some = slice(period, 11 * period // 5)
    u, y = (bench[name].ravel()[some].astype(float) for name in ("iq_ref_a", "iq_a"))
    found = diagnose([Recording("type_a", np.arange(len(u)) / fs_hz, u, y, fs_hz)])
    assert any(LATE & group for group in groups(found))
    assert not STATIC & {effect.name for effect in found.effects}


@needs_data
def test_a_stack_under_a_sine_shows_creep_and_lateness_but_no_rate_dependence() -> None:
    """The authors' piezo stack under a 1 Hz sine creeps or drifts by half a micrometre and is late. The
    generator was switched on just before the first sample."""
    columns = RecordingOptions(None, 1, 5, fs_hz=200, zero="first")
    whole = read_recording(DATA / "piezo_stack" / "Model_Vi_Do.dat", columns)
    found = diagnose([whole])
    assert any({"creep", "thermal_drift"} & group for group in groups(found))
    assert LATE & {one.name for one in (*found.effects, *found.open)}
    assert any("the first 18 readings" in note for note in found.notes)
    assert "rate_dependent_hysteresis" not in {effect.name for effect in found.effects}
    assert found.augmented.heldout_rms_um < 0.1 < 0.3 < found.retuned.heldout_rms_um
