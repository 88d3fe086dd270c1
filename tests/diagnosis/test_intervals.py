"""Intervals of 90 % cover the truth in 90 % of runs, in white and in coloured noise."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.signal import lfilter

from tests.diagnosis.plants import FS_HZ, hysteresis, lag, multisine, resonance, triangles
from tests.diagnosis.prepared import prepared
from torchpi.diagnosis.chain import Chain
from torchpi.diagnosis.fit import fit
from torchpi.diagnosis.free_parameters import slot, to_inner
from torchpi.diagnosis.hypothesis import EffectTerm, Hypothesis
from torchpi.diagnosis.hysteresis_model import HysteresisModel, many_plays, preisach
from torchpi.diagnosis.intervals import covariance_90, distance_from_none, intervals_90, scatter
from torchpi.diagnosis.records import seen
from torchpi.diagnosis.reduced_basis import MANY, basis
from torchpi.diagnosis.score import Weighting
from torchpi.recordings.recording import Recording
from torchpi.stage.effects.amplifier.amplifier_lag import AmplifierLag
from torchpi.stage.effects.mechanics.resonance import Resonance
from torchpi.stage.effects.sensor.sensor_nonlinearity import SensorNonlinearity
from torchpi.stage.effects.sensor.thermal_drift import ThermalDrift

TRUTH = (130.0, 310.0, 0.03)


def test_the_scatter_equals_the_jackknife_over_the_parts() -> None:
    rng = np.random.default_rng(3)
    parts = [rng.standard_normal((4, 30)) for _ in range(7)]
    weights = np.array([1.0, -2.0, 0.5, 3.0])
    readings = [weights @ part + 0.3 * rng.standard_normal(30) for part in parts]
    everything = np.linalg.lstsq(np.hstack(parts).T, np.hstack(readings), rcond=None)[0]
    without = []
    for k in range(7):
        kept = [i for i in range(7) if i != k]
        part, reading = np.hstack([parts[i] for i in kept]), np.hstack([readings[i] for i in kept])
        without.append(np.linalg.lstsq(part.T, reading, rcond=None)[0])
    steps = np.array(without) - everything
    jackknife = 6 / 7 * steps.T @ steps
    grams = [
        (part @ part.T, part @ (reading - everything @ part))
        for part, reading in zip(parts, readings, strict=True)
    ]
    whole = np.sum([gram for gram, _ in grams], 0)
    assert scatter(whole, grams, 2) == pytest.approx(jackknife[2:, 2:], rel=1e-5)


def test_a_parameter_that_only_one_part_determines_has_no_scatter() -> None:
    alone = np.diag([1.0, 100.0]), np.array([0.1, 5.0])
    other = np.diag([1.0, 0.1]), np.array([-0.1, 0.01])
    found = scatter(alone[0] + other[0], [alone, other], 2)
    assert found[0, 0] > 0
    assert found[1, 1] == 0  # without the first part there is nothing to compare it with


def fitted(
    term: EffectTerm, *values: tuple[str, float, float], correlation: float = 0.0
) -> tuple[SimpleNamespace, np.ndarray]:
    """Return a fit of one effect with these parameters (name, value, half-width) and their covariance."""
    hypothesis = Hypothesis(HysteresisModel(np.zeros(1))).plus(term)
    slots = tuple(slot(0, name, None, value, term.effect.quantities[name], 1e-4) for name, value, _ in values)
    ends = [
        (to_inner(one, v - h), to_inner(one, v + h)) for one, (_, v, h) in zip(slots, values, strict=True)
    ]
    halves = np.diff(ends)[:, 0] / 2
    covariance = np.outer(halves, halves) * (correlation + (1 - correlation) * np.eye(len(values)))
    theta = np.array([to_inner(one, value) for one, (_, value, _) in zip(slots, values, strict=True)])
    return SimpleNamespace(slots=slots, theta=theta, hypothesis=hypothesis), covariance


def test_the_distance_from_no_effect_is_the_rms_of_the_values_in_half_widths() -> None:
    term = EffectTerm(SensorNonlinearity, {"a2_per_um": -0.02, "a3_per_um2": 0.001})
    fit, spread = fitted(term, ("a2_per_um", -0.02, 0.01), ("a3_per_um2", 0.001, 0.0005))
    assert distance_from_none(fit, spread, term.effect.name) == pytest.approx(2.0, rel=1e-5)
    fit, spread = fitted(term, ("a2_per_um", -0.02, 0.02), ("a3_per_um2", 0.0, 0.0005))
    assert distance_from_none(fit, spread, term.effect.name) == pytest.approx(np.sqrt(0.5), rel=1e-5)
    assert distance_from_none(fit, spread, "creep") == np.inf


def test_individually_uncertain_parameters_may_jointly_be_far_from_no_effect() -> None:
    """The square and the cube of a non-negative signal act alike, so only their difference is uncertain."""
    term = EffectTerm(SensorNonlinearity, {"a2_per_um": 0.02, "a3_per_um2": 0.001})
    both = ("a2_per_um", 0.02, 0.02), ("a3_per_um2", 0.001, 0.001)
    name = term.effect.name
    assert distance_from_none(*fitted(term, *both), name) == pytest.approx(1.0, rel=1e-5)
    # For θ = (1, 1) half-widths with correlation r: θᵀ R⁻¹ θ = 2 / (1 + r).
    far = distance_from_none(*fitted(term, *both, correlation=-0.99), name)
    assert far == pytest.approx(10.0, rel=1e-3)


@pytest.mark.parametrize(
    ("term", "value"),
    [
        # No finite cutoff stands for no lag.
        (EffectTerm(AmplifierLag, {"cutoff_hz": 100.0}), ("cutoff_hz", 100.0, 50.0)),
        # The time constant of a negligible drift may have any value.
        (EffectTerm(ThermalDrift, {"time_constant_s": 10.0}), ("time_constant_s", 10.0, 9.5)),
    ],
    ids=["no size", "no linear step"],
)
def test_the_distance_from_no_effect_is_infinite_for_other_parameters(
    term: EffectTerm, value: tuple[str, float, float]
) -> None:
    assert distance_from_none(*fitted(term, value), term.effect.name) == np.inf


RUNS = 36


@pytest.mark.parametrize("pole", [0.0, 0.9])
def test_intervals_cover_the_truth(pole: float) -> None:
    us = [multisine(3000), triangles(3000)]
    clean = [resonance(hysteresis(lag(u, FS_HZ, TRUTH[0])), FS_HZ, *TRUTH[1:]) for u in us]
    members = (
        EffectTerm(AmplifierLag, {"cutoff_hz": TRUTH[0]}),
        EffectTerm(Resonance, {"frequency_hz": TRUTH[1], "damping_ratio": TRUTH[2]}),
    )
    truth, covered = np.array(TRUTH), np.zeros(3)
    for run in range(-1, RUNS):
        rng = np.random.default_rng(100 + run)
        noise = [0.01 * lfilter([np.sqrt(1 - pole**2)], [1, -pole], rng.standard_normal(len(u))) for u in us]
        recordings = [
            Recording(str(i), np.arange(len(u)) / FS_HZ, u, y + (e if run >= 0 else 0), FS_HZ)
            for i, (u, y, e) in enumerate(zip(us, clean, noise, strict=True))
        ]
        chain = Chain(prepared(recordings))
        one = fit(chain, Hypothesis(many_plays(seen(chain.records)), members), None, 4)
        values = np.array([v for member in one.hypothesis.members for v in member.shared.values()])
        if run < 0:
            # The rig's equations are not quite the model's: what the model makes of no noise is its truth.
            assert values == pytest.approx(truth, rel=0.02)
            truth = values
            continue
        spans = np.array(intervals_90(one, covariance_90(chain, one)))
        assert (spans[:, 0] < values).all() and (values < spans[:, 1]).all()
        covered += (spans[:, 0] <= truth) & (truth <= spans[:, 1])
    # Two and a half standard deviations of 36 draws are 12 %.
    assert (covered / RUNS > 0.78).all(), covered / RUNS
    assert covered.mean() / RUNS < 0.98


def test_twice_the_noise_makes_intervals_twice_as_wide() -> None:
    u, widths = multisine(3000), []
    for noise_um in (0.005, 0.01):
        e = noise_um * np.random.default_rng(7).standard_normal(len(u))
        y = hysteresis(lag(u, FS_HZ, 130.0)) + e
        chain = Chain(prepared([Recording("a", np.arange(len(u)) / FS_HZ, u, y, FS_HZ)]))
        members = (EffectTerm(AmplifierLag, {"cutoff_hz": 130.0}),)
        one = fit(chain, Hypothesis(many_plays(seen(chain.records)), members))
        ((low, high),) = intervals_90(one, covariance_90(chain, one))
        widths.append(high - low)
    assert widths[1] / widths[0] == pytest.approx(2.0, rel=0.3)


def test_an_interval_stays_narrow_beside_hundreds_of_weights_with_a_smoothness_prior() -> None:
    u = triangles(3000)
    y = hysteresis(lag(u, FS_HZ, 130.0)) + 0.02 * np.random.default_rng(0).standard_normal(len(u))
    chain = Chain(prepared([Recording("a", np.arange(len(u)) / FS_HZ, u, y, FS_HZ)]))
    larger = Hypothesis(
        preisach(seen(chain.records)), (EffectTerm(AmplifierLag, {"cutoff_hz": 130.0}),), remanent=True
    )
    one = fit(chain, *basis(chain, larger, None, MANY))
    chain.weighting = Weighting.of(chain.records, one.residuals, None)
    one = fit(chain, *basis(chain, one.hypothesis, one.weights, MANY))
    ((low, high),) = intervals_90(one, covariance_90(chain, one))
    assert len(one.weights) > 100
    assert high < 1.3 * low
