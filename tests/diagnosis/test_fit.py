"""Fits within the chain: planted parameters are recovered, derivatives correct and bounds reported."""

from dataclasses import replace

import numpy as np
import pytest

from tests.diagnosis.plants import (
    FINER,
    FS_HZ,
    NOISE_UM,
    Signal,
    Step,
    creep,
    lag,
    multisine,
    pair,
    record,
    resonance,
    triangles,
)
from tests.diagnosis.prepared import prepared
from torchpi.diagnosis.chain import Chain
from torchpi.diagnosis.fit import ROUGH, fit
from torchpi.diagnosis.free_parameters import (
    free_parameters_of,
    shape_slot,
    to_inner,
    value_at,
    with_theta,
)
from torchpi.diagnosis.hypothesis import EffectTerm, Fit, Hypothesis
from torchpi.diagnosis.hysteresis_model import bouc_wen, many_plays, preisach
from torchpi.diagnosis.records import seen
from torchpi.diagnosis.reduced_basis import MANY, basis, reduced, refitted
from torchpi.diagnosis.sensitivity import Near, jacobian
from torchpi.diagnosis.timing import is_whole, lateness_s
from torchpi.recordings.recording import Recording
from torchpi.stage.effects.actuator.creep import Creep
from torchpi.stage.effects.actuator.hysteresis_asymmetry import HysteresisAsymmetry
from torchpi.stage.effects.actuator.rate_dependent_hysteresis import RateDependentHysteresis
from torchpi.stage.effects.amplifier.amplifier_lag import AmplifierLag
from torchpi.stage.effects.amplifier.delay import Delay
from torchpi.stage.effects.amplifier.voltage_saturation import VoltageSaturation
from torchpi.stage.effects.mechanics.backlash import Backlash
from torchpi.stage.effects.mechanics.cross_coupling import CrossCoupling
from torchpi.stage.effects.mechanics.resonance import Resonance
from torchpi.stage.effects.sensor.hum import Hum
from torchpi.stage.effects.sensor.sensor_nonlinearity import SensorNonlinearity


def fitted(recordings: list[Recording], *members: EffectTerm) -> Fit:
    chain = Chain(prepared(recordings))
    return fit(chain, Hypothesis(many_plays(seen(chain.records)), members))


PLANTED: dict[str, tuple[str, Step, EffectTerm, dict[str, float]]] = {
    "lag": (
        "before",
        lambda v, fs_hz: lag(v, fs_hz, 130.0),
        EffectTerm(AmplifierLag, {"cutoff_hz": 200.0}),
        {"cutoff_hz": 130.0},
    ),
    "saturation": (
        "before",
        lambda v, fs_hz: np.clip(v, 0.7, 8.8),
        EffectTerm(VoltageSaturation, {"low_v": 1.0, "high_v": 8.5}),
        {"low_v": 0.7, "high_v": 8.8},
    ),
    "resonance": (
        "after",
        lambda x, fs_hz: resonance(x, fs_hz, 310.0, 0.03),
        EffectTerm(Resonance, {"frequency_hz": 330.0, "damping_ratio": 0.02}),
        {"frequency_hz": 310.0, "damping_ratio": 0.03},
    ),
    "creep": (
        "after",
        lambda x, fs_hz: creep(x, fs_hz, 0.02),
        EffectTerm(Creep, {"per_decade": 0.01}),
        {"per_decade": 0.02},
    ),
}


@pytest.mark.parametrize("kind", PLANTED)
def test_a_fit_started_with_the_sensitivities_of_another_fit_reaches_the_same_result(kind: str) -> None:
    where, step, start, _ = PLANTED[kind]
    chain = Chain(prepared(pair(**{where: step})))
    before = reduced(chain, fit(chain, Hypothesis(many_plays(seen(chain.records)))))
    more = before.hypothesis.plus(start)
    alone = fit(chain, more, before.weights, tolerance=ROUGH)
    assert chain.linearised is None
    near = Near(before.hypothesis, before.weights)
    found = fit(chain, more, before.weights, tolerance=ROUGH, near=near)
    assert chain.linearised is not None
    assert found.train_rms == pytest.approx(alone.train_rms, rel=0.03)
    np.testing.assert_allclose(found.theta, alone.theta, rtol=0.02, atol=0.02)


def test_sensitivities_are_not_reused_for_another_hysteresis_alignment_or_history() -> None:
    chain = Chain(prepared(pair()))
    hypothesis = Hypothesis(many_plays(seen(chain.records)))
    near = Near(hypothesis, np.zeros(chain.numbers(hypothesis)))
    assert near.resembles(hypothesis)
    assert not near.resembles(hypothesis.on(preisach(seen(chain.records))))
    assert not near.resembles(replace(hypothesis, alignment=1))
    assert not near.resembles(replace(hypothesis, remanent=True))
    curved = hypothesis.plus(EffectTerm(SensorNonlinearity, {"a2_per_um": 0.01}))
    assert near.resembles(curved)
    assert not Near(curved, np.zeros(chain.numbers(curved))).resembles(hypothesis)


