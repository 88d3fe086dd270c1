"""Mistakes in a notebook are refused in one line, as with files, before anything is fitted."""

import pickle
from typing import Any

import numpy as np
import pytest

import torchpi
from torchpi import Compensator, DirectInverse, Recording
from torchpi.errors import ArtifactError, ConfigError, RecordingError

T = np.arange(2000) / 1000
U = 5 - 5 * np.cos(2 * np.pi * T)
Y = 0.8 * U


def made(y: np.ndarray = Y, name: str = "slow") -> Recording:
    return Recording.from_arrays(T, U, y, name=name)


@pytest.fixture
def compensator() -> Compensator:
    inverse = DirectInverse(1e-3, [0.0, 0.5], rate="none").requires_grad_(False)
    return Compensator(inverse)


@pytest.mark.parametrize(
    ("recordings", "message"),
    [
        (None, "recordings: found NoneType, expected a Recording: Recording.from_arrays(t, u, y) makes one"),
        ("slow.csv", "recordings: found str, expected a Recording"),
        ([], "recordings: found 0, expected two or more"),
        (made(), "recordings: found 1, expected two or more"),
        ([made(), made(name="again")], "again: found the content of slow, expected different recordings"),
        ([made(), Y], "recordings: found ndarray at index 1, expected a Recording"),
        (
            [made(), Recording.from_arrays(None, U, Y + 0.1, fs_hz=500, name="other")],
            "other: sampled at 500 Hz, but slow at 1000 Hz; expected one rate",
        ),
        (
            [made(), Recording("nan", T, U, Y * np.nan, 1000.0)],
            "nan: sample 1: column 'output_um': found nan",
        ),
    ],
    ids=["nothing", "a path", "none", "one", "the same twice", "an array", "another rate", "unchecked"],
)
def test_recordings_that_cannot_be_fitted_are_refused(recordings: Any, message: str) -> None:
    with pytest.raises(RecordingError) as refused:
        Compensator.fit(recordings)
    assert message in str(refused.value) and "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"preview": -1}, "preview: found -1, expected a number of samples that is not negative"),
        ({"preview": 0.5}, "preview: found 0.5, expected a number of samples"),
        ({"max_voltage_v": "10"}, "max_voltage_v: found '10', expected a voltage in V"),
        ({"skip_s": -1.0}, "skip_s: found -1.0, expected a time in s that is not negative"),
    ],
    ids=["negative", "half a sample", "a word", "skip"],
)
def test_invalid_settings_of_a_fit_are_refused(options: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError) as refused:
        Compensator.fit([made(), made(1.1 * Y, "other")], **options)
    assert message in str(refused.value)


@pytest.mark.parametrize(
    ("reference", "message"),
    [
        (np.zeros((3, 5)), "reference_um: 'reference_um' is an array of 3×5, expected one signal"),
        ([1.0, float("inf")], "reference_um: index 1: column 'reference_um': found inf, expected a finite"),
        (["a", "b"], "reference_um: 'reference_um' holds <U1, expected numbers"),
        ([[1.0], [2.0, 3.0]], "reference_um: 'reference_um': found list, expected an array of numbers"),
        ([], "reference_um: 0 samples, expected at least one"),
    ],
    ids=["two axes", "infinite", "words", "ragged", "empty"],
)
def test_a_reference_that_is_not_a_signal_is_refused(
    compensator: Compensator, reference: Any, message: str
) -> None:
    with pytest.raises(RecordingError) as refused:
        compensator.predict(reference)
    assert message in str(refused.value) and "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("arguments", "found"),
    [({}, "NoneType"), ({"preview": 2}, "preview"), ({"inverse": Y}, "ndarray of 2000")],
)
def test_an_empty_compensator_is_refused_with_the_calls_that_make_one(
    arguments: dict[str, Any], found: str
) -> None:
    with pytest.raises(ConfigError) as refused:
        Compensator(**arguments)
    message = str(refused.value)
    assert f"found {found}, expected a DirectInverse" in message
    assert "Compensator.fit(recordings" in message and "Compensator.load(path)" in message


def test_fitting_a_fitted_compensator_again_is_refused(compensator: Compensator) -> None:
    with pytest.raises(
        ConfigError, match=r"fit: found a compensator that is already fitted .*Compensator\.fit"
    ):
        compensator.fit([made(), made(1.1 * Y, "other")])
    again = pickle.loads(pickle.dumps(compensator))
    assert again.sample_rate_hz == compensator.sample_rate_hz


def test_a_stage_may_be_given_by_name_and_wrong_types_are_refused(compensator: Compensator) -> None:
    with pytest.raises(ArtifactError, match="sample period"):  # found, but of another rate
        compensator.track(Y, "default")
    with pytest.raises(ConfigError, match="nonsense: no such file or name"):
        compensator.track(Y, "nonsense")
    with pytest.raises(
        ArtifactError, match="stage: found ndarray without 'sample_period_s', expected a stage"
    ):
        compensator.track(Y, Y)
    with pytest.raises(ArtifactError, match="path: found int, expected the path of a file or a folder"):
        Compensator.load(4)


def test_tracking_without_a_stage_or_at_another_rate_is_refused(compensator: Compensator) -> None:
    with pytest.raises(ArtifactError, match="stage: found none, expected one"):
        compensator.track(Y)
    with pytest.raises(ArtifactError, match="sample"):
        compensator.track(Y, torchpi.Stage.from_yaml("default"))
    with pytest.raises(RecordingError, match="sampled at 500 Hz, expected 1000 Hz, the compensator's rate"):
        compensator.errors_on(Recording.from_arrays(None, U, Y, fs_hz=500))


def test_a_diagnosis_of_arrays_is_refused_with_a_hint_to_from_arrays() -> None:
    with pytest.raises(
        RecordingError, match=r"found ndarray at index 0, expected a Recording: .*from_arrays"
    ):
        torchpi.diagnose([Y])
    with pytest.raises(RecordingError, match=r"found NoneType, expected a Recording: .*from_arrays"):
        torchpi.diagnose(None)
