"""Recordings made from arrays and data frames follow the same rules, and raise the same errors, as files."""

from typing import Any

import numpy as np
import pytest
import torch

from torchpi.errors import RecordingError, RecordingWarning, TorchpiError
from torchpi.recordings.identity import recordings_sha256
from torchpi.recordings.recording import Recording

T = np.arange(2000) / 1000
U = 5 - 5 * np.cos(2 * np.pi * T)
Y = 0.8 * U


class Frame:
    """The part of a pandas frame's interface that is used."""

    def __init__(self, index: Any = None, **columns: Any) -> None:
        self.columns, self._columns = list(columns), columns
        self.index = np.arange(len(T)) if index is None else index

    def __getitem__(self, name: str) -> Any:
        return self._columns[name]


def test_arrays_tensors_and_lists_give_the_same_recording() -> None:
    one = Recording.from_arrays(T, U, Y)
    for t, u, y in ((list(T), list(U), list(Y)), (torch.tensor(T), torch.tensor(U), torch.tensor(Y)[None])):
        other = Recording.from_arrays(t, u, y)
        assert np.array_equal(one.u, other.u) and np.array_equal(one.y, other.y) and one.fs_hz == other.fs_hz
    assert Recording.from_arrays(None, U, Y, fs_hz=1000).fs_hz == one.fs_hz == 1000
    assert recordings_sha256([one]) == recordings_sha256([Recording.from_arrays(None, U, Y, fs_hz=1000)])


def test_arrays_take_the_same_unit_zero_skip_and_aux_options_as_files() -> None:
    made = Recording.from_arrays(
        1e3 * T,
        1e3 * U,
        1e3 * Y + 7,
        time_unit="ms",
        input_unit="mV",
        output_unit="nm",
        zero="first",
        skip_s=0.5,
        aux={"aux_temperature": T},
    )
    assert np.allclose(made.u, U[500:]) and np.allclose(made.y, Y[500:]) and made.fs_hz == 1000
    assert np.array_equal(made.aux["aux_temperature"], T[500:])


def test_a_frame_is_read_by_its_column_names_and_units() -> None:
    columns = {"u [mV]": 1e3 * U, "y (nm)": 1e3 * Y}
    stamps = np.datetime64("2026-01-01") + (1e6 * T).round().astype("timedelta64[us]")
    for frame in (Frame(time_ms=1e3 * T, **columns), pandas_index(stamps, columns)):
        made = Recording.from_frame(frame, name="slow")
        assert np.allclose(made.u, U) and np.allclose(made.y, Y) and made.fs_hz == pytest.approx(1000)


def pandas_index(stamps: np.ndarray, columns: dict[str, np.ndarray]) -> Any:
    """A pandas frame with dates in another time zone as its index."""
    import pandas  # comes with asammdf

    return pandas.DataFrame(columns, index=pandas.DatetimeIndex(stamps).tz_localize("Europe/Berlin"))


@pytest.mark.parametrize(
    ("t", "u"),
    [
        (T.astype(object), U.astype(object)),
        ([f"{t:.3f}".replace(".", ",") for t in T], [f"{u:.17g}".replace(".", ",") for u in U]),
        ([f"2026-01-01T12:00:{t:06.3f}Z" for t in T], U),
    ],
    ids=["objects", "decimal commas", "ISO dates"],
)
def test_a_frame_accepts_objects_decimal_commas_and_iso_dates_as_a_text_file_does(t: Any, u: Any) -> None:
    import pandas

    for kind in (object, None):  # None: pandas' own string type
        frame = pandas.DataFrame({"time": pandas.Series(t, dtype=kind), "u": pandas.Series(u), "y": Y})
        made = Recording.from_frame(frame)
        assert np.allclose(made.u, U) and made.fs_hz == pytest.approx(1000)


def test_changing_the_source_arrays_does_not_change_the_recording() -> None:
    import pandas

    t, u, y, extra = T.copy(), U.copy(), torch.tensor(Y), T.copy()
    frame = pandas.DataFrame({"time_s": t, "u": u, "y": Y.copy()})
    made = [Recording.from_arrays(t, u, y, aux={"aux_x": extra}), Recording.from_frame(frame)]
    t *= 2
    u *= 2
    y *= 2
    extra *= 2
    frame.loc[:, "u"] = 0.0
    for one in made:
        assert np.array_equal(one.t, T) and np.array_equal(one.u, U) and np.array_equal(one.y, Y)
    assert np.array_equal(made[0].aux["aux_x"], T)


