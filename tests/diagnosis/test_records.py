"""A search may see all of the recordings except their sealed ends and their dropouts."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.diagnosis.plants import multisine, record
from tests.diagnosis.prepared import prepared
from torchpi.diagnosis.records import AT_MOST, SEALED, not_counting, prepare, seen


@given(st.integers(100, 3000))
def test_the_end_of_each_recording_is_sealed_and_affects_no_coefficient(samples: int) -> None:
    (one,) = prepared([record(multisine(samples))])
    first = int((1 - SEALED) * samples)
    assert one.train[:first].all() and not one.train[first:].any()
    other = np.where(one.train, one.y, 1e6)
    assert np.array_equal(one.coefficients(one.y[None, :first]), one.coefficients(other[None]))
    (everything,) = prepare([record(multisine(samples))], [np.arange(0)], sealed=0.0)
    assert everything.train.all()


def test_dropouts_count_neither_in_a_fit_nor_in_an_error() -> None:
    one = record(multisine(2000))
    wrong = np.array([3, 500, 501, 1900])
    (clean,) = prepare([one], [wrong])
    one.y[wrong] = 0.0
    (spoilt,) = prepare([one], [wrong])
    first = int((1 - SEALED) * 2000)
    assert not spoilt.train[wrong].any() and not spoilt.held_out[wrong].any()
    assert spoilt.train.sum() == first - 3 and spoilt.held_out.sum() == 2000 - first - 1
    assert np.array_equal(
        clean.coefficients(clean.y[None, :first]), spoilt.coefficients(spoilt.y[None, :first])
    )


def test_an_edge_is_kept_although_most_of_a_long_recording_is_omitted() -> None:
    u = np.zeros(300_000)
    u[150_001:] = 5.0
    (one,) = prepared([record(u)])
    assert one.coefficients.kept < 2 * AT_MOST
    edge = np.zeros(len(u))
    edge[150_001] = 1.0
    assert np.abs(one.coefficients(edge[None])[0]).max() > 0.5


def test_the_data_range_spans_all_recordings() -> None:
    slow, fast = record(multisine(1000)), record(0.5 * multisine(4000, 8e3), fs_hz=8e3, name="b")
    what = seen(prepared([slow, fast]))
    assert what.fs_hz == 8e3 and what.duration_s == pytest.approx((1 - SEALED) * 0.5)
    # The voltage is the command, so none of it is sealed.
    assert (what.low_v, what.high_v) == (slow.u.min(), slow.u.max())


def test_the_quickest_time_of_a_voltage_is_the_inverse_of_its_angular_frequency() -> None:
    t = np.arange(4000) / 1e4
    slow, quick = (record(5 - 5 * np.cos(2 * np.pi * f * t), fs_hz=1e4) for f in (5.0, 50.0))
    assert seen(prepared([slow])).quickest_s == pytest.approx(1 / (2 * np.pi * 5), rel=1e-3)
    assert seen(prepared([slow, quick])).quickest_s == pytest.approx(1 / (2 * np.pi * 50), rel=1e-3)


def test_samples_that_were_filled_in_do_not_count() -> None:
    filled = np.zeros(1000, dtype=bool)
    filled[[200, 201, 990]] = True
    (one,) = prepare(
        [recording := replace(record(multisine(1000)), filled=filled)], [not_counting(recording)]
    )
    out = [200, 201, 202, 990, 991]
    assert not one.train[out].any() and not one.held_out[out].any()
    assert (one.train | one.held_out).sum() == 1000 - len(out)
