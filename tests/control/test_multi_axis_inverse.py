"""The inverse of a stage of several axes."""

import numpy as np
import pytest
import torch

from tests.stage.two_axes import multisine, two_axes
from torchpi.control.multi_axis import MultiAxisInverse, linear_inverses
from torchpi.errors import StageError
from torchpi.stage.multi_axis import MultiAxisStage

RMS_V, BAND_HZ = 0.3, 30.0


@pytest.fixture(scope="module")
def stage() -> MultiAxisStage:
    return two_axes()


@pytest.fixture(scope="module")
def filters(stage: MultiAxisStage) -> tuple[np.ndarray, np.ndarray]:
    return linear_inverses(stage, RMS_V, BAND_HZ)


def trajectory() -> np.ndarray:
    """Return two equal periods of a motion up to `BAND_HZ`, (time, 2), µm."""
    spectrum = np.fft.rfft(multisine(np.random.default_rng(5), 2000, 1.0), axis=0)
    spectrum[int(BAND_HZ / 1000.0 * 2000) :] = 0
    yd = np.fft.irfft(spectrum, axis=0)
    return np.tile(yd / yd.std(0), (2, 1))


def moved(stage: MultiAxisStage, inverse: MultiAxisInverse, yd: np.ndarray) -> np.ndarray:
    """Return the motion of the stage in the second half."""
    inverse.reset()
    u = inverse.block(np.concatenate([yd, yd[: inverse.preview]]))[inverse.preview :]
    y = stage.simulate(torch.from_numpy(u)[None])[0].numpy()
    return y[2200:-200]


def test_corrections_leave_a_tenth_of_the_error_of_the_best_linear_inverse(
    stage: MultiAxisStage, filters: tuple[np.ndarray, np.ndarray]
) -> None:
    yd = trajectory()
    errors = []
    for passes in (0, 3):
        y = moved(stage, MultiAxisInverse(stage, *filters, passes), yd)
        errors.append((y - yd[2200:-200]).std(0))
    assert (errors[1] < 0.01).all()
    assert (errors[1] < 0.1 * errors[0]).all()


def test_an_axis_with_zero_reference_stays_at_rest(
    stage: MultiAxisStage, filters: tuple[np.ndarray, np.ndarray]
) -> None:
    yd = trajectory() * [1.0, 0.0]
    assert moved(stage, MultiAxisInverse(stage, *filters, 3), yd)[:, 1].std() < 0.005


def test_steps_give_the_same_voltages_as_the_block(
    stage: MultiAxisStage, filters: tuple[np.ndarray, np.ndarray]
) -> None:
    inverse, yd = MultiAxisInverse(stage, *filters, 1), trajectory()[:700]
    whole = inverse.block(yd)
    inverse.reset()
    np.testing.assert_allclose([inverse.step(one) for one in yd], whole, atol=1e-12)


def test_invalid_bands_and_arrays_are_named_in_the_error(
    stage: MultiAxisStage, filters: tuple[np.ndarray, np.ndarray]
) -> None:
    with pytest.raises(StageError, match="band_hz: found 400, expected a number up to 170"):
        linear_inverses(stage, RMS_V, 400.0)
    with pytest.raises(StageError, match=r"corrections: found an array of shape \(3, 2, 2\)"):
        MultiAxisInverse(stage, filters[0], filters[1][:3])
    with pytest.raises(StageError, match="passes: found -1"):
        MultiAxisInverse(stage, *filters, -1)
    with pytest.raises(StageError, match=r"array of shape \(1, 3\), expected \(time, 2\)"):
        MultiAxisInverse(stage, *filters).step([1.0, 2.0, 3.0])
    with pytest.raises(StageError, match=r"limits_v: found .*, expected the least and the largest voltage"):
        MultiAxisInverse(stage, *filters, 1, np.array([[0.0, 1.0], [1.0, 1.0]]))
    with pytest.raises(StageError, match=r"accepted_um: found .*, expected 2 positive numbers"):
        MultiAxisInverse(stage, *filters, 1, accepted_um=np.array([1.0, 0.0]))


def test_a_rejected_sample_is_replaced_by_the_last_one_and_counted(
    stage: MultiAxisStage, filters: tuple[np.ndarray, np.ndarray]
) -> None:
    yd = trajectory()[:400]
    held, wild = yd.copy(), yd.copy()
    held[[0, 150]], held[151] = [yd[0] * 0, yd[149]], yd[149]
    wild[0, 1], wild[150, 0], wild[151, 1] = np.nan, 1e30, -50.0
    one, other = (MultiAxisInverse(stage, *filters, 1, accepted_um=np.full(2, 20.0)) for _ in range(2))
    voltages = one.block(held)
    np.testing.assert_allclose([other.step(sample) for sample in wild], voltages, atol=1e-12)
    assert (one.held_inputs, other.held_inputs) == (0, 3)


def test_voltages_stay_within_their_limits(
    stage: MultiAxisStage, filters: tuple[np.ndarray, np.ndarray]
) -> None:
    limits = np.array([[-0.1, 0.2], [-5.0, 5.0]])
    limited = MultiAxisInverse(stage, *filters, 0, limits)
    u, free = limited.block(trajectory()), MultiAxisInverse(stage, *filters, 0).block(trajectory())
    np.testing.assert_array_equal(u, np.clip(free, *limits.T))
    assert limited.limited_outputs == (u != free).any(1).sum() > 0
