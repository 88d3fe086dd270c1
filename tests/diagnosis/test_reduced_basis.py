"""A larger hysteresis retains what the fitted plays describe."""

from dataclasses import replace

import numpy as np
import pytest

from tests.diagnosis.plants import FS_HZ, NOISE_UM, multisine, triangles
from tests.diagnosis.prepared import prepared
from torchpi.diagnosis.chain import Chain
from torchpi.diagnosis.fit import fit
from torchpi.diagnosis.hypothesis import Fit, Hypothesis
from torchpi.diagnosis.hysteresis_model import many_plays, plain, preisach
from torchpi.diagnosis.records import seen
from torchpi.diagnosis.reduced_basis import MANY, basis, grown, reduced
from torchpi.diagnosis.score import Weighting
from torchpi.recordings.recording import Recording


def sharp(bend: float) -> list[Recording]:
    """Four plays with sharp corners, the widest two through a curve of this size over their range."""
    rng, t, made = np.random.default_rng(1), np.arange(6000) / FS_HZ, []
    r, weights = np.array([0.0, 0.7, 2.3, 4.1]), np.array([0.5, 0.3, 0.2, 0.2])
    for name, u in (("a", multisine(6000, high_hz=60.0)), ("b", triangles(6000))):
        y, h = np.empty(len(u)), np.zeros(len(r))
        for k, v in enumerate(u):
            h = np.maximum(v - r, np.minimum(v + r, h))
            y[k] = weights @ h + bend * (h[2] ** 2 + h[3] ** 2) / 100
        made.append(Recording(name, t, u, y + rng.normal(0, NOISE_UM, len(u)), FS_HZ))
    return made


def best_of_plays(chain: Chain) -> Fit:
    now = fit(chain, *basis(chain, Hypothesis(many_plays(seen(chain.records))), None, MANY))
    chain.weighting = Weighting.of(chain.records, now.residuals, None)
    return fit(chain, now.hypothesis, now.weights)


@pytest.mark.parametrize("few", [True, False])
def test_plays_with_output_functions_start_from_the_fitted_plays(few: bool) -> None:
    chain = Chain(prepared(sharp(0.8)))
    now = best_of_plays(chain)
    now = reduced(chain, now) if few else now
    larger, weights = grown(chain, Hypothesis(preisach(seen(chain.records))), now, MANY)
    assert weights is not None and larger.nominal.kept <= MANY + 1
    for record in chain.records:
        as_before = [
            nominal.output(record.u, record.period_s, w[: nominal.kept])
            for nominal, w in ((larger.nominal, weights), (now.hypothesis.nominal, now.weights))
        ]
        np.testing.assert_allclose(*as_before, atol=1e-9)


def test_sharp_thresholds_stay_sharp_where_output_functions_bend() -> None:
    """A smooth density alone has no sharp thresholds and predicts worse than plays that lack the bend."""
    chain = Chain(prepared(sharp(0.8)))
    now = best_of_plays(chain)
    assert now.train_rms > 3 * NOISE_UM
    one = fit(chain, *grown(chain, Hypothesis(preisach(seen(chain.records))), now, MANY))
    assert one.train_rms < 1.3 * NOISE_UM
    density = chain.weighting.log_density
    assert density(one).sum() > density(now).sum() + 100


def test_a_curve_continues_beyond_the_recorded_range_as_it_ended() -> None:
    """No data are recorded there, so the prior decides."""
    t = np.arange(6000) / FS_HZ
    u = np.where(t < 2.56, 4.0, 5.0) * (1 - np.cos(6 * np.pi * t)) * (1 - 0.3 * np.cos(np.pi * t))
    y = u + 0.2 * np.logaddexp(0.0, 2 * (u - 4.0)) + np.random.default_rng(3).normal(0, NOISE_UM, len(u))
    chain = Chain(prepared([Recording("a", t, u, y, FS_HZ)]))
    assert u[: chain.records[0].coefficients.samples].max() < 0.85 * u.max()
    one = best_of_plays(chain)
    for _ in range(2):
        one = fit(chain, *basis(chain, Hypothesis(preisach(seen(chain.records))), None, MANY))
        chain.weighting = Weighting.of(chain.records, one.residuals, None)
    assert one.train_rms < 1.1 * NOISE_UM
    assert one.heldout_rms < 8 * NOISE_UM


def test_output_functions_predict_as_well_as_plays_if_nothing_bends() -> None:
    chain = Chain(prepared(sharp(0.0)))
    now = best_of_plays(chain)
    one = fit(chain, *grown(chain, Hypothesis(preisach(seen(chain.records))), now, MANY))
    assert one.left_out_um2.mean() < 1.1 * now.left_out_um2.mean()


def test_different_plays_start_without_weights() -> None:
    chain = Chain(prepared(sharp(0.0)))
    now = fit(chain, Hypothesis(plain(seen(chain.records))))
    _, weights = grown(chain, Hypothesis(preisach(seen(chain.records))), now, MANY)
    assert weights is None


@pytest.mark.parametrize("samples_a_period", [5, 2000])
def test_combinations_are_sums_of_plays_however_fast_the_voltage_moves(samples_a_period: int) -> None:
    """Both ways of computing the combinations agree."""
    rng = np.random.default_rng(2)
    v = 5.0 + 4.9 * np.sin(2 * np.pi * np.arange(4000) / samples_a_period) + rng.normal(0, 0.01, 4000)
    every = many_plays(seen(prepared(sharp(0.0))))
    combinations = rng.normal(size=(7, every.size))
    states, sums = np.empty((every.size, len(v))), np.empty((7, len(v)))
    every.fill(v, 1 / FS_HZ, states)
    replace(every, reduction=combinations).fill(v, 1 / FS_HZ, sums)
    np.testing.assert_allclose(sums, combinations @ states, atol=1e-9)
