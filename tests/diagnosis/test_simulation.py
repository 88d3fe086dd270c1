"""A given simulation: a correct one lacks nothing, and one with a part left out lacks that part."""

import re
from dataclasses import replace

import numpy as np
import pytest
import torch

from tests.diagnosis.plants import FS_HZ, NOISE_UM, multisine, triangles
from torchpi.diagnosis.diagnose import diagnose
from torchpi.operators.hysteresis_rows import DUHEM_POWERS
from torchpi.recordings.recording import Recording
from torchpi.stage import Stage
from torchpi.stage.effects.mechanics.load_change import LoadChange
from torchpi.stage.effects.sensor.gain_modulation import GainModulation

PHYSICS = {
    "sample_rate_hz": FS_HZ,
    "actuator": {
        "thresholds_v": [0, 0.3, 0.8, 1.7, 3, 5],
        "weights_um_per_v": [0.5, 0.05, 0.06, 0.07, 0.08, 0.04],
        "creep_per_decade": 0.02,
        # The range of the corresponding effect.
        "creep_from_s": 1e-3 * 10**0.5,
        "creep_to_s": 100,
    },
    "mechanics": {"frequency_hz": 300, "damping_ratio": 0.03},
}


def crime(noise_um: float = NOISE_UM) -> list[Recording]:
    """Record the same model that is diagnosed: a flattering test, and the least that must work."""
    stage = Stage.from_dict({**PHYSICS, "sensor": {"noise_um": noise_um}})
    recordings = []
    for i, u in enumerate((multisine(2000), triangles(2000), multisine(2000, seed=5))):
        y = stage.simulate(torch.from_numpy(u)[None], i)[1][0].detach().numpy()
        recordings.append(Recording("abc"[i], np.arange(len(u)) / FS_HZ, u, y, FS_HZ))
    return recordings


def test_a_correct_simulation_lacks_nothing() -> None:
    found = diagnose(crime()[:2], Stage.from_dict(PHYSICS))
    assert found.verdict == "nothing_missing" and found.effects == ()
    assert found.nominal.heldout_rms_um < 1.1 * NOISE_UM


def test_a_correct_simulation_with_sharp_thresholds_is_matched_down_to_little_noise() -> None:
    noise_um = NOISE_UM / 16
    found = diagnose(crime(noise_um)[:1], Stage.from_dict(PHYSICS))
    assert found.verdict == "nothing_missing"
    assert found.retuned.heldout_rms_um < 1.1 * noise_um


@pytest.mark.parametrize("family", ["preisach", "bouc_wen", "duhem"])
def test_a_correct_simulation_with_another_hysteresis_lacks_nothing(family: str) -> None:
    r = np.array([0.0, 0.5, 1.0, 2.0, 3.5])
    curved = 0.5 + 0.1 * np.linspace(-1, 1, 6)[:, None] * [1.0, 1.0, -1.0, 0.5, -0.5]
    hysteresis = {
        "preisach": {
            "thresholds_v": r,
            "weights": [*curved.ravel() / 5, 0.0],
            "pieces": 6,
            "range_v": (0, 10),
        },
        "bouc_wen": {
            "thresholds_v": r,
            "weights": [0.7, 0.05, 0.05, 0.05, 0.05, -0.4, 0.0],
            "bouc_wen": True,
            "shape": {"sigma_v": 1.5, "beta": 0.6, "exponent": 1.2},
        },
        "duhem": {
            "thresholds_v": r[:1],
            "weights": [0.7, *np.linspace(0.2, 0.02, len(DUHEM_POWERS)), 0.0],
            "scale_v": 10.0,
            "duhem": True,
            "shape": {"alpha_per_v": 0.4},
        },
    }[family]
    stage = Stage(FS_HZ, hysteresis, noise_um=NOISE_UM)
    u = multisine(2000)
    recording = Recording.from_arrays(np.arange(len(u)) / FS_HZ, u, stage.simulate(u[None])[1][0])
    found = diagnose([recording], stage)
    assert found.verdict == "nothing_missing" and found.effects == ()
    assert found.retuned.heldout_rms_um < 1.1 * NOISE_UM


def test_a_wrong_mode_of_a_simulation_is_retuned_and_said_and_not_called_missing_physics() -> None:
    wrong = Stage.from_dict({**PHYSICS, "mechanics": {**PHYSICS["mechanics"], "frequency_hz": 200}})
    found = diagnose(crime()[:1], wrong)
    assert found.verdict == "nothing_missing"
    assert re.search(r"changes the frequency of its resonance from 200 Hz to 300(\.\d)? Hz", found.says)
    assert found.retuned.heldout_rms_um < 1.1 * NOISE_UM < 0.1 * found.nominal.heldout_rms_um


@pytest.mark.parametrize(("part", "name"), [("mechanics", "resonance"), ("creep", "creep")])
def test_a_part_removed_from_a_simulation_is_named_as_missing(part: str, name: str) -> None:
    actuator = {key: value for key, value in PHYSICS["actuator"].items() if not key.startswith("creep")}
    less = (
        {key: value for key, value in PHYSICS.items() if key != part}
        if part == "mechanics"
        else {**PHYSICS, "actuator": actuator}
    )
    found = diagnose(crime()[:2], Stage.from_dict(less))
    assert [effect.name for effect in found.effects] == [name] and found.verdict == "explained"
    assert found.augmented.heldout_rms_um < 1.1 * NOISE_UM < 0.7 * found.nominal.heldout_rms_um


@pytest.mark.parametrize("share", [0.003, -0.003])
def test_a_small_change_of_load_is_found_from_a_start_far_above_it(share: float) -> None:
    first, second, last = crime()
    last = replace(last, y=last.y / (1 + share))
    found = diagnose([first, second, last], Stage.from_dict(PHYSICS), effects=[LoadChange, GainModulation])
    assert [effect.name for effect in found.effects] == ["load_change"] and found.verdict == "explained"
    (ratio,) = found.effects[0].parameters
    assert isinstance(ratio.value, float) and ratio.value == pytest.approx(share, rel=0.1)
