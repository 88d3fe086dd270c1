"""A monitored voltage: its own noise goes, the command that is behind it stays."""

from dataclasses import replace

import numpy as np
import pytest

from tests.diagnosis.plants import NOISE_UM, multisine, record, triangles
from torchpi.diagnosis.diagnose import diagnose
from torchpi.diagnosis.monitored import noise_of, without_noise

T = np.arange(20_000) / 1e3
RNG = np.random.default_rng(0)
COMMANDS = {
    "sine": 50 + 50 * np.sin(2 * np.pi * T),
    "triangles": 100 * np.abs(T % 1 * 2 - 1),
    "stairs": np.floor(2 * T) % 7 * 10.0,
    "walk": np.cumsum(RNG.normal(0, 0.05, len(T))),
    "telegraph": 10.0 * (RNG.random(len(T)) > 0.5),
    "rest": np.full(len(T), 3.0),
}


@pytest.mark.parametrize("name", COMMANDS)
def test_a_command_stays_as_it_is(name: str) -> None:
    u = COMMANDS[name]
    assert noise_of(u) == 0.0 and without_noise(u) is u


@pytest.mark.parametrize("name", ["sine", "triangles", "stairs"])
def test_noise_goes_and_corners_stay(name: str) -> None:
    u, sd = COMMANDS[name], 0.02
    seen = u + np.random.default_rng(1).normal(0, sd, len(u))
    left = without_noise(seen) - u
    assert noise_of(seen) == pytest.approx(sd, rel=0.05)
    assert left.std() < 0.4 * sd and np.abs(left).max() < 8 * sd


def test_what_scatters_as_much_as_it_moves_is_a_command() -> None:
    u = np.random.default_rng(2).normal(0, 1, 5000)
    assert noise_of(u) == 0.0


def test_the_rounding_of_a_file_is_no_noise() -> None:
    u = np.round(COMMANDS["sine"], 6)
    assert without_noise(u) is u


def test_a_record_too_short_to_tell_stays_as_it_is() -> None:
    u = COMMANDS["sine"][:200] + np.random.default_rng(3).normal(0, 0.02, 200)
    assert without_noise(u) is u


def test_noise_of_a_monitored_voltage_is_no_lag() -> None:
    """Any filter of that noise predicts better than the noise."""
    commanded = [
        record(multisine(6000, high_hz=20.0), seed=1),
        record(triangles(6000), name="b", seed=2),
    ]
    rng = np.random.default_rng(5)
    found = diagnose([replace(one, u=one.u + rng.normal(0, 0.006, len(one.u))) for one in commanded])
    assert found.effects == ()
    assert found.augmented.heldout_rms_um < 1.5 * NOISE_UM
    assert any("noise of its own" in note for note in found.notes)
