"""Recordings that are broken, odd or malicious: each is read, or refused in one line, and none takes long."""

import io
import signal
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType

import numpy as np
import pytest

from torchpi.errors import RecordingWarning, TorchpiError
from torchpi.recordings.readers import open_source
from torchpi.recordings.summary import columns_in, summarise

MOST_S = 10
ROWS = 120
T = np.arange(ROWS) / 1e3
U = 5 - 5 * np.cos(2 * np.pi * 25 * T)
Y = 0.8 * U + 0.05 * np.sin(7 * U)


@contextmanager
def at_most(seconds: int) -> Iterator[None]:
    """Turn a hang into a failure."""

    def stop(_signal: int, _frame: FrameType | None) -> None:
        raise TimeoutError(f"not done after {seconds} s")

    before = signal.signal(signal.SIGALRM, stop)
    signal.alarm(seconds)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def outcome(path: Path, **options: object) -> str:
    """Return `read`, or the refusal in one line that names the file; any other exception fails the test."""
    with at_most(MOST_S), warnings.catch_warnings():
        warnings.simplefilter("ignore", RecordingWarning)  # any other warning is an error
        try:
            from torchpi.recordings.options import RecordingOptions

            columns_in(open_source(path))
            summarise(path, RecordingOptions().with_changes(**options))
        except TorchpiError as error:
            text = str(error)
            assert text.startswith(str(path)), text
            assert "\n" not in text and len(text) < 2000, text
            return text
    return "read"


def csv(
    header: str = "time_s,input_v,output_um", t: np.ndarray = T, u: np.ndarray = U, y: np.ndarray = Y
) -> str:
    rows = [",".join(map(repr, map(float, row))) for row in zip(t, u, y, strict=True)]
    return "\n".join([header, *rows]) + "\n"


def with_cell(row: int, column: int, cell: str) -> str:
    lines = csv().split("\n")
    cells = lines[row].split(",")
    cells[column] = cell
    lines[row] = ",".join(cells)
    return "\n".join(lines)


def changed(x: np.ndarray, **at: float) -> np.ndarray:
    x = x.copy()
    for index, value in at.items():
        x[int(index[1:])] = value
    return x


BAD_CELLS = [
    "nan",
    "inf",
    "-inf",
    "1e160",
    "-1e160",
    "1e999",
    "9.9E37",
    "1e-300",
    "",
    " ",
    "abc",
    "--",
    "1_000",
    "0x10",
    "1,5",
    "1.2.3",
    "+-1",
    "١٢",
    "#N/A",
    "=1+1",
    '"',
    '""',
    "'1'",
    "True",
    "None",
    "1e",
    "e5",
    "\x00",
    "\t",
    "\ufeff1",
    "1j",
    "NaN(ind)",
    "-1.#IND",
    "1 2",
    "∞",
    "9" * 400,
    "1e-400",
    "-0",
    "%s",
    "{}",
    "$(reboot)",
]


@pytest.mark.parametrize("column", [0, 1, 2], ids=["time", "input", "output"])
@pytest.mark.parametrize("cell", BAD_CELLS, ids=[repr(cell)[:12] for cell in BAD_CELLS])
def test_a_cell_is_read_as_a_number_or_refused_with_its_row(tmp_path: Path, cell: str, column: int) -> None:
    path = tmp_path / "a.csv"
    path.write_text(with_cell(60, column, cell), encoding="utf-8")
    found = outcome(path)
    if cell == "1,5":
        assert "row 61: found 4 cells, expected 3" in found
    if cell in ("nan", "1e160", "abc", "", "9.9E37"):
        assert "row 61:" in found and f"'{('time_s', 'input_v', 'output_um')[column]}'" in found


