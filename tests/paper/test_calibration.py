"""The calibrated stage is as hard for the paper's method as the paper's rig, and physically realistic."""

import math
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import torch

from torchpi.errors import ConfigError
from torchpi.excitation.signals import sine_5hz
from torchpi.paper.calibration import (
    EFFECTS_OF,
    PAPER_MAX_UM,
    PARTS,
    Calibration,
    calibrate_paper_method,
    without,
)
from torchpi.stage import Stage

FILE = Path(__file__).parents[2] / "configs/stage/qin2013.yaml"
SEEDS = (1, 2, 3)


def stage() -> Stage:
    return Stage.from_yaml(FILE).requires_grad_(False)


@cache
def calibration(seed: int) -> Calibration:
    return calibrate_paper_method(stage(), seed)


@pytest.mark.parametrize("figure", PAPER_MAX_UM)
@pytest.mark.parametrize("seed", SEEDS)
def test_the_papers_method_has_the_published_error_for_every_noise_seed(seed: int, figure: str) -> None:
    assert calibration(seed).max_um[figure] == pytest.approx(PAPER_MAX_UM[figure], rel=0.2)


def test_the_default_seed_is_the_stages_own_and_results_repeat() -> None:
    assert calibrate_paper_method(stage()).max_um == calibration(stage().seed).max_um


def test_model_and_fast_trajectory_errors_are_largest_in_the_initial_loading() -> None:
    found = calibration(1)
    assert found.model.whole.max_um > found.model.after_loading.max_um
    fast = found.panels["fast"].tracked["paper"].error
    assert fast.max_um > fast.max_um_after_loading


def test_error_figures_are_those_of_the_returned_curves() -> None:
    for panel in calibration(1).panels.values():
        tracked = panel.tracked["paper"]
        assert tracked.error.max_um == pytest.approx(np.abs(tracked.y - panel.yd).max())
        assert tracked.error.max_um >= tracked.error.max_um_after_loading
        assert tracked.error.max_percent == pytest.approx(100 * tracked.error.max_um / panel.peak_to_peak_um)
        assert tracked.error.rms_um < tracked.error.max_um
        again, _ = stage().simulate(torch.from_numpy(tracked.u)[None])
        np.testing.assert_array_equal(again[0].numpy(), tracked.y)


def test_parameters_of_the_stage_are_realistic() -> None:
    rig = stage()
    values = {name: value for one in rig.effects for name, value in one.values.items()}
    assert 400 <= values["frequency_hz"] <= 800
    assert 0.01 <= values["damping_ratio"] <= 0.03
    assert 0.01 <= values["per_decade"] <= 0.02
    assert rig.command_converter is not None and rig.reading_converter is not None
    assert rig.command_converter.bits == rig.reading_converter.bits == 16
    slope = [
        1 + 2 * values["c2_per_v"] * v + 3 * values.get("c3_per_v2", 0.0) * v**2 for v in (0.0, 5.0, 10.0)
    ]
    assert slope == pytest.approx([1.0, 0.9, 0.8])


def test_range_and_loop_of_the_stage_are_realistic() -> None:
    _, u = sine_5hz(0.6)
    y = stage()(torch.from_numpy(u)[None])[0][0].numpy()
    # In the last loop, each command is paired with the displacement that it causes two samples later.
    u, y = u[3998:5998], y[4000:]
    assert y.max() == pytest.approx(8.1, abs=0.05)
    # Eqs. 15 and 16 descend to 1 µm, which the stage must be able to reach with voltages of 0 V or more.
    assert y.min() == pytest.approx(0.9, abs=0.05)
    at = np.linspace(0.1, 9.9, 200)
    up, down = np.interp(at, u[:1000], y[:1000]), np.interp(at, u[1000:][::-1], y[1000:][::-1])
    width = (down - up) / np.ptp(y)
    assert 0.12 < width.max() < 0.16
    assert abs(width[30:70].mean() - width[130:170].mean()) > 0.003  # not symmetric


@pytest.mark.parametrize("part", PARTS)
def test_removing_a_part_changes_that_part_alone_and_keeps_the_range(part: str) -> None:
    before, after = stage(), without(stage(), part).requires_grad_(False)
    changed = {key for key, value in before.to_dict().items() if after.to_dict()[key] != value}
    assert changed == {
        "noise": {"noise_um"},
        "quantisation": {"command_converter", "reading_converter"},
        "lag": {"effects", "sensor"},
        "curvature": {"effects", "hysteresis"},
        "hysteresis": {"hysteresis"},
    }.get(part, {"effects"})
    gone = {one.kind.name for one in (*before.effects, *before.sensor_effects)}
    gone -= {one.kind.name for one in (*after.effects, *after.sensor_effects)}
    assert gone == set(EFFECTS_OF.get(part, ()))
    rise = torch.linspace(0, math.pi, 1000, dtype=torch.float64).cos().mul(-5).add(5)[None]
    assert float(after(rise)[0].max()) == pytest.approx(float(before(rise)[0].max()), rel=0.01)


def test_most_of_the_model_error_is_due_to_the_mode_and_a_third_of_the_slow_error_to_creep() -> None:
    mode, creep = (calibrate_paper_method(without(stage(), part), 1) for part in ("mode", "creep"))
    assert mode.max_um["model"] < 0.5 * calibration(1).max_um["model"]
    assert creep.max_um["slow"] < 0.67 * calibration(1).max_um["slow"]


def test_an_unknown_part_is_refused_with_a_list_of_known_parts() -> None:
    with pytest.raises(ConfigError, match=r"'wear', expected one of noise, .* hysteresis"):
        without(stage(), "wear")
