"""The search: which candidates it tries, and which of two fits it continues with."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from tests.diagnosis.plants import (
    FS_HZ,
    NOISE_UM,
    Signal,
    lag,
    multisine,
    record,
    resonance,
    stairs,
    triangles,
)
from tests.diagnosis.prepared import prepared
from torchpi.diagnosis import growth
from torchpi.diagnosis.chain import Chain
from torchpi.diagnosis.contest import ACCEPTED, Tried
from torchpi.diagnosis.exchange import effects_of
from torchpi.diagnosis.fit import FINE, ROUGH, fit
from torchpi.diagnosis.hypothesis import EffectTerm, Hypothesis
from torchpi.diagnosis.noise import measured_noise
from torchpi.diagnosis.score import Gain
from torchpi.diagnosis.search import Search
from torchpi.diagnosis.timing import lateness_s
from torchpi.stage.effects.actuator.creep import Creep
from torchpi.stage.effects.actuator.input_nonlinearity import InputNonlinearity
from torchpi.stage.effects.amplifier.amplifier_lag import AmplifierLag
from torchpi.stage.effects.amplifier.delay import Delay
from torchpi.stage.effects.amplifier.slew_limit import SlewLimit
from torchpi.stage.effects.effect import DataRange
from torchpi.stage.effects.mechanics.cross_coupling import CrossCoupling
from torchpi.stage.effects.mechanics.resonance import Resonance
from torchpi.stage.effects.mechanics.second_mode import SecondMode
from torchpi.stage.effects.sensor.gain_modulation import GainModulation
from torchpi.stage.effects.sensor.sensor_lag import SensorLag
from torchpi.stage.effects.sensor.sensor_nonlinearity import SensorNonlinearity


@pytest.mark.parametrize(
    ("bounded", "rms", "taken"), [((), 0.5, True), (("beta",), 0.5, False), ((), 1.5, False)]
)
def test_a_refit_is_accepted_if_it_leaves_less_and_reaches_no_bound(
    bounded: tuple[str, ...], rms: float, taken: bool
) -> None:
    before, after = (
        SimpleNamespace(
            bounded=each,
            on_a_bound=[SimpleNamespace(name=name, member=-1) for name in each],
            train_rms=size,
            hypothesis=SimpleNamespace(members=(), shape=(), nominal=SimpleNamespace(pieces=1)),
            weights=None,
        )
        for each, size in (((), 1.0), (bounded, rms))
    )
    search = object.__new__(Search)
    weighting = SimpleNamespace(log_density=lambda fit: np.array([0.0 if fit is after else -1.0]))
    search.chain, search.repeating = SimpleNamespace(weighting=weighting), []
    search.weigh, search.fits_here = lambda fit: None, lambda jobs: [after]
    assert search.at_its_own_weights(before) is (after if taken else before)
    assert search.chain.weighting is weighting


def test_the_log_counts_effects_of_the_same_name() -> None:
    names = ("cross_coupling", "cross_coupling", "resonance", *["second_mode"] * 10)
    fit = SimpleNamespace(hypothesis=SimpleNamespace(names=names))
    assert effects_of(fit) == "cross_coupling (2), resonance, second_mode (10)"
    assert effects_of(SimpleNamespace(hypothesis=SimpleNamespace(names=()))) == ""


def test_of_several_modes_one_has_to_be_well_below_half_of_the_sample_rate() -> None:
    search = object.__new__(Search)
    search.seen, search.given = DataRange(1e3, 1.0, 0.0, 10.0, 100.0, 0, 1, {}), set()
    low, high = (EffectTerm(SecondMode, {"frequency_hz": f, "damping_ratio": 0.02}) for f in (300.0, 480.0))
    assert search.within_reach([low, high]) and not search.within_reach([high])


def test_an_addition_is_barred_by_its_own_bound_or_unreached_limit_and_not_by_earlier_ones() -> None:
    soft = EffectTerm(SlewLimit, {"rate_v_per_s": 900.0, "knee_v": 1.0})
    creep = EffectTerm(Creep, {"per_decade": 0.01})
    search = object.__new__(Search)
    search.seen = DataRange(1e3, 1.0, 0.0, 10.0, 100.0, 0, 1, {}, peak_rate_v_s=500.0)
    search.repeating, search.given = [], set()

    def fitted(*members: EffectTerm, bounded: int | None = None) -> SimpleNamespace:
        slots = [] if bounded is None else [SimpleNamespace(name="a number", member=bounded)]
        return SimpleNamespace(hypothesis=SimpleNamespace(members=members), bounded=(), on_a_bound=slots)

    now, more = fitted(soft), fitted(soft, creep)
    assert search.inside(more, now) and not search.within_reach([soft, creep])
    assert not search.within_reach([soft]) and search.within_reach([creep])
    search.given = {"slew_limit"}  # which the recordings need not reach if it is the simulation's own
    assert search.within_reach([soft, creep])
    search.given = set()
    assert not search.inside(fitted(soft), fitted())
    assert search.inside(fitted(soft, creep, bounded=0), now)
    assert not search.inside(fitted(soft, creep, bounded=1), now)
    assert not search.inside(fitted(soft, bounded=0), now)


@pytest.mark.parametrize(("member", "dropped"), [(2, False), (-1, True)])
def test_a_larger_hysteresis_is_dropped_only_if_its_own_parameters_reach_a_bound(
    member: int, dropped: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fitted(family: str, train_rms: float) -> SimpleNamespace:
        nominal = SimpleNamespace(family=family)
        return SimpleNamespace(
            hypothesis=SimpleNamespace(nominal=nominal, names=("creep",), on=lambda other: other),
            train_rms=train_rms,
            on_a_bound=[SimpleNamespace(name="a number", member=member)],
        )

    larger, plain = fitted("bouc_wen", 0.03), fitted("prandtl_ishlinskii", 0.3)
    search = object.__new__(Search)
    search.nominal, search.given, search.rejected_families = plain.hypothesis.nominal, set(), set()
    search.fits, search.at_its_own_weights = lambda jobs: [plain], lambda fit: fit
    search.as_well, search.log, search.chain = lambda one, best: False, lambda text: None, None
    monkeypatch.setattr(growth, "refitted", lambda chain, fit: fit)
    assert search.no_larger(larger) is (plain if dropped else larger)


def test_a_mode_behind_a_held_voltage_is_tried_with_a_hold() -> None:
    def mode(x: np.ndarray, fs_hz: float) -> np.ndarray:
        """Mode of 840 Hz under a voltage that is held and one sample late, in finer steps."""
        fine, moved, rate = np.repeat(np.append(0.0, x[:-1]), 64), np.empty(64 * len(x)), 0.0
        w, dt, at = 2 * np.pi * 840.0, 1 / fs_hz / 64, 0.0
        for k, pulled in enumerate(fine):
            rate += dt * (w * w * (pulled - at) - 0.04 * w * rate)
            at += dt * rate
            moved[k] = at
        return moved[63::64]

    u = multisine(2000, high_hz=0.45 * FS_HZ)
    search = Search(Chain(prepared([record(u, after=mode)])), lambda sentence: None)
    tried = search.at_other_conventions(search.retuned(), search.starts)
    assert tried["resonance"].held


def test_a_curvature_mistaken_for_a_history_is_tried_without_the_history() -> None:
    def bent(x: Signal, fs_hz: float) -> Signal:
        return x / (1 - 0.03 * x)

    recordings = [record(triangles(4000), seed=1, after=bent), record(stairs(4000), seed=2, after=bent)]
    search = Search(Chain(prepared(recordings)), lambda sentence: None, effects=[SensorNonlinearity])
    now = search.reweighted(search.retuned())
    ((_, found),) = search.effects(now)
    assert now.hypothesis.remanent and not found.hypothesis.remanent
    assert found.train_rms < 2 * NOISE_UM < 0.1 * now.train_rms


def test_two_lags_in_place_of_a_lag_and_a_delay_are_exchanged_for_these() -> None:
    """No exchange of a single effect for another leads to this result."""

    def late(v: Signal, fs_hz: float) -> Signal:
        k = np.arange(len(v))
        return np.interp(k - 5.5, k, lag(v, fs_hz, 120.0))

    recordings = [
        record(u, seed=seed, before=late) for seed, u in enumerate((multisine(4000), triangles(4000)))
    ]
    tried = [AmplifierLag, SensorLag, Delay]
    search = Search(Chain(prepared(recordings)), lambda sentence: None, effects=tried)
    h = replace(search.retuned().hypothesis, alignment=0)
    for effect, cutoff_hz in ((AmplifierLag, 150.0), (SensorLag, 200.0)):
        h = h.plus(EffectTerm(effect, {"cutoff_hz": cutoff_hz, "damping_ratio": 0.7}))
    (two,) = search.fits([(h, None, 12, ROUGH)])
    exchanged = search.swapped(two)
    (found,) = search.fits([(exchanged.hypothesis, exchanged.weights, 20, FINE)])
    (values,) = ({**m.shared} for m in found.hypothesis.members if m.effect is AmplifierLag)
    assert found.hypothesis.names == ("amplifier_lag", "delay")
    assert values["cutoff_hz"] == pytest.approx(120.0, rel=0.05)
    assert found.train_rms < 0.5 * two.train_rms
    for one in search.as_a_lag_and_a_delay(two.hypothesis):
        assert lateness_s(search.chain, one) == pytest.approx(lateness_s(search.chain, two.hypothesis))


def test_a_curve_with_more_parameters_is_found_from_the_fit_of_one_with_fewer() -> None:
    """A hundred plays bend with it, so at first a fit of both parameters is worse than a fit of one."""

    def bent(v: Signal, fs_hz: float) -> Signal:
        return v + 0.01 * v**2 - 0.001 * v**3

    recordings = [record(u, seed=k, before=bent) for k, u in enumerate((triangles(3000), stairs(3000)))]
    search = Search(Chain(prepared(recordings)), lambda sentence: None, effects=[InputNonlinearity])
    now = search.reweighted(search.retuned())
    ((_, found),) = search.effects(now)
    assert {*found.hypothesis.members[0].shared} == {"c2_per_v", "c3_per_v2"}
    assert found.train_rms < 0.3 * now.train_rms


def test_a_form_with_more_parameters_starts_from_the_values_of_one_with_fewer() -> None:
    search = Search(Chain(prepared([record(multisine(3000))])), lambda sentence: None)
    h = search.retuned().hypothesis.plus(EffectTerm(InputNonlinearity, {"c3_per_v2": 1e-3}))
    more = search.richer(h, "input_nonlinearity")
    assert more is not None and more.members[0].shared["c3_per_v2"] == 1e-3
    assert len(more.members[0].shared) == 2
    assert search.richer(more, "input_nonlinearity") is None
    assert search.richer(h, "creep") is None


def test_a_lag_and_a_delay_are_tried_together_if_a_two_pole_lag_imitates_both() -> None:
    def late(x: Signal, fs_hz: float) -> Signal:
        k = np.arange(len(x))
        return np.interp(k - 1.8, k, x)

    u = multisine(4000, high_hz=0.4 * FS_HZ)
    recordings = [record(u, before=lambda v, fs_hz: lag(v, fs_hz, 300.0), after=late)]
    search = Search(Chain(prepared(recordings)), lambda sentence: None, effects=[AmplifierLag, Delay])
    now = search.reweighted(search.retuned())
    found = dict(search.effects(now))
    alone = min(one.train_rms for name, one in found.items() if "+" not in name)
    (together,) = (one for name, one in found.items() if "+" in name)
    assert together.train_rms < 0.5 * alone
    lagged, _ = sorted(together.hypothesis.members, key=lambda member: member.effect.name)
    assert lagged.shared == {"cutoff_hz": pytest.approx(300.0, rel=0.05)}


@pytest.mark.parametrize(("share", "refitted"), [(0.9, 1), (0.1, 0)])
def test_a_larger_hysteresis_that_explains_a_little_of_everything_is_not_reweighted(
    share: float, refitted: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is rejected whatever its own weights say, and the plays it would have to beat are not fitted."""
    nominal = SimpleNamespace(family="plays", has_states=False)
    now, larger = (SimpleNamespace(hypothesis=SimpleNamespace(nominal=nominal), train_rms=1.0) for _ in "ab")
    weighed, search = list[object](), object.__new__(Search)
    weighting = SimpleNamespace(explained_of_all=lambda more, less: share, token="")
    search.chain, search.simulation, search.noise = SimpleNamespace(weighting=weighting), None, None
    search.rejected_families = set()
    search.on, search.of_its_plays = lambda h, one: h, lambda one, fit: fit
    search.raced, search.near = lambda jobs, fit: [larger], lambda one, fit: True
    search.over = lambda better, worse, prior=0.0: Gain(100.0, 1.0)
    search.score = lambda fit: 0.0
    search.at_its_own_weights = lambda fit: weighed.append(fit) or fit
    monkeypatch.setattr(growth, "grown", lambda chain, h, fit, kept: (h, None))
    monkeypatch.setattr(growth, "refitted", lambda chain, fit, steps: fit)
    for _ in range(2):  # the families follow one another, but the plays are fitted once
        search.growth(now, now, [SimpleNamespace(family="preisach", has_states=False)])
    assert sum(one is larger for one in weighed) == 2 * refitted
    assert sum(one is now for one in weighed) == refitted


