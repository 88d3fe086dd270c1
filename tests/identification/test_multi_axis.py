"""Identification of a stage of several axes."""

import numpy as np
import pytest
import torch
from scipy.linalg import cho_factor

from tests.stage.two_axes import RATE_HZ, multisine, recordings, two_axes
from torchpi.identification.multi_axis import MultiAxisOptions, identify
from torchpi.identification.multi_axis.fit import Period, PeriodicFit, quasi_newton, scaled
from torchpi.identification.multi_axis.identify import (
    by_amplitude,
    holds,
    linear_stage,
    other_amplitudes,
    periods,
    silence,
    slow_motion,
)
from torchpi.identification.multi_axis.properties import static_gain_of
from torchpi.recordings.multi_axis import MultiAxisRecording


def rms(stage, every) -> float:
    errors = PeriodicFit(stage, periods(every)).errors()
    assert errors is not None
    return float(np.sqrt(np.mean(np.square(errors))))


@pytest.mark.parametrize("guard", [False, True])
def test_the_gradient_matches_finite_differences(guard: bool) -> None:
    random = np.random.default_rng(0)
    stage = two_axes()
    period = Period(multisine(random, 256, 0.5), random.standard_normal((256, 2)), 1.0)
    fit = PeriodicFit(stage, [], [period]) if guard else PeriodicFit(stage, [period])
    if not guard:  # a guard's tangents start with the preceding period anyway
        fit.run_in = 1.0
    vector, errors = fit.vector(), fit.errors()
    assert errors is not None
    right = fit.gradient(errors)
    slopes = []
    # The step must not reach the next kink, where a play begins to move.
    for step in 1e-8 * np.eye(len(vector)):
        fit.put(vector + step)
        above = fit.cost(fit.errors())
        fit.put(vector - step)
        slopes.append((above - fit.cost(fit.errors())) / 2e-8)
    np.testing.assert_allclose(-np.array(slopes) / 2, right, rtol=1e-4, atol=1e-5 * np.abs(right).max())