WHOLE_FILES: dict[str, bytes] = {
    "empty": b"",
    "one byte": b"\n",
    "spaces": b" " * 5000,
    "commas": b",,,\n" * 50,
    "semicolons alone": b";" * 5000,
    "a header alone": b"time_s,input_v,output_um\n",
    "a header twice": (csv() + csv()).encode(),
    "two tables": (csv() + "\n\n" + csv("a,b")).encode(),
    "a header of numbers": csv("1,2,3").encode(),
    "a header of one name": csv("time_s,time_s,time_s").encode(),
    "no names": csv(",,").encode(),
    "a name of a megabyte": csv("x" * 1_000_000 + ",input_v,output_um").encode(),
    "ten thousand columns": b",".join(b"c%d" % k for k in range(10_000)) + (b"\n" + b"1," * 9_999 + b"1") * 9,
    "rows that grow": b"\n".join(b"1," * k for k in range(1, 200)),
    "one row": b"time_s,input_v,output_um\n0,1,2\n",
    "nine rows": "\n".join(csv().split("\n")[:10]).encode(),
    "constants": csv(u=0 * U, y=0 * Y).encode(),
    "a flat output": csv(y=0 * Y + 3).encode(),
    "a flat input": csv(u=0 * U + 3).encode(),
    "time stands": csv(t=0 * T).encode(),
    "time runs backwards": csv(t=-T).encode(),
    "time jumps back": csv(t=changed(T, k60=0.01)).encode(),
    "time leaps to 1e9": csv(t=changed(T, k119=1e9)).encode(),
    "time leaps to 1e160": csv(t=changed(T, k119=1e160)).encode(),
    "steps of 1e-300": csv(t=1e-300 * np.arange(ROWS)).encode(),
    "steps of 1e-13": csv(t=1e-13 * np.arange(ROWS)).encode(),
    "steps of 1e9": csv(t=1e9 * np.arange(ROWS)).encode(),
    "steps of 1e100": csv(t=1e100 * np.arange(ROWS)).encode(),
    "times in 1e15": csv(t=1e15 + T).encode(),
    "times that double": csv(t=1e-9 * 2.0 ** np.minimum(np.arange(ROWS), 80)).encode(),
    "values of 1e160": csv(u=1e160 * U).encode(),
    "values of 1e-300": csv(u=1e-300 * U).encode(),
    "outputs of 1e-300": csv(y=1e-300 * Y).encode(),
    "outputs of 1e308": csv(y=1e307 * Y).encode(),
    "denormals": csv(u=5e-324 * np.arange(ROWS), y=5e-324 * np.arange(ROWS)).encode(),
    "white noise": csv(y=np.random.default_rng(0).standard_normal(ROWS)).encode(),
    "an offset of 1e11": csv(y=1e11 + Y).encode(),
    "every other reading zero": csv(y=Y * (np.arange(ROWS) % 2)).encode(),
    "flipped": csv(y=-Y).encode(),
    "carriage returns": csv().replace("\n", "\r").encode(),
    "UTF-16": csv().encode("utf-16"),
    "UTF-16 cut": csv().encode("utf-16")[:-1],
    "UTF-32": csv().encode("utf-32"),
    "a mark alone": b"\xef\xbb\xbf",
    "two marks": b"\xef\xbb\xbf\xef\xbb\xbf" + csv().encode(),
    "Latin-1": csv("time_s,input_v,output [\xb5m]").encode("latin-1"),
    "Latin-1 late": (csv() * 40).encode() + "# \xb5\n".encode("latin-1"),
    "binary": bytes(range(256)) * 20,
    "binary late": csv().encode() * 40 + bytes(range(256)),
    "a NUL late": (csv() + "\0").encode() + b"1,2,3\n",
    "XML": b"<?xml version='1.0'?>\n<a><b>1,2,3</b></a>\n" * 20,
    "JSON": b'{"time_s": [0, 1, 2], "input_v": [0, 1, 2]}\n',
    "HTML": b"<!DOCTYPE html><html><body>404 Not Found</body></html>",
    "a shell script": b"#!/bin/sh\nrm -rf /\n" * 10,
    "a spreadsheet": b"PK\x03\x04" + bytes(1000),
    "a pickle": b"\x80\x04cos\nsystem\n(S'true'\ntR.",
    "sep alone": b"sep=;\n",
    "sep that lies": ("sep=|\n" + csv()).encode(),
    "sep of a letter": ("sep=1\n" + csv()).encode(),
    "an open quote": ('"' + csv()).encode(),
    "quotes of lines": csv().replace("0.05,", '"0.05\n,').encode(),
    "a cell of a megabyte": (csv() + "1,2," + "3" * 1_000_000 + "\n").encode(),
    "a cell of 200 kB in quotes": (csv() + '1,2,"' + "3" * 200_000 + '"\n').encode(),
    "comments alone": b"# nothing\n" * 1000,
    "a preamble of a thousand lines": (b"note: this and that\n" * 1000) + csv().encode(),
    "words": b"the quick brown fox jumps over the lazy dog\n" * 60,
    "numbers in one column": b"\n".join(b"%d" % k for k in range(100)),
    "two columns": b"\n".join(b"%d,%d" % (k, k % 7) for k in range(100)),
    "units alone": b"s,V,um\n" * 30,
    "decimal commas between commas": csv().replace(".", ",").encode(),
    "both decimal signs": csv().replace(",", ";").replace("0.05", "0,05").encode(),
    "thousands": b"time_s;input_v;output_um\n" + b"1.234,5;2.345,6;3.456,7\n" * 30,
    "stamps of no calendar": b"time,input_v,output_um\n" + b"2024-13-45T25:61:61,1,2\n" * 30,
    "stamps of the year 9999": b"time,input_v,output_um\n" + b"9999-12-31T23:59:59,1,2\n" * 30,
    "stamps and words": b"time,input_v,output_um\n" + b"2024-01-01T00:00:00,1,2\nnow,1,2\n" * 30,
    "midnight": b"time,input_v,output_um\n" + b"23:59:59,1,2\n00:00:00,2,3\n" * 30,
    "escapes": csv("time_s,input_v,\x1b[31moutput_um").encode(),
    "a name with a line end": csv('time_s,input_v,"output\n_um"').encode(),
    "a format string": csv("time_s,input_v,output_%n%s{0}").encode(),
    "many aux": csv("time_s,input_v,aux_output_um").encode(),
}


