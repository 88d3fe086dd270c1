"""Remanence: the history before the first sample of a recording, modelled by columns that fade."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.diagnosis.plants import NOISE_UM, hysteresis, lag, multisine
from tests.diagnosis.prepared import prepared
from torchpi.diagnosis.chain import Chain
from torchpi.diagnosis.diagnose import diagnose
from torchpi.diagnosis.fit import ROUGH, fit
from torchpi.diagnosis.hypothesis import EffectTerm, Hypothesis
from torchpi.diagnosis.hysteresis_model import duhem as duhem_states
from torchpi.diagnosis.hysteresis_model import many_plays, preisach
from torchpi.diagnosis.records import seen
from torchpi.diagnosis.reduced_basis import MANY, basis, refitted
from torchpi.diagnosis.remanence import COLUMNS, EITHER, ONE_WAY, excursions, fading
from torchpi.diagnosis.search import Search
from torchpi.operators.hysteresis_rows import duhem
from torchpi.recordings.recording import Recording
from torchpi.stage.effects.sensor.sensor_lag import SensorLag
from torchpi.stage.effects.sensor.sensor_nonlinearity import SensorNonlinearity


def remembered(v: np.ndarray, seed: int) -> np.ndarray:
    """Return plays that start anywhere within their bands, from a history that is not de-energised."""
    rng = np.random.default_rng(seed)
    thresholds = rng.uniform(0.1, 5.0, 40)
    state, y = v[0] + thresholds * rng.uniform(-1, 1, 40), np.empty(len(v))
    for k, one in enumerate(v):
        state = np.maximum(one - thresholds, np.minimum(one + thresholds, state))
        y[k] = 0.5 * one + 1.0 * state.mean()
    return y


def history(v: np.ndarray, seed: int) -> Recording:
    noise = NOISE_UM * np.random.default_rng(100 + seed).standard_normal(len(v))
    return Recording(str(seed), np.arange(len(v)) / 2e3, v, remembered(v, seed) + noise, 2e3)


@pytest.mark.parametrize("seed", [1, 2])
def test_plays_with_remanence_columns_fit_a_history_that_plays_alone_do_not(seed: int) -> None:
    """The recording starts at 5 V from a history that de-energised plays cannot have."""
    v = np.roll(multisine(4000, high_hz=20.0), -1500)
    chain = Chain(prepared([history(v, seed)]))
    plays = Hypothesis(many_plays(seen(chain.records)))
    alone = fit(chain, plays).train_rms
    both = fit(chain, Hypothesis(plays.nominal, remanent=True)).train_rms
    assert both**2 - NOISE_UM**2 < 0.1 * (alone**2 - NOISE_UM**2)
    assert alone > 3 * NOISE_UM


@pytest.mark.parametrize("remembers", [True, False])
def test_the_need_for_a_history_is_decided_again_once_an_effect_is_known(remembers: bool) -> None:
    """Before, the missing effect may have hidden the history, or the history absorbed part of the effect."""
    v = np.roll(multisine(4000, high_hz=20.0), -1500)
    v = v if remembers else v - v[0]
    y = lag(remembered(v, 1) if remembers else hysteresis(v), 2e3, cutoff_hz=20.0)
    y += NOISE_UM * np.random.default_rng(0).standard_normal(len(v))
    chain = Chain(prepared([Recording("lagging", np.arange(len(v)) / 2e3, v, y, 2e3)]))
    search = Search(chain, lambda sentence: None)
    lagging = EffectTerm(SensorLag, {"cutoff_hz": 20.0})
    before = Hypothesis(many_plays(search.seen), (lagging,), remanent=not remembers)
    now = refitted(chain, fit(chain, before))
    search.weigh(now)
    assert search.realigned(now).hypothesis.remanent == remembers


@pytest.mark.parametrize("remembers", [True, False])
def test_a_larger_hysteresis_has_a_history_only_where_there_is_one(remembers: bool) -> None:
    """Without a history, a de-energised start predicts better, because its initial loading is known."""
    thresholds, made = np.array([0.0, 0.7, 2.3, 4.1]), []
    for seed in (1, 2):
        rng, v = np.random.default_rng(seed), multisine(6000, high_hz=40.0, seed=seed)
        state, y = thresholds * rng.uniform(-1, 1, 4) * remembers, np.empty(len(v))
        for k, one in enumerate(v):
            state = np.maximum(one - thresholds, np.minimum(one + thresholds, state))
            y[k] = state @ (0.5, 0.3, 0.2, 0.2) + (state[2] ** 2 + state[3] ** 2) / 125
        y += NOISE_UM * rng.standard_normal(len(v))
        made.append(Recording(str(seed), np.arange(len(v)) / 2e3, v, y, 2e3))
    chain = Chain(prepared(made))
    search = Search(chain, lambda sentence: None)
    remanent = Hypothesis(preisach(seen(chain.records)), remanent=True)
    now = fit(chain, *basis(chain, remanent, None, MANY))
    search.weigh(now)
    assert now.train_rms < 1.1 * NOISE_UM
    assert search.without_history(now).hypothesis.remanent == remembers


@given(st.integers(0, 999), st.integers(2, 400))
def test_columns_start_at_one_and_only_fall(seed: int, samples: int) -> None:
    v = np.cumsum(np.random.default_rng(seed).standard_normal(samples))
    columns = excursions(v)
    assert columns.shape == (COLUMNS, samples)
    one_way = int(v.max() > v[0]) + int(v.min() < v[0])
    assert columns[:, 0].sum() == len(EITHER) + one_way * len(ONE_WAY)
    assert (columns >= 0).all()
    assert (np.diff(columns, axis=1) <= 1e-12).all()


@pytest.mark.parametrize("sign", [1, -1])
def test_a_history_that_only_an_excursion_to_the_other_side_resets_is_modelled(sign: int) -> None:
    """Plays that start above the input stay there until it moves down, however often it has moved up."""
    stops = sign * np.array([0, 1.2, -1.3, 1.6, -1.7, 5.0, 0.0])
    v = np.interp(np.linspace(0, len(stops) - 1, 3000), np.arange(len(stops)), stops)
    thresholds = np.linspace(0.1, 2.6, 26)
    remanent, reset, apart = sign * 0.8 * thresholds, np.zeros(26), np.empty(len(v))
    for k, one in enumerate(v):
        remanent = np.maximum(one - thresholds, np.minimum(one + thresholds, remanent))
        reset = np.maximum(one - thresholds, np.minimum(one + thresholds, reset))
        apart[k] = (remanent - reset).mean()
    columns = excursions(v).T
    left = apart - columns @ np.linalg.lstsq(columns, apart, rcond=1e-9)[0]
    assert left @ left < 1e-4 * (apart @ apart)


def test_a_history_is_forgotten_once_the_largest_excursion_is_reached() -> None:
    v = np.concatenate([np.linspace(0, 5, 100), np.linspace(5, -8, 200), np.linspace(-8, 4, 100)])
    columns = excursions(v)
    assert columns[: len(EITHER), 299:].max() < 1e-12 < columns[len(EITHER) - 1, 290]


@given(st.integers(0, 99), st.floats(0.1, 4.0), st.integers(1, 4))
def test_the_initial_value_of_a_state_without_wiping_out_fades_as_its_column_does(
    seed: int, alpha: float, power: int
) -> None:
    """For dz = α|dv|(f(v) - z), whatever f and the path of v."""
    v = np.cumsum(np.random.default_rng(seed).standard_normal(200))
    states = np.array([0.3, -1.2])
    apart = [states[1] - states[0]]
    for now, before in zip(v[1:], v[:-1], strict=True):
        states = np.array([duhem(z, now, before, alpha, power) for z in states])
        apart.append(states[1] - states[0])
    size = abs(states).max() + 1.5
    assert np.allclose(apart, apart[0] * fading(v, alpha), atol=1e-12 * size, rtol=1e-6)


def drifting_loops() -> list[Recording]:
    """Repeated minor loops of a Duhem state drift towards the middle; those of plays never do."""
    t = np.arange(8000) / 2e3
    recordings = []
    for seed, offset in enumerate((2.0, 6.0)):
        v = np.minimum(t / 0.4, 1) * (
            offset + 1.5 * np.sin(2 * np.pi * 7 * t) + 1.5 * np.sin(2 * np.pi * 0.4 * t)
        )
        z, states = 0.0, np.empty(len(v))
        for k, (one, before) in enumerate(zip(v, np.concatenate([[0.0], v[:-1]]), strict=True)):
            z += (np.tanh(one / 4) - z) * -np.expm1(-0.4 * abs(one - before))
            states[k] = z
        y = v + 3.0 * states + NOISE_UM * np.random.default_rng(seed).standard_normal(len(v))
        recordings.append(Recording(str(seed), t, v, y, 2e3))
    return recordings


def test_drifting_minor_loops_are_fitted_by_a_duhem_operator() -> None:
    """It is tried at once and not after output functions, whose residual an effect could absorb."""
    log: list[str] = []
    found = diagnose(drifting_loops(), effects=[], log=log.append)
    assert [effect.name for effect in found.effects] == ["hysteresis_operator"]
    assert found.effects[0].parameters[0].value == "duhem"
    assert found.augmented.heldout_rms_um < 2 * NOISE_UM < 0.2 * found.retuned.heldout_rms_um
    assert not any("with hysteresis_operator: preisach" in line for line in log)


def test_the_only_effect_is_removed_if_a_larger_hysteresis_makes_it_redundant() -> None:
    chain = Chain(prepared(drifting_loops()))
    search = Search(chain, lambda sentence: None, effects=[SensorNonlinearity])
    retuned = search.retuned()
    search.nominal = retuned.hypothesis.nominal
    curved = next(start for start in search.starts if len(start.shared) == 2)
    (bent,) = search.fits([(retuned.hypothesis.plus(curved), None, 8, ROUGH)])
    assert search.backward(bent).hypothesis.names == (SensorNonlinearity.name,)
    larger = search.growth(bent, bent, [duhem_states(search.seen)])[0].fit
    assert larger.hypothesis.names == (SensorNonlinearity.name,)
    assert search.backward(larger).hypothesis.names == ()


def test_a_hold_never_forgets_and_causes_no_division_by_zero() -> None:
    assert np.array_equal(excursions(np.full(50, 3.0))[: len(EITHER)], np.ones((len(EITHER), 50)))


def bouc_wen_states(u: np.ndarray, start: float, sigma_v: float, beta: float, exponent: float) -> np.ndarray:
    """(time,), z driven by a voltage, (time,), V, linear between samples, in twenty Euler steps each."""
    v = np.interp(np.arange(len(u) * 20) / 20, np.arange(len(u)), u)
    z, states = start, np.empty(len(v))
    for k, dv in enumerate(np.diff(v, prepend=0.0)):
        z += dv / sigma_v * (1 - abs(z) ** exponent * (1 - beta + beta * np.sign(z * dv)))
        states[k] = z
    return states[::20]


@pytest.mark.parametrize("sigma_v", [15.0, 60.0, 100.0])
def test_a_bouc_wen_stage_with_a_history_is_explained_down_to_the_noise(sigma_v: float) -> None:
    """At ±80 V, far from the unit of its state, which starts where an earlier recording left it."""
    time, noise_um = np.arange(6000) / 120.0, 0.0015
    u = np.where(time > 3, -80 * np.exp(-time / 40) * np.sin(1.6 * (time - 3)), 0.0)
    y = -0.33 * u + 4.2 * bouc_wen_states(u, -0.17, sigma_v, 1.5, 1.2)
    y += np.random.default_rng(0).normal(0, noise_um, 6000)
    found = diagnose([Recording("decaying", time, u, y, 120.0)])
    assert [effect.name for effect in found.effects] == ["hysteresis_operator"]
    assert found.effects[0].parameters[0].value == "bouc_wen"
    assert found.augmented.heldout_rms_um < 1.3 * noise_um


def test_a_bouc_wen_stage_is_found_beneath_a_hundred_plays_that_nearly_fit_it() -> None:
    """Its reversals take more than the voltage range. Beside plays, and weighted by their residual, a state
    would stay at its starting point."""
    fs_hz, noise_um, rng = 2e3, 0.0008, np.random.default_rng(0)
    recordings = []
    for k, start in enumerate((-0.32, -0.37)):
        t = np.arange(5000) / fs_hz
        wave = np.sin(2 * np.pi * (3 + 2 * k) * t + 3 * np.sin(2.2 * t))
        u = 70 * np.minimum(t / 0.2, 1) * (1 + 0.99 * wave)
        y = 0.103 * u - 6.7 * bouc_wen_states(u, start, 159.0, 1.265, 1.34) + rng.normal(0, noise_um, 5000)
        recordings.append(Recording(str(k), t, u, y, fs_hz))
    found = diagnose(recordings, effects=[])
    family, sigma, beta, *_ = found.effects[0].parameters
    assert family.value == "bouc_wen"
    assert abs(float(sigma.value) - 159) < 8 and abs(float(beta.value) - 1.265) < 0.05
    assert found.augmented.heldout_rms_um < 1.3 * noise_um < 0.05 * found.retuned.train_rms_um
