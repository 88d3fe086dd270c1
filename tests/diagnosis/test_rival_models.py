"""The models around a final hypothesis: what was, or may be, tried in place of each effect."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from torchpi.diagnosis import rival_models
from torchpi.diagnosis.hypothesis import EffectTerm, Hypothesis
from torchpi.diagnosis.hysteresis_model import HysteresisModel
from torchpi.diagnosis.rival_models import (
    CONVENTION,
    OPERATOR_NAME,
    Model,
    each_of,
    groups,
    names_of,
    rivals,
    settled,
)
from torchpi.diagnosis.score import Gain
from torchpi.stage.effects.actuator.ageing import Ageing
from torchpi.stage.effects.actuator.creep import Creep
from torchpi.stage.effects.actuator.hysteresis_asymmetry import HysteresisAsymmetry
from torchpi.stage.effects.amplifier.amplifier_lag import AmplifierLag
from torchpi.stage.effects.amplifier.delay import Delay
from torchpi.stage.effects.amplifier.slew_limit import SlewLimit
from torchpi.stage.effects.effect import Effect
from torchpi.stage.effects.mechanics.backlash import Backlash
from torchpi.stage.effects.mechanics.load_change import LoadChange
from torchpi.stage.effects.mechanics.resonance import Resonance
from torchpi.stage.effects.sensor.gain_modulation import GainModulation
from torchpi.stage.effects.sensor.sensor_lag import SensorLag
from torchpi.stage.effects.sensor.sensor_nonlinearity import SensorNonlinearity
from torchpi.stage.effects.sensor.thermal_drift import ThermalDrift


def test_names_of_returns_the_effects_in_an_explanation() -> None:
    assert names_of("resonance + cross_coupling") == ["resonance", "cross_coupling"]
    assert names_of("hysteresis_operator: preisach") == ["hysteresis_operator"]
    assert names_of(None) == []


def test_the_alternatives_of_an_effect_are_effects_though_a_pair_stands_in_its_place() -> None:
    labels = ["slew_limit", "sensor_lag + delay", "hysteresis_operator: preisach"]
    assert each_of(labels, "delay") == ("slew_limit", "sensor_lag", OPERATOR_NAME)


def test_an_effect_that_came_by_exchange_competes_with_the_one_it_replaced() -> None:
    """A sufficiently soft slew limit is a lag; here it replaced the lag accepted before."""
    lag, slew = EffectTerm(AmplifierLag, {"cutoff_hz": 250.0}), EffectTerm(SlewLimit, {"rate_v_per_s": 7e3})
    less = Hypothesis(HysteresisModel(np.zeros(1)))
    fitted = SimpleNamespace(hypothesis=less.plus(lag))
    taken = SimpleNamespace(
        accepted="amplifier_lag", tried=(SimpleNamespace(name="amplifier_lag", fit=fitted),)
    )
    search = SimpleNamespace(effects_tried=[], alignments=(0, 1))
    small = SimpleNamespace(hypothesis=less.plus(slew), weights=np.zeros(1))
    found = rivals(search, [taken], "slew_limit", less, small)
    assert [label for label, _, _ in found] == ["amplifier_lag"]
    assert found[0][1].names == ("amplifier_lag",)


@pytest.mark.parametrize(
    ("effect", "alignment", "rivals_at"),
    [(Delay, 0, [1]), (Delay, 1, [0]), (AmplifierLag, 0, [1]), (AmplifierLag, 1, [0]), (Creep, 1, [])],
)
def test_an_effect_that_delays_competes_with_every_other_timing_convention(
    effect: type[Effect], alignment: int, rivals_at: list[int]
) -> None:
    less = Hypothesis(HysteresisModel(np.zeros(1)), alignment=alignment)
    search = SimpleNamespace(effects_tried=[effect], alignments=(0, 1), by_form=list)
    small = SimpleNamespace(hypothesis=less.plus(EffectTerm(effect, {})), weights=np.zeros(1))
    found = rivals(search, [], effect.name, less, small)
    assert [h.alignment for label, h, _ in found if label == CONVENTION] == rivals_at


def test_a_lag_competes_with_all_that_delays_from_the_start_and_convention_that_leave_least(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    less = Hypothesis(HysteresisModel(np.zeros(1)))
    lag = EffectTerm(SensorLag, {"cutoff_hz": 50.0})
    delays = [EffectTerm(Delay, {"delay_s": one}) for one in (1e-4, 2.5e-3, 1e-1)]
    others = [[EffectTerm(effect, {})] for effect in (SlewLimit, Creep)]
    search = SimpleNamespace(
        effects_tried=[Delay, SlewLimit, Creep, SensorLag],
        alignments=(0, 1),
        by_form=lambda: [delays, *others, [lag]],
        chain=None,
    )

    def misfit(chain: None, one: Hypothesis, weights: np.ndarray) -> float:
        late_s = one.members[0].shared.get("delay_s", 0.0) + 1e-3 * one.alignment
        return abs(late_s - 3.2e-3)

    monkeypatch.setattr(rival_models, "sum_of_squares", misfit)
    small = SimpleNamespace(hypothesis=less.plus(lag), weights=np.zeros(1))
    found = [one for one in rivals(search, [], "sensor_lag", less, small) if one[0] != CONVENTION]
    assert [label for label, _, _ in found] == ["delay", "slew_limit"]
    assert [h.alignment for _, h, _ in found] == [1, 1]
    assert found[0][1].members[0].shared == {"delay_s": 2.5e-3}


def test_a_slow_effect_competes_with_every_form_of_all_others_that_are_slow(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """On a sine about a bias a gain that falls with travel leaves 76 nm of 324, a linear drift 79 nm."""
    less = Hypothesis(HysteresisModel(np.zeros(1)))
    linear, settling = {"rate_um_per_s": 1.0}, {"amplitude_um": 1.0}
    slow = [EffectTerm(ThermalDrift, one) for one in (linear, settling)]
    slow.append(EffectTerm(GainModulation, {}))
    search = SimpleNamespace(
        effects_tried=[Ageing, ThermalDrift, GainModulation, Delay],
        alignments=(0, 1),
        by_form=lambda: [[one] for one in (*slow, EffectTerm(Ageing, {}), EffectTerm(Delay, {}))],
        chain=None,
    )
    monkeypatch.setattr(rival_models, "sum_of_squares", lambda chain, one, weights: 0.0)
    small = SimpleNamespace(hypothesis=less.plus(EffectTerm(Ageing, {})), weights=np.zeros(1))
    found = rivals(search, [], "ageing", less, small)
    assert [label for label, _, _ in found] == ["thermal_drift", "thermal_drift", "gain_modulation"]
    assert [h.members[0].shared for _, h, _ in found[:2]] == [linear, settling]


@pytest.mark.parametrize("before_at", [0, 1])
def test_a_lag_competes_with_what_was_there_before_it_at_another_timing_convention(
    before_at: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Modes that were fitted beside a lag take long to follow another convention; those before it did not."""
    monkeypatch.setattr(rival_models, "reduced", lambda chain, fit: fit)
    lag = EffectTerm(AmplifierLag, {"cutoff_hz": 250.0})
    resonance, creep = EffectTerm(Resonance, {"frequency_hz": 800.0}), EffectTerm(Creep, {"tau_s": 1.0})
    first = Hypothesis(HysteresisModel(np.zeros(1)), (resonance,), alignment=before_at)
    moved = replace(resonance, shared={"frequency_hz": 700.0})
    less = Hypothesis(HysteresisModel(np.zeros(1)), (creep, moved))
    rounds = [
        SimpleNamespace(before=SimpleNamespace(hypothesis=h, weights=np.full(1, k)), accepted="", tried=())
        for k, h in enumerate((replace(first, members=()), first, less.plus(lag)))
    ]
    search = SimpleNamespace(effects_tried=[AmplifierLag], alignments=(0, 1), by_form=list, chain=None)
    small = SimpleNamespace(hypothesis=less.plus(lag), weights=np.zeros(1))
    found = [(h, w) for label, h, w in rivals(search, rounds, "amplifier_lag", less, small)][1:]
    assert [(h.alignment, h.members) for h, _ in found] == [(1, (creep, resonance))] * before_at
    assert [w[0] for _, w in found] == [1] * before_at


