"""Recordings of several axes: reading and writing files and archives, and refusing unusable ones."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from torchpi.errors import RecordingError, RecordingWarning
from torchpi.recordings.multi_axis import (
    MultiAxisRecording,
    read_multi_axis,
    read_realisations,
    usable,
    write_multi_axis,
)
from torchpi.recordings.recording import read_recording


def recording(inputs: int = 2, name: str = "one") -> MultiAxisRecording:
    values = np.random.default_rng(0).standard_normal((64, inputs + 2))
    return MultiAxisRecording(name, values[:, :inputs], values[:, inputs:], 500.0)


def test_a_recording_is_read_back_bit_for_bit_as_written(tmp_path: Path) -> None:
    one, path = recording(), tmp_path / "one.csv"
    write_multi_axis(path, one)
    back = read_multi_axis(path, periods=2)
    np.testing.assert_array_equal(back.u, one.u)
    np.testing.assert_array_equal(back.y, one.y)
    assert (back.fs_hz, back.periods) == (pytest.approx(500.0), 2)


@pytest.mark.parametrize(("periods", "noise"), [(4, 0.0), (4, 1e-3), (1, 0.0), (4, 0.1)])
def test_the_number_of_periods_is_found_from_repeating_inputs(
    periods: int, noise: float, tmp_path: Path
) -> None:
    random, one = np.random.default_rng(0), recording()
    u = np.tile(one.u, (periods, 1))
    u += noise * random.standard_normal(u.shape)
    write_multi_axis(tmp_path / "one.csv", replace(one, u=u, y=np.zeros((len(u), 1))))
    found = read_multi_axis(tmp_path / "one.csv", periods=None).periods
    assert found == (periods if noise < 0.01 else 1)


def test_each_realisation_in_an_archive_becomes_one_recording(tmp_path: Path) -> None:
    values = np.random.default_rng(0).standard_normal((2, 32, 3, 4, 2))
    np.savez(tmp_path / "a.npz", u_low=values[0], y_low=values[1])
    found = read_realisations(tmp_path / "a.npz", 100.0, um_per_unit=1e6)
    assert [one.name for one in found] == ["low 1", "low 2", "low 3", "low 4"]
    np.testing.assert_array_equal(found[1].u[32:], values[0][:, :, 1, 1])
    np.testing.assert_array_equal(found[2].y[:32], 1e6 * values[1][:, :, 2, 0])


def test_an_archive_whose_arrays_have_the_wrong_shape_is_refused(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", u_low=np.zeros((8, 3)), y_low=np.zeros((8, 3)))
    with pytest.raises(RecordingError, match=r"expected \(samples, channels, realisations, periods\)"):
        read_realisations(tmp_path / "a.npz", 100.0)


def test_a_gap_in_the_numbering_of_inputs_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "one.csv"
    path.write_text("time_s,input_1_v,input_3_v\n" + "".join(f"{k / 10},1,2\n" for k in range(20)))
    with pytest.raises(RecordingError, match="input_1_v, input_3_v, expected numbers from 1 without a gap"):
        read_multi_axis(path)


def test_recordings_with_different_numbers_of_inputs_are_refused() -> None:
    with pytest.raises(RecordingError, match=r"two: found 3 inputs .* expected 2, 2 and 500 Hz as in one"):
        usable([recording(), recording(3, "two")])


def test_a_constant_input_is_left_out_with_a_warning_that_names_it() -> None:
    one = recording(3)
    still = replace(one, u=one.u * [1.0, 0.0, 1.0])
    with pytest.warns(
        RecordingWarning, match=r"input_2_v: found the same .* inputs of the stage are input_1_v, input_3_v"
    ):
        (found,) = usable([still])
    np.testing.assert_array_equal(found.u, one.u[:, [0, 2]])
    with pytest.raises(RecordingError, match="found inputs that never move, expected at least one"):
        usable([replace(one, u=0 * one.u)])


def test_proportional_inputs_are_refused_with_the_reason() -> None:
    one = recording(3)
    alike = replace(one, u=one.u[:, [0, 1, 0]] * [1.0, 1.0, -2.0])
    with pytest.raises(
        RecordingError, match="input_1_v, input_3_v: found inputs that always move in proportion"
    ):
        usable([alike])


def test_the_single_axis_reader_refuses_a_recording_of_several_axes(tmp_path: Path) -> None:
    write_multi_axis(tmp_path / "one.csv", recording())
    with pytest.raises(
        RecordingError, match=r"found a recording of several axes \(input_1_v, .*expected one input"
    ):
        read_recording(tmp_path / "one.csv")
    with pytest.raises(RecordingError, match=r"expected one input"):
        read_recording(tmp_path / "one.csv", output_column="output_1_um")
