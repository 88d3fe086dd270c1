"""The FMU: bits of the C step, resets and instances through FMI, its description, and what it refuses."""

import ctypes
import math
import re
import subprocess
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from tests.control.test_direct_inverse import compensator, trajectory
from tests.export.c_compiler import STRICT, Stepped, needs_cc
from torchpi.errors import ArtifactError, ExportWarning
from torchpi.export import export_files
from torchpi.export.deployable import Deployable
from torchpi.operators import ReferenceFilter

PAGE = (Path(__file__).parents[2] / "docs" / "controllers.md").read_text(encoding="utf-8")
OK, ERROR = 0, 3
TIME, YD, U, HELD_INPUTS, OUTSIDE_RANGE, LIMITED_OUTPUTS, PERIOD, MIN_VOLTAGE, MAX_VOLTAGE, PREVIEW = range(
    10
)
LONG = 10**6
"""Number of samples that are compared bit by bit."""
Log = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_int, ctypes.c_char_p, ctypes.c_char_p)


def written(folder: Path, made: Deployable | None = None, filter_: ReferenceFilter | None = None) -> Path:
    (file,) = export_files(made or compensator(), folder / "demo", ("fmu",), filter_)
    return file


def unpacked(file: Path) -> Path:
    folder = file.with_suffix("")
    with zipfile.ZipFile(file) as archive:
        archive.extractall(folder)
    return folder


class Loaded:
    """The library of an unpacked FMU, through ctypes alone."""

    def __init__(self, library: Path) -> None:
        self.call = ctypes.CDLL(str(library))
        self.call.fmi3GetVersion.restype = ctypes.c_char_p
        self.call.fmi3InstantiateCoSimulation.restype = ctypes.c_void_p
        self.messages: list[str] = []
        self.log = Log(lambda _, status, category, message: self.messages.append(message.decode()))

    def instance(self, token: str, event_mode: bool = False) -> "Instance | None":
        flags = [ctypes.c_bool(one) for one in (False, False, event_mode, False)]
        pointer = self.call.fmi3InstantiateCoSimulation(
            b"one", token.encode(), None, *flags, None, ctypes.c_size_t(0), None, self.log, None
        )
        return Instance(self.call, ctypes.c_void_p(pointer)) if pointer else None


class Instance:
    def __init__(self, library: ctypes.CDLL, pointer: ctypes.c_void_p) -> None:
        self.library, self.pointer = library, pointer
        self.time_s = 0.0

    def __call__(self, function: str, *arguments: Any) -> int:
        return int(getattr(self.library, f"fmi3{function}")(self.pointer, *arguments))

    def begin(self, start_s: float = 0.0) -> None:
        self.time_s = start_s
        no, start = ctypes.c_bool(False), ctypes.c_double(start_s)
        assert self("EnterInitializationMode", no, ctypes.c_double(0), start, no, ctypes.c_double(0)) == OK
        assert self("ExitInitializationMode") == OK

    def set(self, value: float, reference: int = YD) -> int:
        one = ctypes.c_size_t(1)
        given = ctypes.c_uint32(reference), ctypes.c_double(value)
        return self("SetFloat64", ctypes.byref(given[0]), one, ctypes.byref(given[1]), one)

    def get(self, reference: int) -> float:
        whole = reference in (HELD_INPUTS, OUTSIDE_RANGE, LIMITED_OUTPUTS, PREVIEW)
        value = ctypes.c_uint64() if whole else ctypes.c_double()
        one, vr = ctypes.c_size_t(1), ctypes.c_uint32(reference)
        kind = "UInt64" if whole else "Float64"
        assert self(f"Get{kind}", ctypes.byref(vr), one, ctypes.byref(value), one) == OK
        return value.value

    def advance(self, by_s: float, at_s: float | None = None) -> int:
        at = self.time_s if at_s is None else at_s
        flags, last = [ctypes.c_bool() for _ in range(3)], ctypes.c_double()
        outcome = self(
            "DoStep",
            ctypes.c_double(at),
            ctypes.c_double(by_s),
            ctypes.c_bool(True),
            *map(ctypes.byref, flags),
            ctypes.byref(last),
        )
        self.time_s = last.value
        return outcome

    def steps(self, yd: list[float], period_s: float) -> list[float]:
        u = []
        for sample in yd:
            assert (self.set(sample), self.advance(period_s)) == (OK, OK)
            u.append(self.get(U))
        return u


