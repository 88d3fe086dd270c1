"""Probabilities: weights of hypotheses that are compared cell by cell."""

from collections.abc import Collection
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.diagnosis.plants import creep, lag, pair
from tests.diagnosis.prepared import prepared
from torchpi.diagnosis import diagnose
from torchpi.diagnosis.contest import FORM_ERROR, nearly_all
from torchpi.diagnosis.exchange import both_slow
from torchpi.diagnosis.hypothesis import EffectTerm, Fit, Hypothesis
from torchpi.diagnosis.hysteresis_model import HysteresisModel, plain
from torchpi.diagnosis.posterior import (
    AS_LIKELY,
    HALF,
    HYSTERESIS_ERROR,
    OF_MODES,
    SLOW_FORM_ERROR,
    Believed,
    already_late,
    apart,
    as_one,
    averaged,
    beyond_sealed_error,
    cannot_be_ruled_out,
    kin_if_the_same_each_time,
    no_likelier_than_unlisted,
    share_explained,
    stands_as_well,
    trust,
    unlisted_hysteresis,
    without_cause,
)
from torchpi.diagnosis.records import seen
from torchpi.diagnosis.rival_models import CONVENTION, OPERATOR_NAME, Model
from torchpi.stage.effects import EFFECTS
from torchpi.stage.effects.actuator.ageing import Ageing
from torchpi.stage.effects.actuator.creep import Creep
from torchpi.stage.effects.actuator.rate_dependent_hysteresis import RateDependentHysteresis
from torchpi.stage.effects.amplifier.amplifier_lag import AmplifierLag
from torchpi.stage.effects.amplifier.delay import Delay
from torchpi.stage.effects.amplifier.slew_limit import SlewLimit
from torchpi.stage.effects.effect import Effect
from torchpi.stage.effects.mechanics.backlash import Backlash
from torchpi.stage.effects.mechanics.modal import ModalSecondMode
from torchpi.stage.effects.mechanics.resonance import Resonance
from torchpi.stage.effects.mechanics.second_mode import SecondMode
from torchpi.stage.effects.sensor.gain_modulation import GainModulation
from torchpi.stage.effects.sensor.hum import Hum
from torchpi.stage.effects.sensor.sensor_lag import SensorLag
from torchpi.stage.effects.sensor.thermal_drift import ThermalDrift


def densities(models: int, cells: int, seed: int) -> np.ndarray:
    return np.random.default_rng(seed).normal(-20, 5, (models, cells))


@given(st.integers(1, 6), st.integers(2, 80), st.integers(0, 999))
def test_weights_sum_to_one(models: int, cells: int, seed: int) -> None:
    chance = averaged(densities(models, cells, seed), np.zeros(models))
    assert chance.sum() == pytest.approx(1.0) and (chance >= 0).all()


@given(st.integers(2, 5), st.integers(0, 999))
def test_equal_models_share_the_weight_equally(models: int, seed: int) -> None:
    density = np.tile(densities(1, 60, seed), (models, 1))
    assert averaged(density, np.zeros(models)) == pytest.approx(np.full(models, 1 / models))


def test_a_clearly_better_model_takes_nearly_all_the_weight() -> None:
    density = np.zeros((2, 60))
    density[1] = -np.random.default_rng(0).uniform(1, 3, 60)
    assert averaged(density, np.zeros(2))[0] > 0.999


def test_a_difference_in_one_cell_is_less_certain_than_the_same_spread_over_all_cells() -> None:
    one, all_ = np.zeros((2, 60)), np.zeros((2, 60))
    one[1, 7] = -8.0
    all_[1] = -8.0 / 60
    assert averaged(one, np.zeros(2))[0] < averaged(all_, np.zeros(2))[0]


def test_a_prior_counts_in_nats() -> None:
    chance = averaged(np.zeros((2, 30)), np.array([0.0, np.log(3.0)]))
    assert chance[1] / chance[0] == pytest.approx(3.0)


