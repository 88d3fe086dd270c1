"""Several axes exported: one step in Python, TorchScript and C, with the same bits."""

import ctypes
import json
from pathlib import Path

import numpy as np
import pytest
import torch

from tests.export.c_compiler import built, needs_cc, run
from tests.stage.test_multi_axis import with_amplifiers
from tests.stage.two_axes import two_axes
from torchpi.control.multi_axis import MultiAxisInverse, linear_inverses
from torchpi.errors import ArtifactError, ConfigError
from torchpi.export import write_together
from torchpi.export.multi_axis import multi_axis_files
from torchpi.operators.modal_feedback import parameter_shapes
from torchpi.stage.multi_axis import MultiAxisStage, MultiAxisStream

RATE_HZ, RMS_V, BAND_HZ = 1000.0, 0.3, 30.0


def linear() -> MultiAxisStage:
    """Return a stage of two inputs and one output that has only modes."""
    old = two_axes()
    shapes = old.shapes._replace(outputs=1, elements=0, functions=1, input_plays=0)
    arrays = {name: np.zeros(shape) for name, shape in parameter_shapes(shapes).items()}
    arrays |= {name: old.arrays()[name] for name in ("poles", "drive")}
    arrays |= {name: old.arrays()[name][:1] for name in ("seen", "direct")}
    return MultiAxisStage(RATE_HZ, arrays, offset_um=[0.5])


@pytest.fixture(scope="module")
def filters() -> tuple[np.ndarray, np.ndarray]:
    return linear_inverses(two_axes(), RMS_V, BAND_HZ)


@pytest.fixture(params=["stage", "linear stage", "inverse", "linear inverse"])
def exported(
    request: pytest.FixtureRequest, filters: tuple[np.ndarray, np.ndarray]
) -> MultiAxisStage | MultiAxisInverse:
    if request.param.endswith("stage"):
        return linear() if request.param == "linear stage" else with_amplifiers(200.0)
    short = [one[200:-200] for one in filters]
    passes = 0 if request.param == "linear inverse" else 2
    limits, accepted = np.array([[-0.1, 0.2], [-0.3, 0.3]]), np.array([3.0, 2.0])
    return MultiAxisInverse(two_axes(), *short, passes, limits, accepted)


def inputs(exported: MultiAxisStage | MultiAxisInverse) -> np.ndarray:
    """Return noise with samples that are held."""
    x = np.random.default_rng(0).uniform(-0.4, 0.4, (600, 2))
    x[[0, 300, 301], [1, 0, 1]] = np.nan, np.inf, -np.inf
    if isinstance(exported, MultiAxisInverse):
        x[400] = 3.0, 2.1
    return x


def answers(exported: MultiAxisStage | MultiAxisInverse, x: np.ndarray) -> np.ndarray:
    if isinstance(exported, MultiAxisInverse):
        exported.reset()
        return exported.block(x)
    held = x.copy()
    held[0], held[300:302] = 0.0, x[299]
    return MultiAxisStream(exported).block(held)


def written(exported: MultiAxisStage | MultiAxisInverse, folder: Path, *formats: str) -> Path:
    write_together(multi_axis_files(exported, folder / "two", formats))
    return folder / "two"


def test_torchscript_has_the_bits_of_the_step(
    exported: MultiAxisStage | MultiAxisInverse, tmp_path: Path
) -> None:
    loaded = torch.jit.load(f"{written(exported, tmp_path, 'torchscript')}.pt")
    x = inputs(exported)
    expected = answers(exported, x)
    found = [loaded.step(one) for one in x[:150].tolist()] + loaded.block(torch.from_numpy(x[150:])).tolist()
    np.testing.assert_array_equal(found, expected)
    assert loaded.held_inputs == (3 if isinstance(exported, MultiAxisStage) else 4)
    loaded.reset()
    np.testing.assert_array_equal(loaded.block(torch.from_numpy(x[:200])), expected[:200])
    if isinstance(exported, MultiAxisInverse):
        assert (loaded.preview, loaded.sample_period_s) == (exported.preview, 1 / RATE_HZ)
    else:
        assert loaded.delay_samples == exported.delay_samples


@needs_cc
def test_c_has_the_bits_of_the_step(exported: MultiAxisStage | MultiAxisInverse, tmp_path: Path) -> None:
    source = written(exported, tmp_path, "c").with_suffix(".c")
    loaded = ctypes.CDLL(str(built(tmp_path / "two.so", "-shared", "-fPIC", source, "-lm")))
    x = inputs(exported)
    expected = answers(exported, x)
    state, u = (ctypes.c_double * 40_000)(), np.empty_like(expected)

    def pointer(array: np.ndarray) -> ctypes.c_void_p:
        return ctypes.c_void_p(array.ctypes.data)

    loaded.two_reset(state)
    for t in range(150):
        loaded.two_step(state, pointer(x[t]), pointer(u[t]))
    loaded.two_block(state, pointer(x[150:]), pointer(u[150:]), ctypes.c_size_t(len(x) - 150))
    np.testing.assert_array_equal(u, expected)


@needs_cc
def test_the_self_test_passes_and_detects_a_changed_number(
    exported: MultiAxisStage | MultiAxisInverse, tmp_path: Path
) -> None:
    source = written(exported, tmp_path, "c").with_suffix(".c")
    test = tmp_path / "two_selftest.c"
    passed = run(built(tmp_path / "passes", source, test, "-lm"))
    assert (passed.returncode, passed.stdout.count("pass")) == (0, 2)
    text = source.read_text()
    name = "FIRST_0" if isinstance(exported, MultiAxisInverse) else "POLE_RE"
    at = text.index("0.", text.index(name))
    source.write_text(text[:at] + "1" + text[at:])
    failed = run(built(tmp_path / "fails", source, test, "-lm"))
    assert (failed.returncode, failed.stdout.count("FAIL")) == (1, 2)


def test_a_stage_is_finite_again_after_an_unbounded_motion(tmp_path: Path) -> None:
    loaded = torch.jit.load(f"{written(with_amplifiers(200.0), tmp_path, 'torchscript')}.pt")
    loaded.block(torch.full((200, 2), 1e9, dtype=torch.float64))
    assert loaded.stage.unbounded > 0
    assert torch.isfinite(loaded.block(torch.zeros(2000, 2, dtype=torch.float64))).all()


def test_json_has_the_numbers_and_their_units(
    exported: MultiAxisStage | MultiAxisInverse, tmp_path: Path
) -> None:
    content = json.loads(Path(f"{written(exported, tmp_path, 'json')}.json").read_text())
    inverse = isinstance(exported, MultiAxisInverse)
    stage, content_of_stage = (exported.stage, content["stage"]) if inverse else (exported, content)
    np.testing.assert_array_equal(content_of_stage["modes"]["p_q"], stage.arrays()["poles"])
    assert content["input"]["unit"] == ("um" if inverse else "V")


def test_invalid_names_and_formats_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="to: found 'page', expected one or more of torchscript,c,json"):
        multi_axis_files(two_axes(), tmp_path / "two", ["page", "c"])
    with pytest.raises(ArtifactError, match="name for C: found 'a-b'"):
        multi_axis_files(two_axes(), tmp_path / "a-b", ["c"])