@pytest.mark.parametrize("name", WHOLE_FILES)
@pytest.mark.parametrize("suffix", [".csv", ".lvm"])
def test_any_text_is_read_or_refused(tmp_path: Path, name: str, suffix: str) -> None:
    path = tmp_path / f"a{suffix}"
    path.write_bytes(WHOLE_FILES[name])
    outcome(path)
    outcome(path, resample=True, fs_hz=1000)


@pytest.mark.parametrize("seed", range(100))
def test_a_damaged_text_is_read_or_refused(tmp_path: Path, seed: int) -> None:
    random = np.random.default_rng(seed)
    path = tmp_path / "a.csv"
    path.write_bytes(damaged(csv().encode(), random))
    outcome(path, resample=bool(seed % 2))


def damaged(data: bytes, random: np.random.Generator) -> bytes:
    """Return data with some bytes changed, removed or duplicated, or with the end cut off."""
    changed_data = bytearray(data)
    for _ in range(int(random.integers(1, 20))):
        at = int(random.integers(len(changed_data)))
        match int(random.integers(4)):
            case 0:
                changed_data[at] = int(random.integers(256))
            case 1:
                del changed_data[at : at + int(random.integers(1, 30))]
            case 2:
                changed_data[at:at] = changed_data[at : at + int(random.integers(1, 200))]
            case _:
                changed_data[at : at + 1] = random.choice([b",", b";", b"\t", b"\n", b"-", b"e", b'"'])
        if not changed_data:
            break
    return bytes(
        changed_data[: int(random.integers(len(changed_data) + 1))] if random.random() < 0.2 else changed_data
    )