def test_the_same_densities_have_the_same_weights() -> None:
    density = densities(4, 50, 1)
    assert np.array_equal(averaged(density, np.zeros(4)), averaged(density.copy(), np.zeros(4)))


def chance(
    one: Believed, found: list[Believed], terms: dict[str, EffectTerm], own: Collection[str] = ()
) -> float:
    """Return the probability of an effect that would otherwise be certain."""
    return apart(one, found, terms, own).probability


@given(st.floats(1e-6, 1.0))
def test_the_form_error_of_an_effect_is_not_named_as_a_similar_effect(share: float) -> None:
    terms = {
        "amplifier_lag": EffectTerm(AmplifierLag, {"cutoff_hz": 250.0}),
        "delay": EffectTerm(Delay, {"delay_s": 1e-4}),
        "creep": EffectTerm(Creep, {"per_decade": 0.01}),
    }
    lag, late, slow = (
        Believed(name, 1.0, (), size, (), HALF) for name, size in zip(terms, (1.0, share, share), strict=True)
    )
    found = [lag, late, slow]
    assert chance(slow, found, terms) == 1.0
    assert chance(late, found, terms) == pytest.approx(1 / (1 + (FORM_ERROR / share) ** 2))
    assert chance(lag, found, terms) > 0.98
    assert apart(late, found, terms).form_of == ("amplifier_lag" if share < FORM_ERROR else "")
    assert apart(lag, found, terms).form_of == apart(slow, found, terms).form_of == ""
    # Effects that the two signals cannot separate are kin too: a drift may be the form error of creep.
    drift = Believed("thermal_drift", 1.0, (), share**2, (), HALF)
    terms["thermal_drift"] = EffectTerm(ThermalDrift, {}, ({"rate_um_per_s": 0.01},))
    assert chance(drift, [*found, drift], terms) == pytest.approx(chance(late, found, terms))
    operator = Believed(OPERATOR_NAME, 1.0, (), share, (), HALF)
    assert chance(operator, [*found, operator], terms) == chance(late, found, terms)
    # Backlash is a play like the others: the error of a wrong hysteresis family looks like backlash.
    terms["backlash"] = EffectTerm(Backlash, {"width_um": 0.01})
    lost, larger = (
        Believed("backlash", 1.0, (), share, (), HALF),
        Believed(OPERATOR_NAME, 1.0, (), 1.0, (), HALF),
    )
    assert chance(lost, [lost, larger], terms) == chance(late, found, terms)


def test_the_strongest_of_several_slow_effects_counts_with_what_the_others_take_over_from_it() -> None:
    """Left out, it is replaced by the others, which are the error of its law."""
    slow = {"creep": Creep, "thermal_drift": ThermalDrift, "gain_modulation": GainModulation}
    terms = {name: EffectTerm(effect, {}) for name, effect in slow.items()}
    found = [
        Believed(name, 1.0, (), size, (), HALF) for name, size in zip(slow, (0.3, 0.09, 0.05), strict=True)
    ]
    group = Believed(" + ".join(slow), 1.0, (), 1.0, (), HALF)

    def of(one: Believed, *together: Believed) -> float:
        return apart(one, found, terms, together=together).probability

    for one, alone in zip(found[1:], (0.09, 0.05), strict=True):
        assert of(one) == pytest.approx(1 / (1 + (FORM_ERROR * 0.3 / alone) ** 2))
        assert of(one, group) == pytest.approx(1 / (1 + (FORM_ERROR * (1.0 - alone) / alone) ** 2))
    assert of(found[0], group) == of(found[0]) > 0.99