@pytest.fixture(scope="module")
def loaded(tmp_path_factory: pytest.TempPathFactory) -> tuple[Loaded, str]:
    folder = unpacked(written(tmp_path_factory.mktemp("fmu")))
    (library,) = (folder / "binaries").glob("*/demo.*")
    return Loaded(library), token(folder)


def token(folder: Path) -> str:
    text = (folder / "modelDescription.xml").read_text()
    return text.partition('instantiationToken="')[2].partition('"')[0]


def started(loaded: tuple[Loaded, str], start_s: float = 0.0) -> Instance:
    instance = loaded[0].instance(loaded[1])
    assert instance is not None
    instance.begin(start_s)
    return instance


@needs_cc
def test_steps_resets_and_instances_have_the_bits_of_the_stream(loaded: tuple[Loaded, str]) -> None:
    stream, other = compensator().stream(), compensator().stream()
    period, yd = stream.sample_period_s, trajectory(900).tolist()
    yd[300] = math.nan
    one, beside = started(loaded), started(loaded)
    assert loaded[0].call.fmi3GetVersion() == b"3.0"
    expected = [stream.step(sample) for sample in yd]
    assert [one.steps([sample], period)[0] for sample in yd] == expected
    assert one.get(HELD_INPUTS) == stream.held_inputs > 0
    assert one("Reset") == OK and one.get(HELD_INPUTS) == one.get(U) == 0
    one.begin()
    assert one.steps(yd, period) == expected
    assert beside.steps(yd[::-1], period) == [other.step(sample) for sample in yd[::-1]]
    for instance in (one, beside):
        assert instance("Terminate") == OK
        instance("FreeInstance")


@needs_cc
def test_samples_are_taken_when_they_are_due_at_any_communication_step(loaded: tuple[Loaded, str]) -> None:
    stream = compensator().stream()
    period = stream.sample_period_s
    expected = [stream.step(1.0) for _ in range(40)]
    # Four samples within a step; then a sample every four steps, taken in the first of them.
    instance = started(loaded, start_s=3.0)
    assert instance.steps([1.0] * 5, 4 * period) == expected[3:20:4]
    assert instance.steps([1.0] * 80, period / 4) == [u for u in expected[20:] for _ in range(4)]


@needs_cc
def test_a_saved_state_can_be_restored(loaded: tuple[Loaded, str]) -> None:
    instance, kept = started(loaded), ctypes.c_void_p()
    period, yd = instance.get(PERIOD), trajectory(200).tolist()
    instance.steps(yd, period)
    assert instance("GetFMUState", ctypes.byref(kept)) == OK
    time_s, after = instance.time_s, instance.steps(yd, period)
    assert instance("SetFMUState", kept) == OK
    instance.time_s = time_s
    assert instance.steps(yd, period) == after
    assert instance("FreeFMUState", ctypes.byref(kept)) == OK and not kept


@needs_cc
def test_period_preview_and_limits_are_among_the_variables(loaded: tuple[Loaded, str]) -> None:
    stream, instance = compensator().stream(), started(loaded)
    assert instance.get(PERIOD) == stream.sample_period_s and instance.get(PREVIEW) == stream.preview
    limits = stream.min_voltage_v, stream.max_voltage_v
    assert (instance.get(MIN_VOLTAGE), instance.get(MAX_VOLTAGE)) == limits


