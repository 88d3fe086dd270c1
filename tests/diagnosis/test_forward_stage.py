"""A forward stage identified from recordings predicts unseen motions and gains no absent effect."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
import torch

from torchpi.diagnosis.forward_stage import ForwardStage, free_run_error, identify_stage
from torchpi.errors import RecordingError
from torchpi.recordings.identity import recordings_sha256
from torchpi.recordings.recording import Recording
from torchpi.stage import Stage

RATE_HZ = 2000.0
NOISE_UM = 0.002
PLAYS = {"thresholds_v": [0.0, 0.2, 0.6, 1.4, 2.5], "weights": [0.5, 0.05, 0.08, 0.08, 0.06, 0.0]}
MODE = {"name": "resonance", "values": {"frequency_hz": 150.0, "damping_ratio": 0.05}}
DELAY = {"name": "delay", "values": {"delay_s": 1.2e-3}}


def rig(*effects: dict) -> Stage:
    return Stage(RATE_HZ, PLAYS, effects, noise_um=NOISE_UM, min_voltage_v=0.0, max_voltage_v=10.0)


def recorded(stage: Stage, seed: int, seconds: float = 2.0, high_hz: float = 60.0) -> Recording:
    """Record a random voltage from 0 V with many reversals, and the readings of the sensor."""
    t = np.arange(round(seconds * RATE_HZ)) / RATE_HZ
    random = np.random.default_rng(seed)
    lines = random.uniform(1.0, high_hz, 12)
    wave = np.sin(2 * np.pi * lines[:, None] * t + random.uniform(0, 2 * np.pi, (12, 1))).sum(0)
    u = 5 * (1 + wave / np.abs(wave).max()) * (1 - np.exp(-t / 0.05))
    _, y = stage.simulate(torch.from_numpy(u)[None], seed)
    return Recording(f"r{seed}", t, u, y[0].detach().numpy(), RATE_HZ)


def identified(stage: Stage, seeds: Sequence[int] = (0, 1)) -> ForwardStage:
    return identify_stage([recorded(stage, seed) for seed in seeds], recorded(stage, 9))


@pytest.fixture(scope="module")
def dynamic() -> ForwardStage:
    return identified(rig(MODE, DELAY))


def test_dynamics_are_found_and_a_fresh_motion_is_predicted_to_the_noise(dynamic: ForwardStage) -> None:
    fresh = recorded(rig(MODE, DELAY), 77)
    error = free_run_error(dynamic.stage, fresh)
    assert dynamic.stage.names == ("delay", "resonance")
    values = {name: value for one in dynamic.stage.effects for name, value in one.values.items()}
    assert values["frequency_hz"] == pytest.approx(150.0, rel=0.02)
    assert values["delay_s"] == pytest.approx(1.2e-3, rel=0.1)
    assert error.std() < 2 * NOISE_UM
    assert dynamic.steps[0].names == () and dynamic.steps[0].unseen_rms_um > 10 * NOISE_UM


def test_the_stated_error_is_that_of_the_held_out_recording(dynamic: ForwardStage) -> None:
    assert dynamic.stage.identified is not None
    error = free_run_error(dynamic.stage, recorded(rig(MODE, DELAY), 9))
    assert dynamic.stage.identified.heldout == "r9"
    assert dynamic.stage.identified.heldout_rms_um == pytest.approx(error.std(), rel=1e-9)


def test_no_effect_is_added_to_a_stage_of_plays_alone() -> None:
    assert identified(rig()).stage.names == ()


def test_each_recording_has_a_zero_of_its_own() -> None:
    train = [recorded(rig(), seed) for seed in (0, 1)]
    moved = [replace(train[0], y=train[0].y + 3.0), train[1]]
    u = torch.from_numpy(recorded(rig(), 5).u)[None]
    stages = [identify_stage(each, recorded(rig(), 9)).stage for each in (train, moved)]
    y, other = (stage(u)[0].detach().numpy()[0] for stage in stages)
    np.testing.assert_allclose(other - other[0], y - y[0], atol=NOISE_UM)
    assert stages[1].zero_um == pytest.approx(stages[0].zero_um + 1.5, abs=NOISE_UM)


def test_the_held_out_recording_changes_the_stated_error_and_nothing_else(dynamic: ForwardStage) -> None:
    train, other = [recorded(rig(MODE, DELAY), seed) for seed in (0, 1)], recorded(rig(), 9)
    again = identify_stage(train, other).stage
    assert {**again.to_dict(), "identified": None} == {**dynamic.stage.to_dict(), "identified": None}
    assert again.identified != dynamic.stage.identified


def test_the_stage_carries_the_hash_of_its_recordings_in_any_order(dynamic: ForwardStage) -> None:
    train = [recorded(rig(MODE, DELAY), seed) for seed in (1, 0)]
    assert dynamic.stage.identified is not None
    assert dynamic.stage.identified.recordings_sha256 == recordings_sha256(train)
    assert recordings_sha256(train[:1]) != recordings_sha256(train)
    assert dynamic.stage.at_sample_rate(1000.0).identified == dynamic.stage.identified
    assert dynamic.stage.plain().identified is None


def test_a_constant_voltage_is_refused() -> None:
    still = replace(recorded(rig(), 0), u=np.zeros(round(2 * RATE_HZ)))
    with pytest.raises(RecordingError, match="none in which the voltage moves, expected at least one"):
        identify_stage([still], recorded(rig(), 9))


def test_the_mode_of_a_creeping_stage_is_found_beside_the_creep() -> None:
    """Two-pole creep could absorb what a mode and a lag leave; the error would then be tenfold."""
    logarithm = {"name": "creep", "values": {"per_decade": 0.015}}
    stage = rig(logarithm, MODE)
    found = identify_stage([recorded(stage, 1), recorded(stage, 2)], recorded(stage, 3))
    creeps = [one["values"] for one in found.stage.to_dict()["effects"] if one["name"] == "creep"]
    assert all(not values.get("slow_gain") for values in creeps)
    assert "resonance" in {one["name"] for one in found.stage.to_dict()["effects"]}
