"""The C99 form: the bits of the stream, single precision, its self-test, and parts without a C form."""

import math
import re
import subprocess
import tempfile
from pathlib import Path

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import nn

import torchpi.control.direct_inverse
from tests.control.test_corrected import corrected
from tests.control.test_corrected import voltage as wave
from tests.control.test_direct_inverse import compensator, trajectory
from tests.export.c_compiler import FLOAT, STRICT, Stepped, built, cc, needs_cc, run
from torchpi.control.direct_inverse import DirectInverse
from torchpi.errors import ArtifactError
from torchpi.export import export_files
from torchpi.export.c_source import c_source
from torchpi.export.deployable import Deployable
from torchpi.operators import ReferenceFilter


def written(folder: Path, made: Deployable, filter_: ReferenceFilter | None = None) -> Path:
    export_files(made, folder / "demo", ("c",), filter_)
    return folder / "demo.c"


@st.composite
def compensators(draw: st.DrawFn) -> DirectInverse:
    return compensator(
        seed=draw(st.integers(0, 10**6)),
        rate=draw(st.sampled_from(["none", "linear", "neural"])),
        hidden=draw(st.integers(1, 4)),
        lead=draw(st.integers(0, 2)),
        degree=draw(st.integers(1, 5)),
        output_degree=draw(st.integers(1, 3)),
        creep_time_constants_s=draw(st.sampled_from([[], [0.02], [0.01, 0.3, 5.0]])),
        thresholds=draw(st.sampled_from([[0.0], [0.0, 0.5], [0.3, 0.0, 1.0, 0.0, 2.0], [0.1] * 11])),
        offset=draw(st.booleans()),
        preview=draw(st.integers(0, 2)),
    )


@needs_cc
@settings(max_examples=8)
@given(made=compensators(), filtered=st.booleans())
def test_c_has_the_bits_of_the_stream_and_float_is_close(made: DirectInverse, filtered: bool) -> None:
    filter_ = ReferenceFilter(1e-4) if filtered else None
    yd = trajectory(400) + (1.0 if filtered else 0.0)
    yd[[37, 38, 200]] = torch.tensor([math.nan, math.inf, -math.inf], dtype=torch.float64)
    expected = made.stream(filter_).block(yd)
    with tempfile.TemporaryDirectory() as folder:
        source = written(Path(folder), made, filter_)
        double, single = Stepped(source), Stepped(source, single=True)
        assert torch.equal(double.steps(yd), expected)
        double.reset()
        # A block, then steps, then a block share one state.
        parts = double.block(yd[:150]), double.steps(yd[150:210]), double.block(yd[210:])
        assert torch.equal(torch.cat(parts), expected)
        assert float((single.steps(yd) - expected).abs().max()) <= 1e-5 * 10.0


@needs_cc
@pytest.mark.parametrize("filtered", [False, True])
def test_corrected_inverse_has_the_same_bits_in_c(filtered: bool, tmp_path: Path) -> None:
    made, filter_ = corrected(2), ReferenceFilter(1e-3) if filtered else None
    yd = 1 + wave(5)[0]
    expected = made.stream(filter_).block(yd)
    source = written(tmp_path, made, filter_)
    assert torch.equal(Stepped(source).block(yd), expected)
    assert float((Stepped(source, single=True).block(yd) - expected).abs().max()) <= 1e-5 * 10.0


@needs_cc
def test_several_states_are_independent(tmp_path: Path) -> None:
    source = written(tmp_path, compensator())
    forth, back = trajectory(300), trajectory(300).flip(0).contiguous()
    expected = compensator().stream().block(forth), compensator().stream().block(back)
    one, other = Stepped(source), Stepped(source)
    pairs = [(one.step(a), other.step(b)) for a, b in zip(forth.tolist(), back.tolist(), strict=True)]
    assert torch.equal(torch.tensor(pairs, dtype=torch.float64).T, torch.stack(expected))