@pytest.mark.parametrize("cause", [Resonance, SecondMode, AmplifierLag, SensorLag, Delay, SlewLimit])
def test_the_form_error_of_a_dynamic_effect_is_not_named_rate_dependence(cause: type[Effect]) -> None:
    terms = {one.name: EffectTerm(one, {}) for one in (cause, RateDependentHysteresis)}
    strong, weak = (
        Believed(name, 1.0, (), size, (), HALF) for name, size in zip(terms, (1.0, 0.03), strict=True)
    )
    assert apart(weak, [strong, weak], terms).form_of == cause.name
    assert chance(weak, [strong, weak], terms) < 0.1
    assert chance(strong, [strong, weak], terms) == 1.0


@pytest.mark.parametrize("late", [AmplifierLag, SensorLag, Delay])
def test_a_small_lag_beside_a_mode_has_to_explain_nearly_all_that_the_mode_leaves(late: type[Effect]) -> None:
    terms = {one.name: EffectTerm(one, {}) for one in (Resonance, late)}
    mode = Believed(Resonance.name, 1.0, (), 1.0, (), 0.99)

    def of(share: float, known: float) -> float:
        one = Believed(late.name, 1.0, (), share, (), known)
        return chance(one, [one, mode], terms)

    assert of(0.004, 0.95) < 0.1 < 0.89 < of(0.3, HALF) < of(0.01, 0.995)
    assert chance(mode, [mode, Believed(late.name, 1.0, (), 0.1, (), HALF)], terms) == 1.0


@given(st.floats(1e-6, 1.0))
def test_a_small_effect_beside_a_larger_hysteresis_is_doubted_without_its_own_signal(share: float) -> None:
    terms = {"hum": EffectTerm(Hum, {"frequency_hz": 50.0})}
    larger, hum = Believed(OPERATOR_NAME, 1.0, (), 1.0, (), HALF), Believed("hum", 1.0, (), share, (), HALF)
    assert chance(hum, [hum, larger], terms) == pytest.approx(1 / (1 + (HYSTERESIS_ERROR / share) ** 2))
    assert chance(hum, [hum, larger], terms, {"hum"}) == 1.0


def test_an_effect_that_explains_nearly_all_that_a_larger_hysteresis_leaves_is_not_its_error() -> None:
    terms = {"ageing": EffectTerm(Ageing, {"loss_per_mm": 1e-3}), "backlash": EffectTerm(Backlash, {})}
    larger = Believed(OPERATOR_NAME, 1.0, (), 1.0, (), 0.99)

    def of(name: str, known: float) -> float:
        one = Believed(name, 1.0, (), 2e-4, (), known)
        return apart(one, [one, larger], terms).probability

    assert of("ageing", HALF) < 0.01 and of("ageing", 0.98) > 0.6 and of("ageing", 0.99) > 0.8
    # An effect that is itself hysteretic may be entirely the error of the wrong family.
    assert of("backlash", 0.99) == of("backlash", HALF) < 0.01


@pytest.mark.parametrize("effect", [Resonance, SecondMode, ModalSecondMode])
def test_a_mode_is_hardly_mistaken_for_the_form_error_of_a_larger_hysteresis(effect: type[Effect]) -> None:
    mode = Believed(effect.name, 1.0, (), 1e-3, (), HALF)
    larger = Believed(OPERATOR_NAME, 1.0, (), 1.0, (), HALF)
    terms = {effect.name: EffectTerm(effect, {"frequency_hz": 50.0})}
    assert chance(mode, [mode, larger], terms) == pytest.approx(1 / (1 + (OF_MODES / 1e-3) ** 2))
    assert chance(mode, [mode, larger], terms) > 0.9
    # In one motion, a ring is a matter of the loop's shape.
    assert apart(mode, [mode, larger], terms, of_modes=HYSTERESIS_ERROR).probability < 0.2


