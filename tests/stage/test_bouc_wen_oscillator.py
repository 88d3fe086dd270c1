"""The oscillator with Bouc–Wen hysteresis."""

from pathlib import Path

import numpy as np
import pytest
import torch

from tests.stage.oscillators import PARAMETERS, RATE_HZ, an_oscillator, integrated, multisine
from tests.stage.two_axes import two_axes
from torchpi.errors import ArtifactError, StageError
from torchpi.files import load_tensors, save_tensors
from torchpi.operators.bouc_wen_oscillator import BETWEEN_SAMPLES
from torchpi.stage.bouc_wen_oscillator import BoucWenOscillator
from torchpi.stage.file import write_settings
from torchpi.stage.kinds import load_own_kind
from torchpi.stage.multi_axis import MultiAxisStage


def displacement(oscillator: BoucWenOscillator, u: np.ndarray, periodic: bool = False) -> np.ndarray:
    return oscillator.simulate(torch.from_numpy(u)[None], periodic)[0].numpy()


def rms(error: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(error))))


@pytest.mark.parametrize("exponent", [1.0, 1.7])
def test_the_displacement_matches_an_adaptive_integration_of_the_equations(exponent: float) -> None:
    unit = 10.0 ** (exponent - 1)
    oscillator = an_oscillator(exponent=exponent, dissipation=900.0 / unit, hardening=-600.0 / unit)
    t = np.arange(300) / RATE_HZ

    def force(time: np.ndarray | float) -> np.ndarray:
        growth = np.sin(np.pi * time / 0.6) ** 2
        return 15 * growth * (np.sin(2 * np.pi * 23 * time) + np.sin(2 * np.pi * 61 * time + 1))

    expected = integrated(oscillator.values, force, t)
    assert rms(displacement(oscillator, force(t)) - expected) < 2e-5 * rms(expected)


def test_the_force_is_held_or_interpolated_linearly_between_samples() -> None:
    u = multisine(100)
    t = np.arange(100) / RATE_HZ
    held = integrated(PARAMETERS, lambda time: u[min(int(time * RATE_HZ + 1e-9), 99)], t)
    linear = integrated(PARAMETERS, lambda time: np.interp(time, t, u), t)
    # The steps of the adaptive integration do not end where a held force jumps.
    assert rms(displacement(an_oscillator(between="held"), u) - held) < 2e-3 * rms(held)
    assert rms(displacement(an_oscillator(between="linear"), u) - linear) < 2e-5 * rms(linear)


def test_the_displacement_is_the_same_at_another_sample_rate() -> None:
    fine = displacement(an_oscillator().at_sample_rate(4 * RATE_HZ), multisine(500, factor=4))
    coarse = displacement(an_oscillator(), multisine(500))
    assert rms((coarse - fine[::4])[100:]) < 1e-4 * rms(fine)


@pytest.mark.parametrize("between", BETWEEN_SAMPLES)
def test_steps_give_the_same_bits_as_the_whole_record(between: str) -> None:
    oscillator, u = an_oscillator(between=between), multisine(300)
    stream, late = oscillator.stream(), oscillator.delay_samples
    for _ in range(2):
        steps = [stream.step(float(one)) for one in [*u, *[u[-1]] * late]]
        np.testing.assert_array_equal(steps[late:], displacement(oscillator, u))
        stream.reset()


def test_a_refused_step_leaves_the_state_unchanged() -> None:
    oscillator, u = an_oscillator(between="linear"), multisine(50)
    stream = oscillator.stream()
    steps = [stream.step(float(one)) for one in u[:20]]
    with pytest.raises(StageError, match="u: found nan N at sample 20, expected a finite number"):
        stream.step(float("nan"))
    steps += [stream.step(float(one)) for one in u[20:]]
    np.testing.assert_array_equal(steps, displacement(oscillator, u))


def test_each_row_of_a_batch_is_simulated_as_if_alone() -> None:
    u = torch.from_numpy(np.stack([multisine(200, seed=seed) for seed in range(3)]))
    together = an_oscillator().simulate(u)
    for row, one in zip(together, u, strict=True):
        torch.testing.assert_close(row, an_oscillator().simulate(one[None])[0], rtol=0, atol=0)


@pytest.mark.parametrize("between", BETWEEN_SAMPLES)
def test_the_steady_state_period_equals_a_late_one_of_many_from_rest(between: str) -> None:
    oscillator, u = an_oscillator(between=between), multisine(500)
    # The last period lacks the samples of a following one, so the period before it is compared.
    many = displacement(oscillator, np.tile(u, 12)).reshape(12, -1)[-2]
    assert rms(displacement(oscillator, u, periodic=True) - many) < 1e-8 * rms(many)