def settled_among(
    models: list[Model],
    ahead: Gain,
    monkeypatch: pytest.MonkeyPatch,
    beyond: float = 1.0,
    faint: bool = True,
    **asked: Any,
) -> SimpleNamespace:
    """Return the choice among the final fit, a bare one, and an equally good rival that is so far ahead, and
    leaves in addition that share of both."""
    final, bare, rival = (model.fit for model in models)
    monkeypatch.setattr(rival_models, "around", lambda *given: models)
    monkeypatch.setattr(rival_models, "reduced", lambda chain, fit: fit)
    monkeypatch.setattr(rival_models, "prior", lambda *given: 0.0)
    search = SimpleNamespace(
        chain=SimpleNamespace(weighting=SimpleNamespace(explained_of_all=lambda more, less: beyond)),
        slips=None,
        weigh=lambda fit: None,
        log=lambda text: None,
        on_its_rows=lambda fit: fit,
        faint=lambda more, less: faint and less is rival,
        bends_to_all=lambda larger, less: False,
        over=lambda better, worse, prior: ahead,
    )
    vars(search).update(asked)
    return settled(search, bare, final, [])[0]


@pytest.mark.parametrize("bends", [True, False])
def test_a_larger_hysteresis_that_explains_a_little_of_everything_replaces_no_effect(
    bends: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    h = Hypothesis(HysteresisModel(np.zeros(0)))
    drift, plain, larger = (SimpleNamespace(slots=(), train_rms=1.0, hypothesis=h) for _ in range(3))
    models = [
        Model("", "", drift),
        Model("thermal_drift", "", plain),
        Model("thermal_drift", OPERATOR_NAME, larger),
    ]
    final = settled_among(models, Gain(20.0, 1.0), monkeypatch, bends_to_all=lambda one, now: bends)
    assert final is (drift if bends else larger)


@pytest.mark.parametrize(("nats", "swapped"), [(-70.0, False), (-30.0, True), (-1.0, True)])
def test_a_rival_with_fewer_parameters_is_chosen_unless_it_predicts_much_worse(
    nats: float, swapped: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    h = Hypothesis(HysteresisModel(np.zeros(0)))
    hum, plain, ageing = (SimpleNamespace(slots=(0,) * k, train_rms=1.0, hypothesis=h) for k in (5, 0, 2))
    models = [Model("", "", hum), Model("hum", "", plain), Model("hum", "ageing", ageing)]
    final = settled_among(models, Gain(nats, 36.0), monkeypatch)
    assert final is (ageing if swapped else hum)


@pytest.mark.parametrize("grown", [True, False])
def test_effects_that_may_replace_each_other_form_one_group(grown: bool) -> None:
    """A larger hysteresis may replace static effects, but not those that one recording has alone."""
    plain = Hypothesis(HysteresisModel(np.linspace(0, 1, 9)))
    h = replace(plain, nominal=replace(plain.nominal, pieces=5)) if grown else plain
    for effect in (
        AmplifierLag,
        Creep,
        Delay,
        ThermalDrift,
        GainModulation,
        SensorNonlinearity,
        LoadChange,
        HysteresisAsymmetry,
    ):
        h = h.plus(EffectTerm(effect, {}))
    fit, before = SimpleNamespace(hypothesis=h), SimpleNamespace(hypothesis=plain)
    search = SimpleNamespace(added=lambda one: list(one.hypothesis.names))
    assert {frozenset(group) for group in groups(search, fit, before)} == {
        frozenset({"amplifier_lag", "delay"}),
        frozenset({"creep", "thermal_drift", "gain_modulation"}),
        frozenset({"sensor_nonlinearity", "hysteresis_asymmetry", *([OPERATOR_NAME] if grown else [])}),
    }


def test_an_effect_in_its_form_with_more_parameters_also_rivals_a_larger_hysteresis() -> None:
    one, two = ({"a3_per_um2": 1e-3}, {"a2_per_um": 1e-2, "a3_per_um2": 1e-3})
    less = Hypothesis(HysteresisModel(np.zeros(1)))
    few, more = (less.plus(EffectTerm(SensorNonlinearity, each)) for each in (one, two))
    bent = SimpleNamespace(name="sensor_nonlinearity", fit=SimpleNamespace(hypothesis=few))
    taken = SimpleNamespace(accepted="hysteresis_operator: preisach", name="", tried=(bent,))
    search = SimpleNamespace(effects_tried=[], alignments=(0, 1), richer=lambda h, name: more)
    small = SimpleNamespace(hypothesis=less, weights=np.zeros(1))
    found = rivals(search, [taken], OPERATOR_NAME, less, small)
    assert [h.members[0].shared for _, h, _ in found] == [one, two]


@pytest.mark.parametrize(("effect", "given_way"), [(SensorNonlinearity, True), (Backlash, False)])
def test_a_larger_hysteresis_gives_way_to_an_equally_good_effect_that_is_not_hysteretic(
    effect: type[Effect], given_way: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    h = Hypothesis(HysteresisModel(np.zeros(0)))
    larger, plain = (SimpleNamespace(slots=(), train_rms=1.0, hypothesis=h) for _ in range(2))
    bent = SimpleNamespace(slots=(1, 2), train_rms=1.0, hypothesis=h.plus(EffectTerm(effect, {})))
    models = [Model("", "", larger), Model(OPERATOR_NAME, "", plain), Model(OPERATOR_NAME, effect.name, bent)]
    final = settled_among(models, Gain(-10.0, 20.0), monkeypatch)
    assert final is (bent if given_way else larger)


@pytest.mark.parametrize("bends", [True, False])
def test_a_larger_hysteresis_gives_way_if_it_explains_no_more_than_a_little_of_everything(
    bends: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Among many samples a tenth of the noise is significant, but hundreds of weights predict worse."""
    h = Hypothesis(HysteresisModel(np.zeros(0)))
    larger, plain = (SimpleNamespace(slots=(), train_rms=1.0, hypothesis=h) for _ in range(2))
    bent = SimpleNamespace(slots=(1,), train_rms=1.0, hypothesis=h.plus(EffectTerm(SensorNonlinearity, {})))
    models = [
        Model("", "", larger),
        Model(OPERATOR_NAME, "", plain),
        Model(OPERATOR_NAME, "sensor_nonlinearity", bent),
    ]
    final = settled_among(
        models, Gain(-450.0, 80.0), monkeypatch, bends_to_all=lambda one, now: bends and now is bent
    )
    assert final is (bent if bends else larger)


@pytest.mark.parametrize("replaced", [OPERATOR_NAME, f"{OPERATOR_NAME} + incongruent_loops"])
@pytest.mark.parametrize(
    ("effect", "without", "beyond", "given_way"),
    [
        (SensorNonlinearity, 1.2, 0.24, True),
        (SensorNonlinearity, 1.2, 0.6, False),
        (SensorNonlinearity, 0.6, 0.24, False),
        (Backlash, 1.2, 0.24, False),
        (GainModulation, 1.2, 0.24, False),
    ],
)
def test_a_larger_hysteresis_gives_way_to_a_static_effect_beyond_which_it_explains_little(
    effect: type[Effect],
    without: float,
    beyond: float,
    given_way: bool,
    replaced: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """On a motor with a cubic sensor an operator left 0.11 µm² of 1.45, the sensor's two numbers 0.14 µm²."""
    h = Hypothesis(HysteresisModel(np.zeros(0)))
    larger, plain = (SimpleNamespace(slots=(), train_rms=um, hypothesis=h) for um in (0.331, without))
    bent = SimpleNamespace(slots=(1,), train_rms=0.379, hypothesis=h.plus(EffectTerm(effect, {})))
    models = [
        Model("", "", larger),
        Model(replaced, "", plain),
        Model(replaced, effect.name, bent),
    ]
    final = settled_among(models, Gain(-450.0, 80.0), monkeypatch, beyond, faint=False)
    assert final is (bent if given_way else larger)