@pytest.mark.parametrize(
    ("beyond_um", "ahead", "accepted"), [(0.48, 90.0, "effect"), (0.3, 90.0, "larger"), (0.3, 1.0, "effect")]
)
def test_an_effect_comes_before_a_larger_hysteresis_that_explains_little_beyond_it(
    beyond_um: float, ahead: float, accepted: str
) -> None:
    """A Preisach operator also absorbs some of the lag that is still missing, so it is ahead of the cause."""
    now, curved, larger = (
        SimpleNamespace(train_rms=rms_um, hypothesis=SimpleNamespace(members=()))
        for rms_um in (1.0, 0.5, beyond_um)
    )
    search = object.__new__(Search)
    search.faint, search.adequate = lambda more, less: False, lambda more, less: True
    search.on_many_rows = lambda fit: fit
    search.bends_to_all = lambda one, fit: 1 - (one.train_rms / fit.train_rms) ** 2 < 0.25
    search.as_well = lambda one, best: ahead < 2.0
    tried = [
        Tried("hysteresis_operator: preisach", larger, Gain(500.0, 10.0)),
        Tried("sensor_nonlinearity", curved, Gain(500.0 - ahead, 10.0)),
    ]
    chosen = search.simplest(tried, now)
    assert chosen is not None and chosen.fit is (curved if accepted == "effect" else larger)