@needs_cc
@pytest.mark.parametrize("flags", [[], ["-Ddemo_FLOAT32", *FLOAT]])
def test_selftest_passes(flags: list[str], tmp_path: Path) -> None:
    source = written(tmp_path, compensator(), ReferenceFilter(1e-4))
    # The self-test promotes numbers on purpose: only the deployed code is checked for promotion.
    code = tmp_path / "demo.o"
    assert cc(*flags, "-c", source, "-o", code).returncode == 0
    selftest = tmp_path / "demo_selftest.c"
    done = run(built(tmp_path / "selftest", *flags[:1], selftest, code))
    assert done.returncode == 0 and done.stdout.count("pass") == 2 and "FAIL" not in done.stdout


@needs_cc
@pytest.mark.parametrize("name", ["TAU_2", "G", "KEPT", "C", "RATE_SCALE_UM_S", "SHIFT", "THETA", "U_0"])
def test_selftest_fails_when_a_constant_is_altered(name: str, tmp_path: Path) -> None:
    source = written(tmp_path, compensator())
    text, count = re.subn(rf"( {name}(?:\[\d+\])? = {{?)(-?[\d.e-]+)", r"\1 1.0001 * \2", source.read_text())
    assert count == 1
    source.write_text(text)
    done = run(built(tmp_path / "selftest", source, tmp_path / "demo_selftest.c"))
    assert done.returncode != 0 and "FAIL" in done.stdout


@needs_cc
def test_code_has_no_dependencies_and_its_header_is_valid_in_c_plus_plus(tmp_path: Path) -> None:
    source = written(tmp_path, compensator(), ReferenceFilter(1e-4))
    assert set(re.findall("#include (.*)", source.read_text())) == {'"demo.h"'}
    header = (tmp_path / "demo.h").read_text()
    assert set(re.findall("#include (.*)", header)) == {"<stdbool.h>", "<stddef.h>"}
    assert (header + source.read_text()).isascii()
    code = tmp_path / "demo.o"
    assert cc("-O2", "-c", source, "-o", code).returncode == 0
    undefined = subprocess.run(["nm", "-u", str(code)], capture_output=True, text=True).stdout.split()
    assert not [name for name in undefined if name not in ("U", "_GLOBAL_OFFSET_TABLE_")]
    assert 'extern "C"' in header


@needs_cc
def test_files_of_single_and_double_precision_do_not_link(tmp_path: Path) -> None:
    source = written(tmp_path, compensator())
    code = tmp_path / "demo.o"
    assert cc("-Ddemo_FLOAT32", "-c", source, "-o", code).returncode == 0
    assert "undefined" in cc(tmp_path / "demo_selftest.c", code, "-o", tmp_path / "mixed").stderr


def test_constants_are_written_in_order_with_unit_and_equation() -> None:
    made = compensator()
    text = c_source(made, "demo")["demo.c"]
    found = re.search(r"R\[10\] = {([^}]*)}; /\* (.*?) \*/", text, re.DOTALL)
    assert found and [float(n) for n in found[1].split(",")] == made.plays.r.tolist()
    assert found[2] == "um, threshold of play i, eq. 1"
    assert re.search(r"TAU_2 = [-\d.e]+; /\* s\^2, lead on the acceleration \*/", text)
    assert all(len(line) <= 120 for line in text.splitlines())


def test_plays_and_relaxations_are_written_as_loops() -> None:
    text = c_source(compensator(), "demo")["demo.c"]
    assert "real h = play(s, R[i], self->h[i]); /* eq. 1 */" in text
    assert "self->xi[i] = KEPT[i] * self->xi[i] + TAKEN[i] * x;" in text