def test_evaluating_another_hypothesis_in_between_does_not_change_the_first() -> None:
    chain = Chain(prepared(pair()))
    alone = Hypothesis(many_plays(seen(chain.records))).plus(
        EffectTerm(Delay, {"delay_s": 3.3e-4, "after_lag": 1.0})
    )
    both = alone.plus(EffectTerm(AmplifierLag, {"cutoff_hz": 300.0}))
    before = chain.voltage(both, 0)
    chain.voltage(alone, 0)
    assert np.array_equal(chain.voltage(both, 0), before)


@pytest.mark.parametrize("case", PLANTED)
def test_planted_parameters_are_recovered(case: str) -> None:
    where, rig, member, truth = PLANTED[case]
    found = fitted(pair(**{where: rig}), member)
    assert found.heldout_rms < 1.1 * NOISE_UM
    for name, value in truth.items():
        # The rig's creep has other poles, so the parameter differs slightly between parametrisations.
        assert found.hypothesis.members[0].shared[name] == pytest.approx(value, rel=0.06), name
    assert found.bounded == ()


def test_several_effects_are_recovered_in_one_fit() -> None:
    found = fitted(
        pair(
            6000,
            before=lambda v, fs_hz: lag(v, fs_hz, 130.0),
            after=lambda x, fs_hz: resonance(creep(x, fs_hz, 0.02), fs_hz, 310.0, 0.03),
        ),
        EffectTerm(AmplifierLag, {"cutoff_hz": 200.0}),
        EffectTerm(Creep, {"per_decade": 0.01}),
        EffectTerm(Resonance, {"frequency_hz": 330.0, "damping_ratio": 0.02}),
    )
    assert found.heldout_rms < 1.1 * NOISE_UM
    values = [next(iter(member.shared.values())) for member in found.hypothesis.members]
    assert values == pytest.approx([130.0, 0.02, 310.0], rel=0.06)


def test_a_coupling_to_an_auxiliary_column_is_recovered_with_its_sign() -> None:
    other = np.random.default_rng(5).standard_normal(4000)
    rig = record(multisine(4000), after=lambda x, fs_hz: x - 0.03 * other, aux={"aux_v": other})
    found = fitted([rig], EffectTerm(CrossCoupling, {"coupling_um_per_v": 0.01}, aux="aux_v"))
    assert found.hypothesis.members[0].shared["coupling_um_per_v"] == pytest.approx(-0.03, rel=0.01)


@pytest.mark.parametrize("nominal", [many_plays, lambda s: preisach(s, 6), lambda s: bouc_wen(s, 0.1)])
def test_derivatives_equal_finite_differences(nominal: object) -> None:
    """For the weights and for every slot, including those of single recordings, away from kinks."""
    chain = Chain(prepared(pair(800)))
    own = tuple({"cos_um": 0.01, "sin_um": 0.02} for _ in chain.records)
    members = (
        EffectTerm(AmplifierLag, {"cutoff_hz": 200.0}),
        EffectTerm(HysteresisAsymmetry, {"asymmetry_per_v": 1e-3}),
        EffectTerm(RateDependentHysteresis, {"weight_s_per_v": 1e-5}),
        EffectTerm(Creep, {"per_decade": 0.01}),
        EffectTerm(Resonance, {"frequency_hz": 330.0, "damping_ratio": 0.05}),
        EffectTerm(Hum, {"frequency_hz": 50.0}, own),
    )
    one = fit(chain, Hypothesis(nominal(seen(chain.records)), members), None, 0)
    _, part = jacobian(chain, one.hypothesis, one.weights, one.slots, one.theta, 1)
    y = chain.output(one.hypothesis, one.weights, 1)  # summed like the outputs it is compared with
    n, step = len(one.weights), 1e-4  # linear: any step works, and a longer one rounds less
    full = np.zeros((n + len(one.slots), part.rows.shape[1]))
    full[part.places] = part.rows
    for j in range(0, n, 7):
        moved = one.weights.copy()
        moved[j] += step
        expected = chain.whitened(1, ((chain.output(one.hypothesis, moved, 1) - y) / step)[None])[0]
        np.testing.assert_allclose(full[j], expected, atol=2e-6 * max(1.0, np.abs(expected).max()))
    for j, slot in enumerate(one.slots):
        ends = []
        for sign in (1, -1):
            moved = one.theta.copy()
            moved[j] += sign * 1e-5
            ends.append(chain.output(with_theta(one.hypothesis, one.slots, moved), one.weights, 1))
        expected = chain.whitened(1, ((ends[0] - ends[1]) / 2e-5)[None])[0]
        error = np.sqrt(np.mean((full[n + j] - expected) ** 2))
        assert error <= 2e-2 * np.sqrt(np.mean(expected**2)) + 1e-6, slot
        assert slot.record != 0 or not full[n + j].any()


