"""Diagnosis of the physics that a linear simulation of several axes lacks."""

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


def test_hysteresis_is_named_and_its_stage_predicts_the_held_out_recordings() -> None:
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


def test_a_linear_stage_with_wrong_parameters_lacks_no_physics() -> None:
    found = diagnose_axes(recordings(linear(), (0.3, 0.6), 3), linear(0.01), OPTIONS)
    assert found.named is None
    assert found.summary.startswith("None of the effects that were tried is missing")
    assert all(level.errors_um[STAGE] < 0.1 * level.errors_um[SIMULATION] for level in found.levels)
    assert found.stage.shapes.elements == 0


def test_unsuitable_recordings_are_refused_with_the_reason() -> None:
    every = recordings(linear(), (0.3,), 3)
    with pytest.raises(RecordingError, match="found 2 realisations at one amplitude, expected at least 3"):
        diagnose_axes(every[:2], None, OPTIONS)
    larger = replace(every[0], u=2 * every[0].u, name="large")
    with pytest.raises(RecordingError, match=r"large: found one realisation at .*, expected at least two"):
        diagnose_axes([*every, larger], None, OPTIONS)
    three = [replace(one, y=np.concatenate([one.y, one.y[:, :1]], 1)) for one in every]
    with pytest.raises(RecordingError, match="found 2 inputs and 3 outputs, expected 2 and 2 as in the sim"):
        diagnose_axes(three, linear(), OPTIONS)
    slow = [replace(one, fs_hz=500.0) for one in every]
    with pytest.raises(RecordingError, match="found 500 Hz, expected 1000 Hz as in the simulation"):
        diagnose_axes(slow, linear(), OPTIONS)


def test_loops_modes_and_static_coupling_are_computed_from_a_stage() -> None:
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


def test_a_loop_is_none_if_the_response_is_unbounded() -> None:
    driven = two_axes()
    driven.arrays()["weights"][:, -1] = 10.0
    assert loops_of(driven, 1.0) == [None, None]
    assert all(loops_of(two_axes(), 0.3))
