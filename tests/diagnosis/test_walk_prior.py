import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.diagnosis.plants import multisine, record
from tests.diagnosis.prepared import prepared
from torchpi.diagnosis.chain import Chain
from torchpi.diagnosis.fit import fit
from torchpi.diagnosis.free_parameters import free_parameters_of, to_inner, value_at
from torchpi.diagnosis.hypothesis import EffectTerm, Hypothesis
from torchpi.diagnosis.hysteresis_model import HysteresisModel
from torchpi.diagnosis.walk_prior import walk_prior
from torchpi.stage.effects.mechanics.resonance import Resonance
from torchpi.stage.effects.sensor.thermal_drift import KNOT_NAMES, ThermalDrift

SIZES = st.floats(0.1, 10.0) | st.floats(-10.0, -0.1)


def drift(*recordings: list[float], spacing_s: float = 1.0) -> EffectTerm:
    own = tuple(dict(zip(KNOT_NAMES, knots, strict=True)) for knots in recordings)
    return EffectTerm(ThermalDrift, {"knot_spacing_s": spacing_s}, own)


def hypothesis_of(*members: EffectTerm) -> Hypothesis:
    return Hypothesis(HysteresisModel(np.zeros(1)), members)


@given(st.lists(SIZES, min_size=8, max_size=8), st.lists(SIZES, min_size=8, max_size=8))
def test_a_walk_costs_the_sum_of_its_squared_increments_relative_to_a_typical_one(a, b) -> None:
    mode = EffectTerm(Resonance, {"frequency_hz": 100.0, "damping_ratio": 0.1})
    hypothesis = hypothesis_of(mode, drift(a, b))
    slots = free_parameters_of(hypothesis)
    theta = np.array([to_inner(slot, value_at(hypothesis, slot)) for slot in slots])
    increments = np.concatenate([np.diff([0.0, *a]), np.diff([0.0, *b])])
    usual = np.median(np.abs(increments)) * 1.4826
    prior = walk_prior(hypothesis, slots, theta)
    if usual > 0:
        assert theta @ prior @ theta == pytest.approx((increments**2).sum() / usual**2)
    assert not prior[:2].any() and not prior[:, :2].any()


def test_an_effect_without_a_random_walk_has_no_walk_prior() -> None:
    hypothesis = hypothesis_of(EffectTerm(ThermalDrift, {}, ({"rate_um_per_s": 1.0},)))
    assert not walk_prior(hypothesis, free_parameters_of(hypothesis), np.ones(1)).any()


def test_a_random_walk_stays_constant_where_there_are_no_data() -> None:
    """The second recording ends just after the fourth knot; without a prior, later knots would not move."""
    t = np.arange(8000) / 1000
    walk = [0.3, -0.2, 0.5, 0.9, 0.6, 1.1, 1.4, 1.2]
    wandering = np.interp(t, 0.85 * np.arange(9), [0.0, *walk])

    def drifts(x: np.ndarray, fs_hz: float) -> np.ndarray:
        return x + wandering[: len(x)]

    records = prepared(
        [
            record(
                multisine(samples), name=name, fs_hz=1000.0, after=lambda x, fs_hz: x + wandering[: len(x)]
            )
            for name, samples in (("a", 8000), ("b", 4020))
        ]
    )
    chain = Chain(records)
    start = drift([0.5, -0.5] * 4, [0.5, -0.5] * 4, spacing_s=0.85)
    found = fit(chain, Hypothesis(HysteresisModel(np.linspace(0, 4, 20)), (start,)))
    knots = [found.hypothesis.members[0].own[i][name] for i in (0, 1) for name in KNOT_NAMES]
    assert np.allclose(np.diff(knots[1:8]), np.diff(walk[1:]), atol=0.15)
    assert np.allclose(np.diff(knots[8 + 4 :]), 0.0, atol=0.05)
