"""Where a drive meets the limits of the voltage or of its rate."""

import math

import numpy as np

from torchpi.loop.limits_met import limits_met

PERIOD_S = 1e-3
YD = np.arange(10.0)
NO_ERROR = np.zeros(10)


def test_the_longest_stretch_is_reported_with_its_time_and_the_total_share() -> None:
    u = np.array([1.0, 10, 5, 10, 10, 10, 4, 3, 2, 2])
    error = np.where(u == 10, -1.0, 0.0)  # below the desired displacement while the voltage is clipped
    (one,) = limits_met(u, YD, error, None, 0.0, 10.0, math.inf, PERIOD_S)
    assert (one.quantity, one.limit, one.value, one.stretches) == ("voltage", 10.0, 10.0, 2)
    np.testing.assert_allclose([one.time_s, one.duration_s, one.share, one.yd_um], [3e-3, 3e-3, 0.4, 3.0])


def test_a_voltage_that_equals_a_limit_without_being_clipped_does_not_count() -> None:
    u = np.array([0.0, 0, 1, 2, 3, 2, 1, 0, 0, 0])
    nothing = np.zeros(10, dtype=bool)
    error = np.array([0.0, 0, 0.1, 0.1, 0.1, 0.1, 0.1, 0, 0.3, 0])
    assert limits_met(u, YD, error, nothing, 0.0, 10.0, math.inf, PERIOD_S) == ()
    changed = nothing.copy()
    changed[8] = True
    (one,) = limits_met(u, YD, error, changed, 0.0, 10.0, math.inf, PERIOD_S)
    assert (one.limit, one.time_s, one.share) == (0.0, 8e-3, 0.1)


def test_a_voltage_rate_above_the_limit_of_the_amplifier_is_reported() -> None:
    u = np.array([0.0, 1, 2, 5, 8, 8, 8, 8, 8, 8])
    (one,) = limits_met(u, YD, NO_ERROR, np.zeros(10, dtype=bool), 0.0, 10.0, 2500.0, PERIOD_S)
    assert (one.quantity, one.limit, one.stretches) == ("slew", 2500.0, 1)
    np.testing.assert_allclose([one.value, one.time_s, one.duration_s], [3000.0, 3e-3, 2e-3])


def test_a_change_between_the_voltage_limits_is_attributed_to_the_slew_limit_of_the_step() -> None:
    u = np.array([0.0, 1, 2, 3, 4, 4, 4, 4, 4, 4])
    changed = np.zeros(10, dtype=bool)
    changed[1:4] = True
    (one,) = limits_met(u, YD, NO_ERROR, changed, 0.0, 10.0, math.inf, PERIOD_S)
    assert one.quantity == "slew" and one.stretches == 1
    np.testing.assert_allclose([one.limit, one.time_s], [1000.0, 1e-3])


def test_a_motion_that_begins_and_ends_at_a_limit_counts_only_if_the_error_is_large() -> None:
    u = np.array([0.0, 0, 1, 2, 3, 3, 2, 1, 0, 0])
    changed = u == 0.0  # by a negligible amount: the error is no larger than elsewhere
    error = np.array([0.0, 0, 0.01, -0.02, 0.01, 0.02, -0.01, 0.0, 0.005, 0])
    assert limits_met(u, YD, error, changed, 0.0, 10.0, math.inf, PERIOD_S) == ()
    error[8:] = 0.2
    (one,) = limits_met(u, YD, error, changed, 0.0, 10.0, math.inf, PERIOD_S)
    assert (one.limit, one.stretches, one.share) == (0.0, 1, 0.2)