def test_without_dissipation_and_hardening_it_is_linear() -> None:
    oscillator, u = an_oscillator(dissipation=0.0, hardening=0.0), multisine(300)
    np.testing.assert_allclose(displacement(oscillator, 3 * u), 3 * displacement(oscillator, u), rtol=1e-9)


def test_slow_loops_do_not_depend_on_the_rate() -> None:
    def loop(samples: int) -> np.ndarray:
        force = 30 * np.sin(2 * np.pi * np.arange(samples) / samples)
        return displacement(an_oscillator(), force, periodic=True)

    slow, slower = loop(4000), loop(8000)[::2]
    assert rms(slow - slower) < 0.01 * rms(slow)
    assert np.ptp(slow + np.roll(slow, 2000)) < 0.02 * np.ptp(slow)  # the loop is odd
    assert abs(slow[0]) > 0.05 * np.abs(slow).max()  # and open


def test_a_saved_oscillator_is_loaded_bit_for_bit(tmp_path: Path) -> None:
    oscillator, path = an_oscillator(between="linear"), tmp_path / "stage.pt"
    oscillator.save(path)
    back, u = BoucWenOscillator.load(path), multisine(200)
    assert back.plain() == oscillator.plain()
    np.testing.assert_array_equal(displacement(back, u), displacement(oscillator, u))


def test_a_file_is_loaded_as_the_kind_of_stage_it_holds(tmp_path: Path) -> None:
    an_oscillator().save(tmp_path / "one.pt")
    two_axes().save(tmp_path / "two.pt")
    (tmp_path / "other.pt").write_bytes(b"something")
    assert isinstance(load_own_kind(tmp_path / "one.pt"), BoucWenOscillator)
    assert isinstance(load_own_kind(tmp_path / "two.pt"), MultiAxisStage)
    assert load_own_kind(tmp_path / "other.pt") is None
    with pytest.raises(ArtifactError, match="a file of another kind, expected a Bouc–Wen oscillator"):
        BoucWenOscillator.load(tmp_path / "two.pt")


def test_a_changed_file_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "stage.pt"
    an_oscillator().save(path)
    content = load_tensors(path, 2**20, "")
    content["parameters"]["mass_kg"] = 2.0
    save_tensors(content, path)
    with pytest.raises(ArtifactError, match="changed since it was written"):
        BoucWenOscillator.load(path)


def test_a_file_with_fields_of_the_wrong_type_is_refused(tmp_path: Path) -> None:
    for number, change in enumerate(
        ({"parameters": 5}, {"parameters": {**PARAMETERS._asdict(), "mass_kg": "x"}})
    ):
        path = tmp_path / f"{number}.pt"
        one = an_oscillator()
        write_settings(path, {**one.plain(), **change}, one.SCHEMA, one.VERSION)
        with pytest.raises(ArtifactError, match="expected those of a Bouc–Wen oscillator"):
            BoucWenOscillator.load(path)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"mass_kg": 0.0}, "mass_kg: found 0, expected a positive number"),
        ({"dissipation": -1.0}, "dissipation: found -1, expected a number that is not negative"),
        ({"hardening": float("nan")}, "hardening: found nan, expected a finite number"),
        ({"beta": 1.0}, "parameters: found beta, "),
    ],
)
def test_invalid_parameters_are_named_in_the_error(changes: dict[str, float], message: str) -> None:
    with pytest.raises(StageError, match=message):
        an_oscillator(**changes)


@pytest.mark.parametrize(
    ("force", "message"),
    [
        (torch.zeros(5), r"found an array of shape \(5,\), expected \(batch, time\)"),
        (torch.full((1, 5), torch.nan), "force: found a value that is not finite"),
        (torch.full((1, 5), 1e20), "found one with an unbounded displacement"),
    ],
)
def test_invalid_forces_and_those_with_unbounded_displacement_are_refused(
    force: torch.Tensor, message: str
) -> None:
    with pytest.raises(StageError, match=message):
        an_oscillator().simulate(force)


def test_invalid_settings_are_named_in_the_error() -> None:
    with pytest.raises(
        StageError, match="between: found 'cubic', expected one of band_limited, linear, held"
    ):
        an_oscillator(between="cubic")
    with pytest.raises(StageError, match="steps: found 0, expected a whole number from 1 to"):
        BoucWenOscillator(RATE_HZ, PARAMETERS._asdict(), steps=0)
