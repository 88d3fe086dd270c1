"""Any finite recording is diagnosed, or refused in one line: nothing crashes, and every number is finite."""

import dataclasses
import json
import math
from pathlib import Path

import numpy as np
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from torchpi.diagnosis.diagnose import diagnose
from torchpi.diagnosis.diagnosis import Diagnosis
from torchpi.errors import TorchpiError
from torchpi.recordings.recording import Recording
from torchpi.report.diagnosis_json import diagnosis_json
from torchpi.report.what_was_run import provenance
from torchpi.stage import Stage

KINDS = ("constant", "zero", "ramp", "sine", "steps", "one step", "walk", "noise", "two values", "impulse")


def signal(kind: str, samples: int, seed: int) -> np.ndarray:
    rng, t = np.random.default_rng(seed), np.linspace(0, 1, samples)
    return {
        "constant": np.full(samples, 1.0),
        "zero": np.zeros(samples),
        "ramp": t,
        "sine": np.sin(2 * np.pi * rng.integers(1, 20) * t),
        "steps": np.repeat(rng.standard_normal(8), -(-samples // 8))[:samples],
        "one step": (t > 0.5).astype(float),
        "walk": np.cumsum(rng.standard_normal(samples)),
        "noise": rng.standard_normal(samples),
        "two values": rng.integers(0, 2, samples).astype(float),
        "impulse": np.eye(1, samples, samples // 2)[0],
    }[kind]


@st.composite
def recordings(draw: st.DrawFn) -> list[Recording]:
    found, columns = [], draw(st.integers(0, 1))
    scale_v, scale_um = (10.0 ** draw(st.integers(-9, 6)) for _ in range(2))
    for i in range(draw(st.integers(1, 2))):
        samples, seed = draw(st.integers(100, 400)), draw(st.integers(0, 99))
        u = scale_v * (
            signal(draw(st.sampled_from(KINDS)), samples, seed) + draw(st.sampled_from([0, 0, -3, 50]))
        )
        follows = draw(st.booleans())
        y = scale_um * (u / scale_v if follows else signal(draw(st.sampled_from(KINDS)), samples, seed + 1))
        y = y + draw(st.sampled_from([0.0, 0.01])) * scale_um * signal("noise", samples, seed + 2)
        fs_hz = 10.0 ** draw(st.integers(-2, 7))
        aux = {f"aux_{k}": signal(draw(st.sampled_from(KINDS)), samples, seed + 3) for k in range(columns)}
        found.append(Recording("ab"[i], np.arange(samples) / fs_hz, u, y, fs_hz, aux))
    return found


# A failing example is small enough as drawn; shrinking it would take minutes.
@settings(max_examples=8, phases=(Phase.explicit, Phase.generate))
@given(recordings())
def test_a_recording_is_diagnosed_with_finite_numbers_or_refused_in_one_line(given: list[Recording]) -> None:
    try:
        found = diagnose(given)
    except TorchpiError as error:
        assert "\n" not in str(error) and len(str(error)) < 400
        return
    assert_finite(found)


def assert_finite(found: Diagnosis) -> None:
    told = json.loads(diagnosis_json(found, provenance("torchpi diagnose", {}, 0)))
    stated = {".fit.noise_floor_um": found.noise_floor_um, ".another_motion_um": found.another_motion_um}
    may_be_null = {place for place, value in stated.items() if value is None}
    holes = {path for path, value in leaves(told) if value is None and not path.endswith("interval_90")}
    assert holes <= may_be_null, holes
    assert math.isfinite(sum(dataclasses.astuple(found.augmented)))
    for trace in found.traces:
        assert np.isfinite(trace.residual_retuned).all() and np.isfinite(trace.residual_augmented).all()
    u = found.next_excitation[1]
    assert np.isfinite(u).all() and len(u) > 0


def leaves(value: object, path: str = "") -> list[tuple[str, object]]:
    if isinstance(value, dict):
        return [leaf for key, one in value.items() for leaf in leaves(one, f"{path}.{key}")]
    if isinstance(value, list) and value:
        return [leaf for one in value for leaf in leaves(one, path)]
    return [(path, value)]


def test_the_stage_of_an_odd_recording_can_be_saved_and_loaded(tmp_path: Path) -> None:
    u = signal("steps", 300, 1)
    found = diagnose([Recording("a", np.arange(300) / 1e3, u, signal("walk", 300, 2), 1e3)])
    found.stage.save(tmp_path / "stage.pt")
    assert Stage.load(tmp_path / "stage.pt").names == found.stage.names