@pytest.mark.parametrize(
    "term", [EffectTerm(Creep, {"per_decade": 0.01}), EffectTerm(SensorLag, {"cutoff_hz": 9.0})]
)
@pytest.mark.parametrize("acts", [0.5, -0.5])
def test_a_slow_effect_is_trusted_by_what_it_explains_after_the_fitted_samples(
    term: EffectTerm, acts: float
) -> None:
    """Errors of the model hide most of it where it was fitted; all of it shows, or fails, later."""
    records, rng = prepared(pair(4000)), np.random.default_rng(0)
    noise = [rng.normal(0, 0.01, len(one.u)) for one in records]
    ramp = [acts * np.where(one.held_out, 1.0, 0.3) for one in records]
    with_it, without = ([e + r for e, r in zip(noise, ramp, strict=True)], noise)[:: 1 if acts < 0 else -1]
    h = Hypothesis(plain(seen(records))).plus(term)
    more, less = (SimpleNamespace(hypothesis=h, residuals=e) for e in (with_it, without))
    weighting = SimpleNamespace(
        explained_where_it_acts=lambda more, less: 0.8,
        explained_of_all=lambda more, less: 0.2,
        nats_of_kinds=lambda more, less: np.zeros(3),
        mean_floor_um2=1e-4,
    )
    search = SimpleNamespace(chain=SimpleNamespace(records=records, weighting=weighting))
    known, shown = share_explained(search, more, [less], term.effect.name, False)
    if acts < 0:
        assert known < 0.1 and shown < 0.1
    elif term.effect is Creep:
        assert known == shown > 0.9
    else:
        assert known == pytest.approx(0.4) and shown > 0.9


def test_trust_in_an_effect_rises_with_the_share_it_explains() -> None:
    assert trust(0.5) < 0.25 < trust(HALF) < 0.5 < trust(0.85) < 1.0


@pytest.mark.parametrize(("sealed_um2", "chance"), [(0.0, 1.0), (1.0, 0.5), (10.0, 0.01)])
def test_an_effect_that_explains_less_than_the_error_of_the_sealed_samples_may_be_part_of_it(
    sealed_um2: float, chance: float
) -> None:
    assert beyond_sealed_error(1.0, sealed_um2) == pytest.approx(chance, abs=1e-3)


