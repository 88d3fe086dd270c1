"""What a linear simulation of several axes has left out."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from tests.stage.two_axes import recordings, two_axes
from torchpi.errors import RecordingError
from torchpi.identification.multi_axis import MultiAxisOptions
from torchpi.identification.multi_axis.diagnosis import (
    HYSTERESIS,
    LINEAR,
    SIMULATION,
    STAGE,
    diagnose_axes,
    loops_of,
)
from torchpi.identification.multi_axis.properties import loop_of, modes_of_stage, static_gain_of
from torchpi.stage.multi_axis import MultiAxisStage

OPTIONS = MultiAxisOptions(modes=2, extra_elements=0, times_s=(0.05,), seconds=3.0)


def test_hysteresis_is_named_and_its_stage_predicts_what_was_held_out() -> None:
    logged: list[str] = []
    found = diagnose_axes(recordings(two_axes(), (0.3, 0.6), 4), None, OPTIONS, logged.append)
    assert found.named is not None and found.named.startswith(HYSTERESIS)
    assert found.summary.startswith("The simulation leaves out hysteresis in the actuators")
    assert found.heldout == ["0.3 4", "0.6 4"]
    for level in found.levels:
        assert level.errors_um[STAGE] < 0.4 * level.errors_um[SIMULATION]
        assert level.errors_um[STAGE] < 0.5 * level.errors_um[LINEAR]
    assert any(line.startswith(f"{HYSTERESIS}: held-out error") for line in logged)


def linear(extra: float = 0.0) -> MultiAxisStage:
    stage = two_axes(force=0.0)
    with torch.no_grad():
        stage.play_weights.zero_()
        stage.poles[0, 1] += extra
    return stage


def test_of_a_linear_stage_other_numbers_are_enough() -> None:
    found = diagnose_axes(recordings(linear(), (0.3, 0.6), 3), linear(0.01), OPTIONS)
    assert found.named is None
    assert found.summary.startswith("No physics that was tried is missing")
    assert all(level.errors_um[STAGE] < 0.1 * level.errors_um[SIMULATION] for level in found.levels)
    assert found.stage.shapes.elements == 0


def test_recordings_that_do_not_fit_are_named() -> None:
    every = recordings(linear(), (0.3,), 3)
    with pytest.raises(RecordingError, match="found 2 realisations at one amplitude, expected 3 at least"):
        diagnose_axes(every[:2], None, OPTIONS)
    larger = replace(every[0], u=2 * every[0].u, name="large")
    with pytest.raises(RecordingError, match=r"large: found one realisation at .* V rms, expected two"):
        diagnose_axes([*every, larger], None, OPTIONS)
    three = [replace(one, y=np.concatenate([one.y, one.y[:, :1]], 1)) for one in every]
    with pytest.raises(RecordingError, match="found 2 inputs and 3 outputs, expected 2 and 2 as in the sim"):
        diagnose_axes(three, linear(), OPTIONS)
    slow = [replace(one, fs_hz=500.0) for one in every]
    with pytest.raises(RecordingError, match="found 500 Hz, expected 1000 Hz as in the simulation"):
        diagnose_axes(slow, linear(), OPTIONS)


def test_a_stage_says_its_loops_its_modes_and_its_coupling() -> None:
    stage = two_axes()
    assert loop_of(stage, 1, 1.0).width > 0.015
    assert loop_of(linear(), 1, 1.0).width < 0.01
    (low_hz, low_damping), (high_hz, _) = modes_of_stage(stage)
    assert (low_hz, high_hz, low_damping) == (
        pytest.approx(60.0, rel=1e-2),
        pytest.approx(110.0, rel=1e-2),
        pytest.approx(0.03, rel=1e-2),
    )
    u = torch.ones(1, 2000, 2, dtype=torch.float64) * torch.tensor([1.0, 0.0])
    expected = linear().simulate(u)[0, 1500].numpy()
    np.testing.assert_allclose(static_gain_of(linear(), 0.5)[:, 0], expected, rtol=1e-3)


def test_a_loop_without_a_bounded_answer_is_none() -> None:
    driven = two_axes()
    driven.arrays()["weights"][:, -1] = 10.0
    assert loops_of(driven, 1.0) == [None, None]
    assert all(loops_of(two_axes(), 0.3))
