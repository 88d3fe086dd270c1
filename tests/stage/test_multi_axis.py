"""The stage of several axes."""

from pathlib import Path

import numpy as np
import pytest
import torch

from tests.stage.two_axes import multisine, two_axes
from torchpi.errors import ArtifactError, StageError
from torchpi.files import load_tensors, save_tensors
from torchpi.stage.multi_axis import MultiAxisStage, MultiAxisStream


def test_windows_with_carried_state_give_the_same_bits_as_one_pass() -> None:
    stage, u = two_axes(), multisine(np.random.default_rng(0), 600, 0.5)
    whole = stage.simulate(torch.from_numpy(u)[None])[0].numpy()
    driven, state, parts = stage.driven(u), stage.initial_state(1), []
    for part in np.split(np.arange(len(u)), [1, 7, 250, 251]):
        y = np.zeros((1, len(part), 2))
        stage.advance(driven[None, part], state, y)
        parts.append(y[0])
    to_come = stage.foreseen(np.pad(u, ((0, stage.shapes.ahead), (0, 0))))
    np.testing.assert_array_equal(np.concatenate(parts) + to_come, whole)


def test_steps_give_the_same_bits_as_the_whole_record_some_samples_later() -> None:
    stage, u = with_amplifiers(200.0), multisine(np.random.default_rng(0), 300, 0.5)
    stream, whole = MultiAxisStream(stage), stage.simulate(torch.from_numpy(u)[None])[0].numpy()
    for _ in range(2):
        stream.reset()
        found = [stream.step(one) for one in np.pad(u, ((0, stream.delay_samples), (0, 0)))]
        np.testing.assert_array_equal(found[stream.delay_samples :], whole)


def test_a_step_refuses_invalid_voltages() -> None:
    stream = MultiAxisStream(two_axes())
    with pytest.raises(StageError, match=r"found an array of shape \(1, 3\), expected finite numbers"):
        stream.step([1.0, 2.0, 3.0])
    with pytest.raises(StageError, match="expected finite numbers"):
        stream.step([1.0, np.nan])


def test_each_row_of_a_batch_is_simulated_as_if_alone() -> None:
    stage, u = two_axes(), torch.from_numpy(np.random.default_rng(0).standard_normal((3, 200, 2)))
    together = stage.simulate(u)
    for row, alone in zip(together, u, strict=True):
        torch.testing.assert_close(row, stage.simulate(alone[None])[0], rtol=0, atol=0)


def test_without_force_it_is_linear_in_the_voltages() -> None:
    stage = two_axes(force=0.0)
    with torch.no_grad():
        stage.play_weights.zero_()
    u = torch.from_numpy(multisine(np.random.default_rng(0), 512, 1.0))[None]
    torch.testing.assert_close(3 * stage.simulate(u), stage.simulate(3 * u))


def test_the_displacement_precedes_the_voltage_by_the_look_ahead_of_the_stage() -> None:
    stage, u = two_axes(force=0.0), np.zeros((100, 2))
    u[60, 1] = 1.0
    with torch.no_grad():
        stage.play_weights.zero_()
    y = stage.simulate(torch.from_numpy(u)[None])[0].numpy()
    np.testing.assert_array_equal(y[:57], 0.0)
    np.testing.assert_array_equal(y[57:60][::-1].T, stage.arrays()["ahead"][:, 1])


def test_a_look_ahead_longer_than_a_step_waits_for_is_refused() -> None:
    arrays = {**two_axes().arrays(), "ahead": np.zeros((2, 2, 81))}
    with pytest.raises(StageError, match="ahead: found 81 samples, expected at most 80"):
        MultiAxisStage(1000.0, arrays, [0.1, 0.3], [5.0, 20.0], [0.0], [0.1, 0.5], [5.0, 20.0], [0.05])


def test_a_saved_stage_is_loaded_bit_for_bit(tmp_path: Path) -> None:
    stage, path = two_axes(), tmp_path / "stage.pt"
    stage.save(path)
    u = torch.from_numpy(multisine(np.random.default_rng(0), 300, 0.5))[None]
    torch.testing.assert_close(MultiAxisStage.load(path).simulate(u), stage.simulate(u), rtol=0, atol=0)


def with_amplifiers(corner_hz: float) -> MultiAxisStage:
    """Return the stage of two axes with amplifiers that have crossover distortion of one width."""
    stage = two_axes()
    arrays = {**stage.arrays()}
    arrays["play_weights"] = np.concatenate([arrays["play_weights"], np.full((2, 2), 0.05)], 1)
    return MultiAxisStage(
        1000.0, arrays, [0.1, 0.3], [5.0, 20.0], [0.0], [0.1, 0.5], [5.0, 20.0], [0.05], [100.0], corner_hz
    )


def test_a_saved_stage_is_loaded_with_its_amplifiers(tmp_path: Path) -> None:
    stage, path = with_amplifiers(200.0), tmp_path / "stage.pt"
    stage.save(path)
    u = torch.from_numpy(multisine(np.random.default_rng(0), 300, 0.5))[None]
    torch.testing.assert_close(MultiAxisStage.load(path).simulate(u), stage.simulate(u), rtol=0, atol=0)
    assert (stage.simulate(u) - two_axes().simulate(u)).abs().max() > 1e-3


@pytest.mark.parametrize("corner_hz", [0.0, np.inf])
def test_amplifiers_without_a_valid_bandwidth_are_refused(corner_hz: float) -> None:
    with pytest.raises(StageError, match=f"amplifier_hz: found {corner_hz}, expected a positive number"):
        with_amplifiers(corner_hz)


def test_a_changed_file_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "stage.pt"
    two_axes().save(path)
    content = load_tensors(path, 2**20, "")
    content["sample_rate_hz"] = 2000.0
    save_tensors(content, path)
    with pytest.raises(ArtifactError, match="changed since it was written"):
        MultiAxisStage.load(path)


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("seen", np.zeros((2, 3, 2)), r"seen: found an array of shape \(2, 3, 2\), expected \(2, 2, 2\)"),
        ("poles", np.array([[1.0, 0.1], [0.5, 0.5]]), "outside the unit circle"),
        ("through", np.full((2, 2), np.nan), "through: found a value that is not finite"),
    ],
)
def test_invalid_parameters_are_named_in_the_error(name: str, value: np.ndarray, message: str) -> None:
    stage = two_axes()
    with pytest.raises(StageError, match=message):
        MultiAxisStage(
            1000.0,
            {**stage.arrays(), name: value},
            [0.1, 0.3],
            [5.0, 20.0],
            [0.0],
            [0.1, 0.5],
            [5.0, 20.0],
            [0.05],
        )


def test_a_play_without_a_rate_is_refused() -> None:
    stage = two_axes()
    with pytest.raises(StageError, match="input_rates_hz: found 1, expected one for each of 2 thresholds"):
        MultiAxisStage(1000.0, stage.arrays(), [0.1, 0.3], [5.0])


def test_a_wrong_number_of_inputs_is_refused() -> None:
    with pytest.raises(StageError, match=r"expected \(batch, time, 2\)"):
        two_axes().simulate(torch.zeros(1, 10, 3))