@pytest.mark.parametrize(("factor", "unit"), [(1e3, "ms or us"), (1e-6, "s")])
def test_an_implausible_sample_rate_causes_a_warning_with_the_likely_time_unit(
    factor: float, unit: str
) -> None:
    with pytest.warns(RecordingWarning, match=f"sampled at .* Hz .*; if the time stamps are in {unit}, give"):
        Recording.from_arrays(factor * T, U, Y)


SWAPPED = np.concatenate([T[:5], T[9:10], T[6:9], T[5:6], T[10:]])
HOLE = np.where(np.arange(len(Y)) == 17, np.nan, Y)


@pytest.mark.parametrize(
    ("arguments", "options", "message"),
    [
        ((T, U, Y[:-1]), {}, "arrays: unequal lengths: 'u' 2000, 'y' 1999, 't' 2000 samples, expected one"),
        ((T, np.stack([U, U]), Y), {}, "arrays: 'u' is an array of 2×2000, expected one signal"),
        ((T, U.astype(str), Y), {}, "arrays: 'u' holds <U32, expected numbers"),
        ((T, U + 0j, Y), {}, "arrays: 'u' holds complex128, expected numbers"),
        ((T, U, [[1.0], [2.0, 3.0]]), {}, "arrays: 'y': found list, expected an array of numbers"),
        ((T, U, torch.tensor(Y, requires_grad=True)), {}, "arrays: 'y': found Tensor of 2000, expected"),
        ((T, U, HOLE), {}, "arrays: index 17: column 'y': found nan, expected a finite number"),
        ((T, np.ma.masked_equal(U, U[9]), Y), {}, "arrays: index 9: column 'u': found nan"),
        ((SWAPPED, U, Y), {}, "arrays: index 6: time goes from 0.009 s to 0.006 s, expected an increase"),
        ((None, U, Y), {}, "arrays: found neither t nor fs_hz, expected one of them"),
        ((T, U, Y), {"input_unit": "mA"}, "arrays: input_unit is 'mA', expected one of V, mV"),
        ((T, U, Y), {"unit": "V"}, "found the option 'unit', expected one of"),
        ((T, T.astype("datetime64[s]"), Y), {}, "arrays: column 'u' is in s, expected V, mV"),
        (([], [], []), {}, "arrays: 0 samples, expected at least 10"),
        ((T, U > 5, Y), {}, "arrays: 'u' holds bool, expected numbers"),
        ((T, U, Y), {"aux": {"temp": T}}, "arrays: aux: found 'temp', expected a name that begins with aux_"),
        ((T, U, Y), {"aux": [T]}, "arrays: aux: found list, expected signals by name"),
        ((T, U, Y), {"resample": "no"}, "resample: found 'no', expected true or false"),
        ((None, U, Y), {"fs": 1000}, "found the option 'fs', expected one of"),
    ],
    ids=[
        "lengths",
        "two axes",
        "words",
        "complex",
        "ragged",
        "gradient",
        "nan",
        "masked",
        "unsorted",
        "no time",
        "unit",
        "option",
        "dates",
        "empty",
        "booleans",
        "aux's name",
        "aux's kind",
        "word",
        "no time but an option",
    ],
)
def test_invalid_arrays_are_refused_in_one_line_that_names_the_fault(
    arguments: tuple[Any, ...], options: dict[str, Any], message: str
) -> None:
    with pytest.raises(TorchpiError) as refused:
        Recording.from_arrays(*arguments, **options)
    assert message in str(refused.value) and "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("frame", "message"),
    [
        ([1, 2], "frame: found list, expected a frame with columns, such as pandas.DataFrame"),
        (Frame(time_s=T, a=U, b=Y), "frame: no column 'input_v' (input_column); the file has: time_s, a, b"),
        (
            Frame(time_s=T, u=U, **{"y [inch]": Y}),
            "frame: column 'y [inch]' is in inch, expected um, nm, mm, m, pm, cm, angstrom; choose another",
        ),
        (Frame(time_s=SWAPPED, u=U, y=Y), "frame: iloc 6: time goes from 0.009 s to 0.006 s"),
        (Frame(time_s=T, u=U, y=HOLE), "frame: iloc 17: column 'y': found nan"),
    ],
    ids=["a list", "no voltage", "unknown unit", "unsorted", "nan"],
)
def test_an_invalid_frame_is_refused_in_one_line_that_names_the_fault(frame: Any, message: str) -> None:
    with pytest.raises(RecordingError) as refused:
        Recording.from_frame(frame)
    assert message in str(refused.value) and "\n" not in str(refused.value)