def test_a_parameter_at_its_bound_is_reported() -> None:
    """Single-pole creep adds at most the displacement itself; the rig adds three times as much."""
    crawling = pair(after=lambda x, fs_hz: x + 3 * lag(x, fs_hz, 2.0))
    found = fitted(crawling, EffectTerm(Creep, {"gain": 0.5, "time_constant_s": 0.08}))
    assert found.bounded == ("gain",)


def test_a_slope_is_taken_on_the_side_on_which_a_stage_exists() -> None:
    """A creep from just below 100 s to 100 s: a step up would put its start behind its end."""
    chain = Chain(prepared([record(triangles(2000))]))
    late = EffectTerm(Creep, {"per_decade": 0.02, "from_s": 99.999})
    h = Hypothesis(many_plays(seen(chain.records)), (late,))
    slots, weights = free_parameters_of(h), np.ones(chain.numbers(h))
    theta = np.array([to_inner(slot, value_at(h, slot)) for slot in slots])
    _, found = jacobian(chain, h, weights, slots, theta, 0)
    assert np.isfinite(found.rows).all()
    of_its_start = found.rows[found.places == len(weights) + [slot.name for slot in slots].index("from_s")]
    assert of_its_start.any()


def test_plays_that_relax_are_recovered() -> None:
    """Each of the rig's plays moves towards the ordinary play's position, by Euler's method in fine steps."""
    thresholds, weights, tau_s = np.linspace(0.0, 9.0, 31), np.append(0.6, np.full(30, 0.02)), 0.02
    recordings = []
    for k, rate_hz in enumerate((3.0, 12.0)):
        u, state = triangles(3000, rate_hz), np.zeros(31)
        y = np.zeros(len(u))
        for t, v in enumerate(u):
            for _ in range(FINER):
                target = np.clip(state, v - thresholds, v + thresholds)
                state += (target - state) * np.where(thresholds > 0, 1 / (FS_HZ * FINER * tau_s), 1.0)
            y[t] = weights @ state
        y += NOISE_UM * np.random.default_rng(k).standard_normal(len(u))
        recordings.append(Recording(f"{rate_hz:g} Hz", np.arange(len(u)) / FS_HZ, u, y, FS_HZ))
    found = fitted(recordings, EffectTerm(RateDependentHysteresis, {"relaxation_s": 0.003}))
    assert found.heldout_rms < 1.1 * NOISE_UM < 0.1 * fitted(recordings).heldout_rms
    assert found.hypothesis.members[0].shared["relaxation_s"] == pytest.approx(tau_s, rel=0.02)


def test_a_fit_never_ends_worse_than_it_began() -> None:
    recordings = pair(2000, before=lambda v, fs_hz: lag(v, fs_hz, 130.0))
    chain = Chain(prepared(recordings))
    for f in (5.0, 60.0, 900.0):
        begun = Hypothesis(many_plays(seen(chain.records)), (EffectTerm(AmplifierLag, {"cutoff_hz": f}),))
        assert fit(chain, begun).train_rms <= fit(chain, begun, None, 0).train_rms


def test_a_mode_just_below_the_nyquist_frequency_does_not_crash_the_fit() -> None:
    found = fitted(
        [record(multisine(1000))],
        EffectTerm(Resonance, {"frequency_hz": 0.49 * FS_HZ, "damping_ratio": 0.01}),
    )
    assert np.isfinite(found.heldout_rms)


def test_a_larger_hysteresis_stays_bounded_slightly_beyond_the_recorded_range() -> None:
    u = 0.7 * multisine(6000)
    records = prepared([record(u), record(0.7 * triangles(6000), name="b")])
    chain = Chain(records)
    larger = fit(chain, *basis(chain, Hypothesis(preisach(seen(records))), None, MANY))
    nominal = larger.hypothesis.nominal
    beyond = nominal.output(1.3 * u, records[0].period_s, larger.weights[: nominal.kept])
    beyond += chain.zero(larger.weights, 0)
    assert np.abs(beyond).max() < 1.6 * np.abs(records[0].y).max()


