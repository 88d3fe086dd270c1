"""Which effects add a signal that neither the voltage nor the clock contains."""

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.signal import lfilter

from tests.diagnosis.plants import FS_HZ, pair
from tests.diagnosis.prepared import prepared
from torchpi.diagnosis.chain import Chain
from torchpi.diagnosis.hypothesis import EffectTerm, Hypothesis
from torchpi.diagnosis.hysteresis_model import plain, thresholds
from torchpi.diagnosis.lines import STANDS_OUT
from torchpi.diagnosis.own_signal import has_a_recorded_signal, has_a_signal_of_its_own, stands_out
from torchpi.diagnosis.records import seen
from torchpi.recordings.recording import Recording
from torchpi.stage.effects.actuator.creep import Creep
from torchpi.stage.effects.mechanics.cross_coupling import CrossCoupling
from torchpi.stage.effects.sensor.gain_modulation import GainModulation
from torchpi.stage.effects.sensor.hum import Hum


@pytest.mark.parametrize(
    ("term", "commanded_hz", "own"),
    [
        (EffectTerm(Creep, {"per_decade": 0.01}), 0, False),
        (EffectTerm(CrossCoupling, {"coupling_um_per_v": 0.1}, aux="aux_v"), 0, True),
        (EffectTerm(GainModulation, {"frequency_hz": 20.0}, ({"cos_um": 0.1},)), 0, True),
        (EffectTerm(GainModulation, {"frequency_hz": 20.0}, ({"cos_um": 0.1},)), 20, False),
        (EffectTerm(GainModulation, {"frequency_hz": 20.0}, ({"cos_um": 0.1},)), 31, True),
        (EffectTerm(GainModulation, {"frequency_hz": 20.0}, ({"cos": 0.1},)), 0, False),
    ],
)
def test_a_line_that_the_command_contains_is_not_a_signal_of_its_own(
    term: EffectTerm, commanded_hz: int, own: bool
) -> None:
    t = np.arange(4000) / FS_HZ
    sine, swells = np.sin(2 * np.pi * commanded_hz * t), 1 + 0.3 * np.sin(2 * np.pi * 0.6 * t)
    records = prepared([replace(one, u=2.5 + 2 * sine * swells) for one in pair(4000)])
    h = Hypothesis(plain(seen(records))).plus(term)
    assert has_a_signal_of_its_own(records, h, term.effect.name) is own
    assert not has_a_signal_of_its_own(records, h, "another")


@pytest.mark.parametrize(
    ("line_hz", "commanded_hz", "named"), [(50, 0, True), (49, 0, False), (50, 50, False)]
)
def test_a_line_counts_if_it_stands_out_from_its_surroundings_whatever_else_remains(
    line_hz: float, commanded_hz: float, named: bool
) -> None:
    rig = pair(4000)
    t = np.arange(4000) / FS_HZ
    if commanded_hz:
        clock = np.floor(t * commanded_hz)
        rig = [replace(one, u=np.random.default_rng(2).uniform(0, 5, 4000)[clock.astype(int)]) for one in rig]
    records = prepared(rig)
    left = [1e-3 * np.sin(2 * np.pi * line_hz * t) + 0.1 * np.exp(-t) for _ in records]
    hum = Hypothesis(plain(seen(records))).plus(EffectTerm(Hum, {"frequency_hz": 50.0}))
    more, less = SimpleNamespace(hypothesis=hum), SimpleNamespace(residuals=left)
    assert (stands_out(records, more, less, "hum") > STANDS_OUT) is named
    assert stands_out(records, more, less, "creep") == 0.0


def noise_beside(one: Recording, rng: np.random.Generator) -> np.ndarray:
    return rng.normal(size=len(one))


def slow_motion_beside(one: Recording, rng: np.random.Generator) -> np.ndarray:
    """As slow as the voltage, so that a hundred plays predict much of it by chance."""
    return lfilter([1.0], [1.0, -0.98], rng.normal(size=len(one)))


def monitor_of_the_voltage(one: Recording, rng: np.random.Generator) -> np.ndarray:
    return one.u + 0.01 * one.y


def a_second_sensor(one: Recording, rng: np.random.Generator) -> np.ndarray:
    return one.y + rng.normal(size=len(one))


@pytest.mark.parametrize(
    ("beside", "independent"),
    [
        (noise_beside, True),
        (slow_motion_beside, True),
        (monitor_of_the_voltage, False),
        (a_second_sensor, False),
    ],
)
def test_only_a_recorded_signal_independent_of_the_voltage_is_a_signal_of_its_own(
    beside: Callable[[Recording, np.random.Generator], np.ndarray], independent: bool
) -> None:
    rng = np.random.default_rng(3)
    rig = [replace(one, aux={"aux_v": beside(one, rng)}) for one in pair(2000)]
    chain = Chain(prepared(rig))
    what = seen(chain.records)
    h = Hypothesis(replace(plain(what), thresholds_v=thresholds(what, 40, 60)))
    coupled = h.plus(EffectTerm(CrossCoupling, {"coupling_um_per_v": 0.1}, aux="aux_v"))
    search = SimpleNamespace(chain=chain)
    assert has_a_recorded_signal(search, SimpleNamespace(hypothesis=coupled), "cross_coupling") is independent
    assert not has_a_recorded_signal(search, SimpleNamespace(hypothesis=h), "cross_coupling")