def stored(kind: str, path: Path) -> bytes:
    """Return a valid recording in a binary format."""
    buffer = io.BytesIO()
    if kind == ".npy":
        np.save(buffer, np.stack((T, U, Y), 1))
    elif kind == ".npz":
        np.savez(buffer, time_s=T, input_v=U, output_um=Y)
    elif kind == ".h5":
        h5py = pytest.importorskip("h5py")
        with h5py.File(path, "w") as file:
            file["time_s"], file["input_v"], file["output_um"] = T, U, Y
        return path.read_bytes()
    elif kind == ".tdms":
        nptdms = pytest.importorskip("nptdms")
        with nptdms.TdmsWriter(path) as writer:
            writer.write_segment(
                [
                    nptdms.ChannelObject("run", name, values, properties={"wf_increment": 1e-3})
                    for name, values in (("input_v", U), ("output_um", Y))
                ]
            )
        return path.read_bytes()
    elif kind == ".mf4":
        asammdf = pytest.importorskip("asammdf")
        with asammdf.MDF() as file:
            file.append(
                [
                    asammdf.Signal(samples=x, timestamps=T, name=n)
                    for n, x in (("input_v", U), ("output_um", Y))
                ]
            )
            file.save(path)
        return path.read_bytes()
    else:
        from scipy.io import savemat

        savemat(buffer, {"time_s": T, "input_v": U, "log": {"output_um": Y}})
    return buffer.getvalue()


@pytest.mark.parametrize("kind", [".npy", ".npz", ".mat", ".h5", ".tdms", ".mf4"])
@pytest.mark.parametrize("seed", range(20))
def test_a_damaged_array_file_is_read_or_refused(tmp_path: Path, kind: str, seed: int) -> None:
    path = tmp_path / f"a{kind}"
    data = damaged(stored(kind, tmp_path / f"good{kind}"), np.random.default_rng(seed))
    path.write_bytes(data)
    outcome(path)


@pytest.mark.parametrize(
    ("kind", "array"),
    [
        (".npy", np.array([{"a": 1}], dtype=object)),
        (".npy", np.zeros((3, 4, 5))),
        (".npy", np.zeros(0)),
        (".npy", np.zeros((0, 3))),
        (".npy", np.array(3.0)),
        (".npy", np.array(["a", "b"])),
        (".npy", np.zeros(30, dtype=complex)),
        (".npy", np.zeros(30, dtype="datetime64[s]")),
        (".npy", np.zeros((30, 3), dtype=bool)),
        (".npy", np.full((30, 3), np.nan)),
        (".npy", np.stack((T, U, Y), 1).astype(np.float16)),
        (".npz", np.array([{"a": 1}], dtype=object)),
        (".npz", np.zeros((2, 3, 4))),
    ],
)
def test_an_unsuitable_array_is_read_or_refused(tmp_path: Path, kind: str, array: np.ndarray) -> None:
    path = tmp_path / f"a{kind}"
    if kind == ".npy":
        np.save(path, array)
    else:
        np.savez(path, input_v=array, output_um=array)
    outcome(path, fs_hz=1000)


def test_a_header_that_claims_more_memory_than_is_available_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.npy"
    np.save(path, np.zeros((30, 3)))
    path.write_bytes(path.read_bytes().replace(b"(30, 3)", b"(9999999999999, 3)"[:18].ljust(7)))
    assert outcome(path) != "read"


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"fs_hz": "nowhere"}, "fs_hz"),
        ({"fs_hz": 0}, "fs_hz"),
        ({"fs_hz": -1}, "fs_hz"),
        ({"fs_hz": float("nan")}, "fs_hz"),
        ({"fs_hz": 1e300}, "fs_hz"),
        ({"fs_hz": 1e11, "resample": True}, "resample"),
        ({"input_unit": 0}, "input_unit"),
        ({"input_unit": "furlong"}, "input_unit"),
        ({"output_unit": "nan"}, "output_unit"),
        ({"time_unit": -1}, "time_unit"),
        ({"time_unit": 1e-12}, "step"),
        ({"input_column": 0}, "input_column"),
        ({"input_column": 99}, "input_column"),
        ({"input_column": ""}, "input_column"),
        ({"input_column": "time_s[:,0]"}, "input_column"),
        ({"output_column": "input_v"}, "same column"),
        ({"skip_s": 1e9}, "no samples"),
    ],
)
def test_an_invalid_option_is_refused_by_name(tmp_path: Path, options: dict[str, object], text: str) -> None:
    path = tmp_path / "a.csv"
    path.write_text(csv())
    assert text in outcome(path, **options)
