"""Held-out samples count block by block, each by the ratio of its errors."""

from dataclasses import replace

import numpy as np
import pytest

from tests.diagnosis.plants import multisine, record
from torchpi.diagnosis.chain import Chain
from torchpi.diagnosis.fit import fit
from torchpi.diagnosis.held_out import explained, gain, mean_squares, typical_um, unexplained
from torchpi.diagnosis.hypothesis import Fit, Hypothesis
from torchpi.diagnosis.nominal import plain
from torchpi.diagnosis.records import Record, prepare, seen


@pytest.fixture(scope="module")
def fitted() -> tuple[list[Record], Fit]:
    records = prepare([record(multisine(3000, seed=s), name=str(s)) for s in (0, 1)])
    return records, fit(Chain(records), Hypothesis(plain(seen(records))))


def scaled(one: Fit, factors: list[float], records: list[Record]) -> Fit:
    """The same with the error of every held-out block multiplied."""
    residuals = [e.copy() for e in one.residuals]
    blocks = [(r, block) for r, record in enumerate(records) for block in record.held_out]
    for (r, block), factor in zip(blocks, factors, strict=True):
        residuals[r][block] *= factor
    return replace(one, residuals=tuple(residuals))


def test_three_tenths_of_each_recording_are_held_out_and_no_fit_sees_them(
    fitted: tuple[list[Record], Fit],
) -> None:
    records, _ = fitted
    for record_ in records:
        assert len(record_.held_out) == 3
        held = np.concatenate([np.arange(len(record_.u))[block] for block in record_.held_out])
        assert sorted(held) == list(np.flatnonzero(~record_.train))
        assert not set(held) & set(record_.fitted)


def test_an_error_that_halves_everywhere_is_a_gain_of_a_half(fitted: tuple[list[Record], Fit]) -> None:
    records, one = fitted
    half = scaled(one, [0.5] * 6, records)
    assert gain(records, half, one) == pytest.approx(0.5)
    assert typical_um(records, half) == pytest.approx(0.5 * typical_um(records, one))
    assert explained(records, half, one) == pytest.approx(0.75)
    assert explained(records, one, half) == pytest.approx(-0.75)
    assert gain(records, one, one) == 0.0


def test_a_block_that_the_model_misses_by_far_hides_no_gain_in_the_others(
    fitted: tuple[list[Record], Fit],
) -> None:
    records, one = fitted
    before = scaled(one, [100.0, 1, 1, 1, 1, 1], records)
    after = scaled(one, [100.0, 0.5, 0.5, 0.5, 0.5, 0.5], records)
    # Of all squares it is not a thousandth; block by block it is what five blocks of six gain.
    assert explained(records, after, before) == pytest.approx(5 / 6 * 0.75)
    assert gain(records, after, before) == pytest.approx(1 - 0.5 ** (5 / 6))
    assert -1 / 6 < explained(records, scaled(one, [1e3, 1, 1, 1, 1, 1], records), one) < -0.16


def test_nothing_is_unexplained_at_the_floor_and_all_of_it_without_one(
    fitted: tuple[list[Record], Fit],
) -> None:
    records, one = fitted
    same = scaled(one, list(1 / np.sqrt(mean_squares(records, one))), records)
    assert unexplained(records, same, same, 1.0) == pytest.approx(0.0, abs=1e-12)
    assert unexplained(records, same, same, 0.0) == pytest.approx(1.0)
    assert unexplained(records, same, same, 2.0) == 0.0


def test_samples_after_an_edge_are_fitted_though_most_are_passed_over() -> None:
    u = np.zeros(40_000)
    u[20_001:] = 5.0
    (prepared,) = prepare([record(u)], at_most=2000)
    assert len(prepared.fitted) < 2100
    assert set(range(20_001, 20_009)) <= set(prepared.fitted)
