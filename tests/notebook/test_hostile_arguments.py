"""Arguments of a wrong type are refused in one line with argument, value and expectation."""

from collections.abc import Callable

import numpy as np
import pandas as pd
import pytest
import torch

import torchpi
from torchpi import (
    Compensator,
    DirectInverse,
    PrandtlIshlinskii,
    Recording,
    ReferenceFilter,
    Stage,
    TorchpiError,
    write_recording,
)
from torchpi.operators import Polynomial

T = np.arange(2000) / 1000
U = 5 - 5 * np.cos(2 * np.pi * T)
Y = 0.8 * U
ONE, OTHER = Recording.from_arrays(T, U, Y, name="one"), Recording.from_arrays(T, U, 0.9 * Y, name="other")


@pytest.fixture(scope="module")
def compensator() -> Compensator:
    return Compensator(DirectInverse(1e-3, [0.0, 0.5], rate="none").requires_grad_(False))


def refused(call: Callable[[], object]) -> str:
    with pytest.raises(TorchpiError) as caught:
        call()
    message = str(caught.value)
    assert "\n" not in message and "found " in message and "expected " in message
    return message


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: Recording("a", T, U, Y, 0.0), "a: fs_hz: found 0.0, expected a rate over 0 Hz"),
        (lambda: Recording("a", T, U, Y, "1000"), "a: fs_hz: found '1000'"),
        (lambda: Recording("a", T, U, Y, 1e3, aux=[1]), "a: aux: found [1]"),
        (lambda: ONE.slice(None, 1), "one: start_s: found None, expected a time in s"),
        (lambda: ONE.split_tail("0.1"), "one: fraction: found '0.1'"),
        (lambda: ONE.resampled("3"), "one: fs_hz: found '3'"),
        (lambda: Recording.from_arrays(T, {"a": 1}, Y), "arrays: 'u': found dict, expected an array"),
        (lambda: Recording.from_arrays(T, torch.ones(2000, requires_grad=True), Y), "tensor.detach()"),
        (lambda: write_recording(5, ONE), "path: found int, expected the path of a file"),
        (lambda: ONE.plot().savefig(None), "path: found NoneType"),
    ],
)
def test_a_recording_refuses_invalid_arguments_by_name_and_value(
    call: Callable[[], object], message: str
) -> None:
    assert message in refused(call)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"preview": True}, "preview: found True, expected a number of samples"),
        ({"preview": np.int64(-2)}, "preview: found np.int64(-2)"),
        ({"max_voltage_v": float("nan")}, "max_voltage_v: found nan, expected a voltage in V"),
        ({"max_voltage_v": True}, "max_voltage_v: found True"),
        ({"skip_s": "1"}, "skip_s: found '1', expected a time in s"),
    ],
)
def test_a_fit_refuses_invalid_settings_by_name_and_value(options: dict[str, object], message: str) -> None:
    assert message in refused(lambda: Compensator.fit([ONE, OTHER], **options))


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda c: c.predict(None), "reference_um: 'reference_um': found NoneType, expected an array"),
        (lambda c: c.predict(ONE), "found Recording, expected an array of numbers"),
        (lambda c: c.errors_on(Y), "recordings: found ndarray of 2000, expected a Recording"),
        (lambda c: c.errors_on([ONE, OTHER]), "recording: found 2 recordings, expected one"),
        (lambda c: c.errors_on(ONE, "1"), "skip_s: found '1'"),
        (lambda c: c.export(None), "path: found NoneType"),
        (lambda c: c.export("mine", [3]), "to: found '3', expected one or more of torchscript"),
        (lambda c: c.export("mine", None), "to: found 'None'"),
        (lambda c: c.save(5), "path: found int"),
        (lambda c: c.load(None), "path: found NoneType"),
    ],
)
def test_a_compensator_refuses_invalid_arguments_by_name_and_value(
    compensator: Compensator, call: Callable[[Compensator], object], message: str
) -> None:
    assert message in refused(lambda: call(compensator))


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: Stage.load(None), "path: found NoneType"),
        (lambda: Stage.from_dict([1]), "settings: found [1], expected a section of keys"),
        (lambda: Stage.from_yaml("default").simulate(U[None], -1), "seed: found -1"),
        (lambda: Stage.from_yaml("default").simulate(np.zeros((1, 0))), "u: found shape (1, 0)"),
        (lambda: torchpi.diagnose(ONE, executor=4), "executor: found int, expected a concurrent.futures"),
        (lambda: torchpi.diagnose(ONE, pd.DataFrame()), "simulation: found DataFrame of 0×0"),
        (lambda: DirectInverse(1e-3, None), "thresholds: found None"),
        (lambda: DirectInverse(1e-3, [0.0], degree=2.5), "degree: found 2.5, expected 1 to"),
        (lambda: DirectInverse(1e-3, [0.0], min_voltage_v="0"), "min_voltage_v: found '0'"),
        (lambda: DirectInverse(1e-3, [0.0])(Y), "motion: found ndarray of 2000, expected a Motion"),
        (lambda: ReferenceFilter("a"), "sample_period_s: found 'a', expected a positive number of s"),
        (lambda: ReferenceFilter(1e-3)(Y), "yr: found ndarray, expected a tensor (batch, time)"),
        (lambda: PrandtlIshlinskii([0.0], ["a"]), "weights: found ['a'], expected numbers"),
        (lambda: Polynomial("a"), "coefficients: found 'a'"),
    ],
)
def test_models_refuse_invalid_arguments_by_name_and_value(call: Callable[[], object], message: str) -> None:
    assert message in refused(call)


def test_numpy_integers_and_floats_are_accepted_as_numbers() -> None:
    assert Recording.from_arrays(T, U, Y, skip_s=np.float32(0.1)).duration_s == pytest.approx(1.9)
    assert Compensator.fit([ONE, OTHER], preview=np.int64(0)).preview == 0