@pytest.mark.parametrize(("noise", "near", "tried"), [(True, True, 0), (False, False, 0), (False, True, 1)])
def test_states_are_tried_if_more_than_noise_is_left_and_a_preisach_operator_may_win(
    noise: bool, near: bool, tried: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    nominal = SimpleNamespace(family="plays", has_states=False)
    now, larger = (SimpleNamespace(hypothesis=SimpleNamespace(nominal=nominal), train_rms=1.0) for _ in "ab")
    search, begun = object.__new__(Search), list[object]()
    search.chain, search.simulation, search.rejected_families = SimpleNamespace(), None, set()
    search.is_noise, search.near = lambda fit: noise, lambda one, fit: near
    search.on, search.of_its_plays = lambda h, one: h, lambda one, fit: fit
    search.raced, search.earns = lambda jobs, fit: [larger], lambda one, fit: False
    search.of_states = lambda fit, starts: begun.append(starts) or larger
    search.over = lambda better, worse, prior=0.0: Gain(100.0, 1.0)
    monkeypatch.setattr(growth, "grown", lambda chain, h, fit, kept: (h, None))
    families = [
        SimpleNamespace(family=name, has_states=name != "preisach") for name in ("preisach", "bouc_wen")
    ]
    found = search.growth(now, now, families)
    assert len(begun) == tried and len(found) == (not noise) * (1 + tried)
    # With no other family left, there is nothing to tell whether a state may win, so it is tried.
    search.raced = lambda jobs, fit: []
    assert len(search.growth(now, now, families[1:])) == (not noise)


def test_a_gain_modulation_of_a_fifth_is_found_from_the_start_that_the_screen_chose() -> None:
    t = np.arange(4000) / FS_HZ
    recordings = [record(multisine(4000), after=lambda x, fs_hz: x * (1 + 0.2 * np.cos(2 * np.pi * 3.3 * t)))]
    search = Search(Chain(prepared(recordings)), lambda sentence: None, effects=[GainModulation])
    now = search.reweighted(search.retuned())
    ((_, found),) = search.effects(now)
    assert found.train_rms < 5 * NOISE_UM < 0.1 * now.train_rms


def test_motion_of_another_axis_during_holds_no_longer_counts_as_noise_once_explained() -> None:
    u, other = stairs(4000), np.cumsum(np.random.default_rng(5).standard_normal(4000))
    recordings = [record(u, after=lambda x, fs_hz: x + 0.02 * other, aux={"aux_other_v": other})]
    chain = Chain(prepared(recordings))
    search = Search(
        chain, lambda sentence: None, noise=measured_noise(chain.records), effects=[CrossCoupling]
    )
    loud = search.noise
    _, final, _ = search.run()
    assert final.hypothesis.names == ("cross_coupling",)
    assert loud and search.noise and search.noise.rms_um < 1.3 * NOISE_UM < 0.2 * loud.rms_um


@pytest.mark.parametrize(
    ("nats", "rms", "needless"), [(12.0, 0.5, False), (0.5, 0.5, True), (12.0, 0.999, True)]
)
def test_a_history_is_judged_by_the_start_of_each_recording(nats: float, rms: float, needless: bool) -> None:
    """It gains only in the first cell of each scale, which the scatter of the cells would call chance."""
    began, apart = (SimpleNamespace(train_rms=size) for size in (rms, 1.0))
    strata = np.repeat(np.arange(5), 24)
    gained = np.where(np.arange(120) % 24 == 0, nats, 0.0)
    density = {id(began): gained, id(apart): np.zeros(120)}
    search = object.__new__(Search)
    search.chain = SimpleNamespace(
        weighting=SimpleNamespace(log_density=lambda fit: density[id(fit)], strata=strata), records=[None]
    )
    assert search.over(began, apart).probability < ACCEPTED
    assert search.needs_no_history(began, apart) is needless


def test_a_given_mode_moves_across_many_widths_to_where_the_recordings_show_it() -> None:
    def rings(x: Signal, fs_hz: float) -> Signal:
        return resonance(x, fs_hz, 300.0, 0.01)

    chain = Chain(prepared([record(multisine(2000), after=rings)]))
    given = EffectTerm(Resonance, {"frequency_hz": 150.0, "damping_ratio": 0.01})
    search = Search(chain, lambda sentence: None, [given], effects=[Resonance])
    begun = fit(chain, Hypothesis(search.plays(), search.start), iterations=0)
    (mode,) = search.with_given_modes_moved(begun, begun.hypothesis).hypothesis.members
    assert mode.shared["frequency_hz"] == pytest.approx(300.0, rel=0.01)