def test_a_limit_that_clips_only_the_peaks_is_found_from_a_nearby_start() -> None:
    """The weights of the plays have already adapted to the clipped signal."""
    limit_v = 9.7
    chain = Chain(prepared(pair(4000, before=lambda v, fs_hz: np.minimum(v, limit_v), noise_um=0.001)))
    bent = reduced(chain, fit(chain, Hypothesis(many_plays(seen(chain.records)))))
    for start_v in (9.5, 9.65, 9.8):
        few = fit(
            chain, bent.hypothesis.plus(EffectTerm(VoltageSaturation, {"high_v": start_v})), bent.weights
        )
        one = refitted(chain, few)
        assert one.hypothesis.members[0].shared["high_v"] == pytest.approx(limit_v, abs=5e-3)


def test_a_curvature_of_a_third_of_the_travel_is_found_from_a_start_of_one_per_cent() -> None:
    """Each step changes it many times over, and with it the play weights, which it makes nonlinear."""
    chain = Chain(prepared(pair(4000, after=lambda x, fs_hz: x + 0.03 * x**2 + 0.001 * x**3)))
    bent = reduced(chain, fit(chain, Hypothesis(many_plays(seen(chain.records)))))
    start = SensorNonlinearity.starts(seen(chain.records))[-1]
    found = fit(chain, bent.hypothesis.plus(EffectTerm(SensorNonlinearity, start)), bent.weights, 8, ROUGH)
    assert found.train_rms < 1.1 * NOISE_UM < bent.train_rms
    assert [*found.hypothesis.members[0].shared.values()] == pytest.approx([0.03, 0.001], rel=0.1)


def test_a_rounded_limit_fits_a_limit_of_another_shape_better_than_a_hard_one() -> None:
    def limited(v: Signal, fs_hz: float) -> Signal:
        return np.where(v < 6.0, v, 6.0 + 3.0 * np.tanh((v - 6.0) / 3.0))

    chain = Chain(prepared(pair(4000, before=limited, noise_um=0.001)))
    bent = reduced(chain, fit(chain, Hypothesis(many_plays(seen(chain.records)))))
    hard, soft = (
        fit(chain, bent.hypothesis.plus(EffectTerm(VoltageSaturation, start)), bent.weights)
        for start in ({"high_v": 8.5}, {"high_v": 8.5, "knee_v": 0.5})
    )
    assert soft.train_rms < 0.3 * min(hard.train_rms, bent.train_rms)
    assert soft.bounded == ()


def test_lateness_is_the_sum_of_all_lags_delays_and_the_alignment() -> None:
    chain = Chain(prepared([record(multisine(3000))]))
    h = replace(Hypothesis(many_plays(seen(chain.records))), alignment=1)
    late = h.plus(EffectTerm(AmplifierLag, {"cutoff_hz": 50.0})).plus(EffectTerm(Delay, {"delay_s": 3e-3}))
    expected_s = 1 / (2 * np.pi * 50.0) + 3e-3 + 1 / FS_HZ
    assert lateness_s(chain, late) == pytest.approx(expected_s, abs=0.6 / FS_HZ)  # effect of a hold on a ramp


@pytest.mark.parametrize(
    ("alignment", "delay_samples", "lag_hz", "expected"),
    [
        (1, 0.0, 0.0, True),
        (0, 1.002, 0.0, True),
        (1, 2.0, 0.0, True),
        (0, 1.2, 0.0, False),
        (0, 1.0, 50.0, False),
    ],
)
def test_lateness_is_whole_only_for_delays_of_whole_samples_without_a_lag(
    alignment: int, delay_samples: float, lag_hz: float, expected: bool
) -> None:
    chain = Chain(prepared([record(multisine(3000))]))
    h = replace(Hypothesis(many_plays(seen(chain.records))), alignment=alignment)
    if delay_samples:
        h = h.plus(EffectTerm(Delay, {"delay_s": delay_samples / FS_HZ}))
    if lag_hz:
        h = h.plus(EffectTerm(AmplifierLag, {"cutoff_hz": lag_hz}))
    assert is_whole(chain, fit(chain, h, iterations=0)) is expected


def test_a_fit_with_a_small_backlash_is_as_good_as_one_without() -> None:
    chain = Chain(prepared([record(multisine(4000)), record(triangles(4000), name="b")]))
    plays = Hypothesis(many_plays(seen(chain.records)))
    small = EffectTerm(Backlash, {"width_um": 1e-3})
    assert fit(chain, plays.plus(small)).train_rms < 1.1 * fit(chain, plays).train_rms


@pytest.mark.parametrize("times", [1e-6, 1e3])
def test_bounds_of_shape_parameters_scale_with_the_voltage(times: float) -> None:
    for name, power in (("sigma_v", 1), ("alpha_per_v", -1), ("beta", 0)):
        one, other = shape_slot(name, 2.0), shape_slot(name, 2.0 * times)
        assert (other.low, other.high) == pytest.approx((one.low * times**power, one.high * times**power))