@needs_cc
@pytest.mark.parametrize(
    ("call", "found"),
    [
        (lambda one: one.advance(1e-4, at_s=1.0), "another currentCommunicationPoint"),
        (lambda one: one.advance(0.0), "no finite communicationStepSize"),
        (lambda one: one.advance(math.inf), "no finite communicationStepSize"),
        (lambda one: one.advance(math.nan), "no finite communicationStepSize"),
        (lambda one: one.set(1.0, reference=U), "cannot be set, expected 1"),
        (lambda one: one.set(1.0, reference=99), "cannot be set, expected 1"),
        (lambda one: one("EnterEventMode"), "fmi3EnterEventMode: this FMU does not offer it"),
        (lambda one: one("GetInt32", None, ctypes.c_size_t(0), None, ctypes.c_size_t(0)), "fmi3GetInt32"),
        (lambda one: one("ExitInitializationMode"), "expected in initialization mode"),
        (lambda one: one("Reset") or one.advance(1e-4, at_s=0.0), "expected in step mode"),
    ],
)
def test_an_invalid_call_is_refused_with_the_reason(
    call: Callable[[Instance], int], found: str, loaded: tuple[Loaded, str]
) -> None:
    instance = started(loaded)
    assert call(instance) == ERROR and found in loaded[0].messages[-1]


@needs_cc
def test_a_wrong_token_or_event_mode_gives_no_instance(loaded: tuple[Loaded, str]) -> None:
    assert loaded[0].instance("another") is None and "instantiationToken" in loaded[0].messages[-1]
    assert loaded[0].instance(loaded[1], event_mode=True) is None and "eventMode" in loaded[0].messages[-1]