def test_the_normal_matrix_matches_finite_differences(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("torchpi.identification.multi_axis.fit.STRIDE", 1)
    stage = two_axes()
    stage.arrays()["through"][:] = 0.1  # otherwise the first sample lies at a kink
    fit = PeriodicFit(stage, [Period(multisine(np.random.default_rng(0), 256, 0.5), np.zeros((256, 2)), 2.0)])
    fit.run_in = 1.0
    vector, rows = fit.vector(), []
    for step in 1e-8 * np.eye(len(vector)):
        fit.put(vector + step)
        above = fit.errors()
        fit.put(vector - step)
        below = fit.errors()
        assert above is not None and below is not None
        rows.append((below[0] - above[0]).ravel() / 2e-8)
    fit.put(vector)
    expected = 4.0 * np.array(rows) @ np.array(rows).T / (256 * 2)
    scale = np.sqrt(np.diag(expected))
    found, guarded = fit._normal_matrices(np.arange(len(vector)), 0, 1)
    assert not guarded.any()
    assert np.abs((found - expected) / scale / scale[:, None]).max() < 1e-3


def test_a_quasi_newton_step_satisfies_the_secant_condition_of_the_last_step() -> None:
    random = np.random.default_rng(0)
    steps = random.standard_normal((2, 5))
    hessian = np.diag([1.0, 2.0, 3.0, 4.0, 5.0])
    pairs = [(step, hessian @ step) for step in steps]
    begun = cho_factor(4 * np.eye(5)), np.ones(5)
    np.testing.assert_allclose(quasi_newton(hessian @ steps[-1], pairs, *begun), steps[-1])
    np.testing.assert_allclose(quasi_newton(steps[0], [], *begun), steps[0] / 4)


def test_damping_is_scaled_by_the_slopes_of_the_recordings_alone() -> None:
    gram, ringing = np.diag([4.0, 9.0, 16.0]), np.array([1e12, 0.0, 1e12])
    unit, scale = scaled(gram, np.outer(ringing, ringing))
    np.testing.assert_array_equal(scale, [2.0, 3.0, 4.0])
    # A parameter that the guard does not see moves as without it; the direction that it sees hardly moves.
    step = np.linalg.solve(unit + 0.1 * np.eye(3), np.ones(3))
    assert step[1] == pytest.approx(1 / 1.1)
    assert abs(ringing / scale @ step) < 1e-4 * np.abs(ringing).max()


def test_every_step_along_a_curved_valley_lowers_the_cost() -> None:
    every = recordings(two_axes(), (0.3, 0.6), 3)
    stage = two_axes(force=0.01)
    stage.arrays()["poles"][:] *= 0.995
    fit = PeriodicFit(stage, periods(every))
    costs = [fit.descend(list(stage.arrays()), 8)]

    def goes_on(cost: float) -> bool:
        costs.append(cost)
        return len(costs) < 40

    fit.descend_bent(goes_on)
    assert (np.diff(costs) < 0).all()


def test_future_samples_improve_the_fit_to_band_limited_voltages() -> None:
    """A mode in continuous time, driven by a voltage with content up to 0.94 of the Nyquist frequency."""
    random, samples, found = np.random.default_rng(0), 1024, {}
    hertz = np.fft.rfftfreq(samples, 1 / RATE_HZ)
    s = 2j * np.pi * hertz
    every, response = [], np.zeros(len(s), complex)
    for omega in 2 * np.pi * np.array([60.0, 300.0]):
        response += omega**2 / (s**2 + 0.02 * omega * s + omega**2)
    for run in range(3):
        spectrum = np.where((hertz > 0) & (hertz < 470), np.exp(2j * np.pi * random.random(len(s))), 0)
        u, y = (np.tile(np.fft.irfft(x)[:, None], (2, 1)) for x in (spectrum, spectrum * response))
        every.append(MultiAxisRecording(str(run), 10 * u, 10 * y, RATE_HZ, 2))
    for ahead in (0, 8):
        stage, _, _ = linear_stage(every, 3, ahead)
        PeriodicFit(stage, periods(every)).descend(list(stage.arrays()), 20)
        found[ahead] = rms(stage, every)
    assert found[8] < 0.4 * found[0]


def test_an_identified_stage_predicts_realisations_that_it_was_not_fitted_to() -> None:
    every = recordings(two_axes(), (0.3, 0.6), 4)
    heldout = [one for one in every if one.name.endswith(" 4")]
    fitted = [one for one in every if one not in heldout]
    options = MultiAxisOptions(modes=2, extra_elements=0, times_s=(0.05,), seconds=8.0)
    stage = identify(fitted, options)
    linear, _, _ = linear_stage(fitted, 2)
    PeriodicFit(linear, periods(fitted)).descend(list(linear.arrays()), 20)
    motion = float(np.sqrt(np.mean([np.square(one.y - one.y.mean(0)) for one in heldout])))
    assert rms(stage, heldout) < 0.02 * motion
    assert rms(stage, heldout) < 0.5 * rms(linear, heldout)


def test_non_periodic_recordings_are_identified_in_the_time_domain() -> None:
    stage, random, every = two_axes(), np.random.default_rng(7), []
    for run in range(4):
        u = multisine(random, 1500, 0.5)
        y = stage.simulate(torch.from_numpy(u)[None])[0].numpy()
        every.append(MultiAxisRecording(f"{run}", u, y, 1000.0))
    fitted = identify(every[:3], MultiAxisOptions(modes=2, extra_elements=0, times_s=(0.05,), seconds=3.0))
    motion = float(np.sqrt(np.mean([np.square(one.y).mean() for one in periods(every[3:])])))
    assert rms(fitted, every[3:]) < 0.05 * motion


def test_a_pole_outside_the_unit_circle_is_brought_back_inside() -> None:
    stage = two_axes()
    fit = PeriodicFit(stage, [Period(np.zeros((8, 2)), np.zeros((8, 2)), 1.0)])
    vector = fit.vector()
    vector[:2] = 1.2, 0.9
    fit.put(vector)
    assert np.hypot(*stage.arrays()["poles"][0]) < 1
    np.testing.assert_array_equal(stage.arrays()["poles"][1], two_axes().arrays()["poles"][1])


def test_a_period_with_an_unbounded_response_has_infinite_cost() -> None:
    stage = two_axes()
    u = multisine(np.random.default_rng(1), 256, 0.2)
    # The stiffness falls with the amplitude: stable at this amplitude, unstable at forty times it.
    stage.arrays()["weights"][:, 3] = 0.05
    small, large = (PeriodicFit(stage, [Period(share * u, np.zeros((256, 2)), 1.0)]) for share in (1, 40))
    assert np.isfinite(small.cost(small.errors()))
    assert large.cost(large.errors()) == np.inf


def test_an_invalid_option_is_refused_by_name() -> None:
    with pytest.raises(ValueError, match="modes: found 0, expected a whole number, 1 or more"):
        MultiAxisOptions(modes=0)
    with pytest.raises(ValueError, match="amplifier_hz: found -1, expected a positive number"):
        MultiAxisOptions(amplifier_hz=-1)


def test_a_stage_that_rings_by_itself_near_rest_has_a_high_cost() -> None:
    every = recordings(two_axes(), (0.3,), 2)
    calm, ringing = two_axes(), two_axes()
    ringing.arrays()["poles"][:] *= 1.02
    costs = []
    for stage in (calm, ringing):
        fit = PeriodicFit(stage, [silence(every[0])])
        costs.append(fit.cost(fit.errors()))
    assert costs[0] < 1e-3 * costs[1]


def test_a_stage_with_an_unbounded_response_to_a_slow_voltage_has_infinite_cost() -> None:
    every = recordings(two_axes(), (0.3,), 2)
    gain = static_gain_of(two_axes(), 0.1).T
    calm, driven = two_axes(), two_axes()
    driven.arrays()["weights"][:, -1] = 10.0  # stiffness that follows the voltage
    costs = []
    for stage in (calm, driven):
        fit = PeriodicFit(stage, [slow_motion(every, gain)])
        costs.append(fit.cost(fit.errors()))
    assert costs[0] < 1.0 and costs[1] == np.inf


def test_a_stage_that_rings_while_one_input_is_held_has_infinite_cost() -> None:
    every = recordings(two_axes(), (0.3,), 2)
    gain = static_gain_of(two_axes(), 0.1).T
    held = holds(every, gain)
    ends = [(one.u.min(), one.u.max()) for one in held]
    recorded = np.stack([one.u for one in every])
    np.testing.assert_allclose(ends, np.stack([recorded.min((0, 1)), recorded.max((0, 1))], axis=1))
    stage = two_axes()
    calm = PeriodicFit(stage, held)
    assert calm.cost(calm.errors()) < 0.02
    stage.arrays()["weights"][:, -1] = 0.5  # stiffness that follows the voltage
    others = [slow_motion(every, gain), *other_amplitudes([every])]
    assert PeriodicFit(stage, others).errors() is not None
    assert PeriodicFit(stage, held).errors() is None


@pytest.mark.parametrize(("stiffness", "bounded"), [(0.09, [True, True]), (0.14, [True, False])])
def test_a_stage_that_rings_between_or_beyond_the_recorded_amplitudes_has_a_high_cost(
    stiffness: float, bounded: list[bool]
) -> None:
    levels = by_amplitude(recordings(two_axes(), (0.1, 0.2), 2))
    guards = other_amplitudes(levels)
    np.testing.assert_allclose([one.u.std() for one in guards], [0.1 * 2**0.5, 0.25])
    stage = two_axes()
    calm = PeriodicFit(stage, guards)
    assert calm.cost(calm.errors()) < 0.01
    stage.arrays()["weights"][:, 3] = stiffness  # its effect grows with the mean amplitude
    assert [PeriodicFit(stage, periods(level)).errors() is not None for level in levels] == bounded
    driven = PeriodicFit(stage, guards)
    assert driven.cost(driven.errors()) > 10