def test_the_error_of_the_sealed_samples_bears_only_on_fast_effects_without_a_signal_of_their_own(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def lagging(x: np.ndarray, fs_hz: float) -> np.ndarray:
        moved = lag(creep(x, fs_hz, 0.02), fs_hz, 150.0)
        return moved + 0.05 * np.sin(2 * np.pi * 50.0 * np.arange(len(x)) / fs_hz)

    monkeypatch.setattr("torchpi.diagnosis.posterior.beyond_sealed_error", lambda *_: 0.0)
    found = {effect.name for effect in diagnose(pair(2000, after=lagging)).effects}
    assert found == {Hum.name, Creep.name}


@pytest.mark.parametrize("taken", [0, 1])
@pytest.mark.parametrize("share", [0.2, 0.8])
@pytest.mark.parametrize("whole", [True, False])
def test_a_delay_explains_only_what_no_timing_convention_does_unless_that_leaves_most(
    share: float, taken: int, whole: bool
) -> None:
    final, alone, tick, lag, other = (
        SimpleNamespace(hypothesis=SimpleNamespace(alignment=k), score=score)
        for k, score in ((taken, 1.0), (0, -100.0), (1, -5.0), (taken, -1.0), (1, 0.0))
    )
    models: list[Any] = [
        Model("", "", cast(Fit, final)),
        Model("delay", CONVENTION if taken else "", cast(Fit, alone)),
        Model("delay", "" if taken else CONVENTION, cast(Fit, tick)),
        Model("delay", "amplifier_lag", cast(Fit, lag)),
        Model("creep", CONVENTION, cast(Fit, other)),
    ]

    def explained(more: Any, less: Any) -> float:
        assert (more, less) == (final, tick)
        return share

    def score(one: Any) -> float:
        return float(one.score)

    less = without_cause(models, "delay", score, explained, whole)
    assert less.fit == (alone if share > 0.5 and not whole else tick)
    assert without_cause(models[:2], "delay", score, explained, whole).fit == alone


@pytest.mark.parametrize(("effect", "tick", "late"), [(Delay, 1, True), (Delay, 0, False), (Creep, 1, False)])
def test_a_simulation_is_without_a_delay_only_if_its_timing_convention_is_the_same(
    effect: type[Effect], tick: int, late: bool
) -> None:
    h = SimpleNamespace(alignment=tick, members=(EffectTerm(effect, {}), EffectTerm(Hum, {})))
    final = cast(Fit, SimpleNamespace(hypothesis=h))
    less, retuned = (cast(Fit, SimpleNamespace(hypothesis=SimpleNamespace(alignment=a))) for a in (0, tick))
    assert already_late(retuned, less, final, {effect.name}) is late
    assert not already_late(retuned, less, final, {Hum.name})
    assert not already_late(retuned, retuned, final, {effect.name})


@pytest.mark.parametrize(
    ("name", "bends", "well", "alike"),
    [
        (OPERATOR_NAME, True, False, True),
        (OPERATOR_NAME, False, False, False),
        ("thermal_drift", True, False, False),
        ("thermal_drift", False, True, True),
    ],
)
def test_a_rival_cannot_be_told_from_a_larger_hysteresis_that_bends_to_everything(
    name: str, bends: bool, well: bool, alike: bool
) -> None:
    final, rival = SimpleNamespace(), SimpleNamespace()

    def beyond(larger: Any, effect: Any) -> bool:
        return (larger, effect) == (final, rival) and bends

    search = SimpleNamespace(
        bends_to_all=beyond, as_well=lambda one, best: (one, best) == (rival, final) and well
    )
    assert stands_as_well(search, name, rival, final) is alike


def test_a_slow_rival_that_leaves_little_more_remains_an_alternative() -> None:
    """A settling drift leaves 25 nm of 283 nm, a leakage 35 nm, perhaps because its law differs slightly."""
    of = {effect.name: effect for effect in EFFECTS}
    assert both_slow(of["thermal_drift"], of["leakage"]) and both_slow(of["leakage"], of["thermal_drift"])
    assert not both_slow(of["amplifier_lag"], of["sensor_lag"]) and both_slow(of["creep"], of["ageing"])
    less, leakage, creep, final = (SimpleNamespace(train_rms=nm) for nm in (282.9, 34.8, 136.2, 24.5))
    assert nearly_all(leakage, less, final, SLOW_FORM_ERROR)
    assert not nearly_all(creep, less, final, SLOW_FORM_ERROR)


@pytest.mark.parametrize(
    ("name", "instead", "leaves_um", "beyond", "stands"),
    [
        ("sensor_lag", "delay", 0.65, 0.3, True),  # 0.12 µm² more than the 0.3 µm² that two lags leave
        ("sensor_lag", "delay", 0.65, 0.6, False),
        ("sensor_lag", "creep", 0.65, 0.3, True),
        ("sensor_lag", "creep", 1.2, 0.3, False),
        ("sensor_lag", "creep", 0.65, 0.6, False),
        (OPERATOR_NAME, "delay", 0.65, 0.3, False),
    ],
)
def test_a_rival_is_ruled_out_by_more_than_what_the_best_fit_leaves_or_if_it_explains_less_and_is_no_kin(
    name: str, instead: str, leaves_um: float, beyond: float, stands: bool
) -> None:
    search: Any = SimpleNamespace(
        effects_tried=EFFECTS,
        chain=SimpleNamespace(weighting=SimpleNamespace(explained_of_all=lambda more, less: beyond)),
        as_well=lambda one, best: False,
        bends_to_all=lambda larger, less: False,
    )
    final, rival, less = (cast(Fit, SimpleNamespace(train_rms=um)) for um in (0.55, leaves_um, 3.1))
    assert cannot_be_ruled_out(search, name, Model(name, instead, rival), less, final) is stands


def test_the_strongest_of_interchangeable_effects_takes_their_joint_probability() -> None:
    lag = Believed("amplifier_lag", 0.1, (), 2.0, (), HALF)
    late = Believed("delay", 0.2, ("sensor_lag", OPERATOR_NAME), 1.0, (), HALF)
    slow = Believed("creep", 0.3, (), 5.0, (), HALF)
    together = [Believed("amplifier_lag + delay", 0.9, (), 7.0, (), HALF)]
    left_um = {"amplifier_lag": 1.5, "delay": 1.2, "creep": 2.0}
    kin_of = {"amplifier_lag": ("delay", "sensor_lag")}
    found = [as_one(one, [lag, late, slow], together, left_um, kin_of) for one in (lag, late, slow)]
    either = replace(lag, probability=0.9, alternatives=("delay", "sensor_lag"), explained_um2=7.0)
    assert found == [either, late, slow]
    sure = replace(lag, probability=0.95)
    assert as_one(sure, [sure, late, slow], together, left_um, kin_of) == sure
    # A delay is credited with all lateness, even a timing convention's, which makes it no stronger.
    larger = replace(late, explained_um2=3.0)
    assert as_one(larger, [lag, larger, slow], together, left_um, kin_of) == larger


def test_degeneracy_between_effects_is_declared_by_both() -> None:
    """To know whether two effects can be mistaken for one another, it suffices to ask either of them."""
    effects = {effect.name: effect for effect in EFFECTS}
    for name, effect in effects.items():
        assert all(name in effects[other].degenerate_with for other in effect.degenerate_with), name


def test_backlash_may_be_an_unlisted_hysteresis_unless_a_larger_hysteresis_was_accepted() -> None:
    plain = Hypothesis(HysteresisModel(np.linspace(0, 1, 9)))
    taken = plain.plus(EffectTerm(Backlash, {"width_um": 0.01})).plus(EffectTerm(Creep, {"per_decade": 0.01}))
    larger = taken.on(HysteresisModel(np.linspace(0, 1, 9), pieces=5))
    assert unlisted_hysteresis(taken, plain, "backlash") == [OPERATOR_NAME]
    assert unlisted_hysteresis(taken, plain, "creep") == unlisted_hysteresis(larger, plain, "backlash") == []


@pytest.mark.parametrize(
    ("amplitudes_um", "alike"),
    [((3.0, 3.1), True), ((3.0, 2.0), False), ((3.0, -3.0), False), ((3.0, 2.4, 2.5), True), ((3.0,), False)],
)
def test_a_drift_of_the_same_size_in_each_recording_may_follow_the_voltage(
    amplitudes_um: tuple[float, ...], alike: bool
) -> None:
    own = tuple({"amplitude_um": one} for one in amplitudes_um)
    drift = EffectTerm(ThermalDrift, {"time_constant_s": 8.0}, own)
    h = Hypothesis(HysteresisModel(np.zeros(1)), (drift,))
    assert kin_if_the_same_each_time(h, "thermal_drift") == (("leakage", "creep") if alike else ())
    beside_creep = h.plus(EffectTerm(Creep, {"per_decade": 0.01}))
    assert kin_if_the_same_each_time(beside_creep, "thermal_drift") == (("leakage",) if alike else ())
    assert kin_if_the_same_each_time(beside_creep, "creep") == ()


def test_what_a_larger_hysteresis_explains_as_well_is_no_likelier_than_it_from_loops_of_one_size() -> None:
    alone = Believed("hysteresis_operator", 0.98, (), 1.0, (), 0.9)
    found = [
        no_likelier_than_unlisted(replace(alone, name=name, alternatives=alternatives)).probability
        for name, alternatives in [
            ("hysteresis_operator", ()),
            ("hysteresis_operator", ("sensor_nonlinearity",)),
            ("hysteresis_asymmetry", ("input_nonlinearity", "hysteresis_operator")),
            ("creep", ("thermal_drift",)),
        ]
    ]
    assert found == [AS_LIKELY, AS_LIKELY, AS_LIKELY, 0.98]