@needs_cc
def test_the_fmu_builds_from_its_sources_alone_under_strict_flags(tmp_path: Path) -> None:
    sources = unpacked(written(tmp_path)) / "sources"
    library = tmp_path / "own.so"
    command = ["cc", *STRICT, "-shared", "-fPIC", "demo.c", "demo_fmi3.c", "-o", str(library)]
    done = subprocess.run(command, cwd=sources, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    u = started((Loaded(library), token(sources.parent))).steps(trajectory(50).tolist(), 1e-4)
    assert u == compensator().stream().block(trajectory(50)).tolist()
    # Every function that the standard declares is exported, for tools that look all of them up.
    exported = subprocess.run(["nm", "-D", "--defined-only", library], capture_output=True, text=True).stdout
    header = (sources / "fmi3Functions.h").read_text()
    assert header.count("FMI3_Export fmi3") == sum(" T fmi3" in line for line in exported.splitlines()) > 70


@needs_cc
def test_a_million_steps_with_resets_in_fmpy_have_the_bits_of_the_c_step(tmp_path: Path) -> None:
    fmi3 = pytest.importorskip("fmpy.fmi3", reason="needs fmpy: pip install 'torchpi[fmi]'")
    export_files(compensator(), tmp_path / "demo", ("c",))
    folder, c, yd = unpacked(written(tmp_path)), Stepped(tmp_path / "demo.c"), trajectory(LONG // 4)
    fmu = fmi3.FMU3Slave(
        guid=token(folder), unzipDirectory=str(folder), modelIdentifier="demo", instanceName="one"
    )
    fmu.instantiate()
    library, pointer = fmu.dll, ctypes.c_void_p(fmu.component)
    other = Instance(library, pointer)
    for _ in range(4):
        c.reset()
        assert other("Reset") == OK
        other.begin()
        assert np.array_equal(stepped(library, pointer, yd.numpy(), 1e-4), c.block(yd).numpy())


def stepped(library: Any, pointer: ctypes.c_void_p, yd: np.ndarray, period_s: float) -> np.ndarray:
    """Step through all samples by bare function calls: objects around each call would take minutes."""
    references = [(ctypes.c_uint32 * 1)(YD), (ctypes.c_uint32 * 1)(U)]
    yd_now, u_now, one = ctypes.c_double(), ctypes.c_double(), ctypes.c_size_t(1)
    flags, last = [ctypes.byref(ctypes.c_bool()) for _ in range(3)], ctypes.byref(ctypes.c_double())
    given, taken = ctypes.byref(yd_now), ctypes.byref(u_now)
    size, true = ctypes.c_double(period_s), ctypes.c_bool(True)
    put, step, get = library.fmi3SetFloat64, library.fmi3DoStep, library.fmi3GetFloat64
    u = np.empty_like(yd)
    for k, sample in enumerate(yd.tolist()):
        yd_now.value = sample
        bad = put(pointer, references[0], one, given, one)
        bad |= step(pointer, ctypes.c_double(k * period_s), size, true, *flags, last)
        assert not bad | get(pointer, references[1], one, taken, one)
        u[k] = u_now.value
    return u


@needs_cc
def test_the_fmu_is_valid_for_fmpy_and_its_simulation_equals_the_stream(tmp_path: Path) -> None:
    pytest.importorskip("fmpy", reason="needs fmpy: pip install 'torchpi[fmi]'")
    from fmpy.validation import validate_fmu

    from torchpi.simulators.fmu import Fmu

    made, filter_ = compensator(), ReferenceFilter(1e-4)
    file = written(tmp_path, made, filter_)
    assert validate_fmu(str(file)) == []
    yd = trajectory(400) + 1.0
    found = Fmu.of(str(file))(yd.numpy(), 1 / made.sample_period_s)
    assert np.array_equal(found, made.stream(filter_).block(yd).numpy())


@needs_cc
def test_commands_on_the_controllers_page_build_and_simulate_the_fmu(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (shell,) = re.findall(r"```sh\n(unzip .*?)```", PAGE, re.DOTALL)
    (python,) = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
    (tmp_path / "exports").mkdir()
    sources = unpacked(written(tmp_path / "exports")) / "sources"
    command = shell.splitlines()[-1]
    assert command.startswith("cc ") and not subprocess.run(command.split(), cwd=sources).returncode
    assert started((Loaded(sources / "demo.so"), token(sources.parent))).set(1.0) == OK
    pytest.importorskip("fmpy", reason="needs fmpy: pip install 'torchpi[fmi]'")
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}
    exec(python, names)
    yd = torch.as_tensor(names["yd_um"])
    assert names["found"]["u"][1:].tolist() == compensator().stream().block(yd)[: len(yd)].tolist()


def test_without_a_compiler_the_fmu_has_only_sources_and_a_warning_is_given(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CC", "no-such-compiler")
    with pytest.warns(
        ExportWarning, match="found no C compiler 'no-such-compiler', so .* only sources; run: "
    ):
        file = written(tmp_path)
    with zipfile.ZipFile(file) as archive:
        assert set(archive.namelist()) == {
            "modelDescription.xml",
            "sources/buildDescription.xml",
            "sources/demo.c",
            "sources/demo.h",
            "sources/demo_fmi3.c",
            "sources/fmi3Functions.h",
            "sources/fmi3FunctionTypes.h",
            "sources/fmi3PlatformTypes.h",
        }


def test_the_warning_about_a_failing_compiler_quotes_its_message(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CC", f"{sys.executable} -c \"raise SystemExit('out of order')\"")
    with pytest.warns(ExportWarning, match=r"failed \(out of order\), so .* only sources"):
        written(tmp_path)


@pytest.mark.filterwarnings("ignore::torchpi.errors.ExportWarning")
def test_equal_models_give_identical_bytes_and_others_another_token(tmp_path: Path) -> None:
    for name in ("a", "b", "c"):
        (tmp_path / name).mkdir()
    first, again = written(tmp_path / "a"), written(tmp_path / "b")
    assert first.read_bytes() == again.read_bytes()
    other = written(tmp_path / "c", compensator(seed=3))
    assert token(unpacked(first)) != token(unpacked(other))


def test_the_name_of_an_fmi_header_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ArtifactError, match="name for an FMU: found 'fmi3Functions'"):
        export_files(compensator(), tmp_path / "fmi3Functions", ("fmu",))