def test_a_play_may_be_written_with_conditional_expressions(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(torchpi.control.direct_inverse, "play", play_by_selection)
    text = c_source(compensator(), "demo")["demo.c"]
    assert "return low > inner ? low : inner;" in text


def play_by_selection(x: float, r: float, h: float) -> float:
    low = x - r
    high = x + r
    inner = h if h < high else high
    return low if low > inner else inner


@pytest.mark.parametrize(
    "name", ["int", "2nd", "with-dash", "_hidden", "stdio", "", "ümlaut", "motion", "reference", "squash "]
)
def test_a_name_that_is_invalid_in_c_or_taken_is_refused(name: str) -> None:
    filter_ = ReferenceFilter(1e-4) if name == "reference" else None
    made = corrected(1) if name == "reference" else compensator()
    with pytest.raises(ArtifactError, match="name for C: found") as error:
        c_source(made, name, filter_)
    assert "\n" not in str(error.value)


class Tanh(nn.Module):
    """A part with a function that the translator to C does not know."""

    @torch.jit.export
    def reset(self) -> None:
        return

    @torch.jit.export
    def step(self, x: float) -> float:
        return math.tanh(x)


class Around(nn.Module):
    """A step that contains a given part."""

    def __init__(self, part: nn.Module, sample_period_s: float = 1e-4) -> None:
        super().__init__()
        self.part = part
        self.sample_period_s = sample_period_s
        self.preview = 0
        self.min_voltage_v = 0.0
        self.max_voltage_v = 10.0
        self.has_reference_filter = False
        self.held_inputs = 0

    def reset(self) -> None:
        self.held_inputs = 0

    def step(self, yd: float) -> float:
        x = self.part.step(yd)
        return x

    def stream(self, reference_filter: ReferenceFilter | None = None) -> "Around":
        return self


class Scaled(nn.Module):
    """A part with an arbitrary constant."""

    def __init__(self, gain: object) -> None:
        super().__init__()
        self.gain = gain

    def step(self, x: float) -> float:
        return self.gain * x


class ListFunction(nn.Module):
    def step(self, x: float) -> float:
        return sum([x, x])


class TwoSteps(nn.Module):
    def __init__(self) -> None:
        super().__init__()
        self.a = Tanh()

    def step(self, x: float) -> float:
        return self.a.step(x) - self.a.step(x)


class StepBesideState(nn.Module):
    def __init__(self) -> None:
        super().__init__()
        self.y = 0.0

    def step(self, x: float) -> float:
        return self.y + self.next(x)

    def next(self, x: float) -> float:
        self.y = x
        return x


@pytest.mark.parametrize("format_", ["c", "pt2"])
def test_an_unsupported_part_is_named_and_nothing_is_written(format_: str, tmp_path: Path) -> None:
    with pytest.raises(ArtifactError, match=r"part 'part' \(Tanh\) has no (C|\.pt2) form: .*tanh") as error:
        export_files(Around(Tanh()), tmp_path / "out" / "demo", (format_,))
    assert "\n" not in str(error.value) and list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("part", "says"),
    [
        (Scaled(math.inf), "part 'part' .*gain: found inf, expected finite numbers"),
        (Scaled([1.0, math.nan]), "part 'part' .*gain: found .*nan"),
        (Scaled("2"), "part 'part' .*gain is neither a number"),
        (Scaled(torch.ones(2)), "part 'part' .*gain is neither a number"),
        (Scaled(2), "part 'part' .*whole and real"),
        (ListFunction(), r"part 'part' \(ListFunction\) has no C form"),
        (TwoSteps(), "a step of a part beside another step"),
        (StepBesideState(), "a step of a part beside another step or a state"),
    ],
)
def test_a_part_that_c_cannot_express_is_refused_by_name(part: nn.Module, says: str) -> None:
    with pytest.raises(ArtifactError, match=says) as error:
        c_source(Around(part), "demo")
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("period", [0.0, -1e-4, math.inf, math.nan])
def test_a_sample_period_that_is_not_positive_is_refused(period: float) -> None:
    with pytest.raises(ArtifactError, match="sample_period_s"):
        c_source(Around(Scaled(2.0), period), "demo")


def test_a_model_with_nan_parameters_is_refused() -> None:
    made = compensator()
    with torch.no_grad():
        made.weights.theta[1, 1] = math.nan
    with pytest.raises(ArtifactError, match="theta"):
        c_source(made, "demo")


def test_the_tests_compile_with_the_promised_strict_flags() -> None:
    assert {"-std=c99", "-ffp-contract=off", "-Wall", "-Wextra", "-Wpedantic", "-Werror"} <= set(STRICT)
