"""A recording can be plotted and is displayed by a notebook."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from torchpi import Recording

T = np.arange(2000) / 1000
U = 5 - 5 * np.cos(2 * np.pi * T)


@pytest.fixture
def recording() -> Recording:
    return Recording.from_arrays(T, U, 0.8 * U, name="<slow>", aux={"aux_temperature": T})


def test_a_recording_draws_its_traces_and_its_loop(recording: Recording, tmp_path: Path) -> None:
    plot = recording.plot()
    labels = {(axes.get_xlabel(), axes.get_ylabel()) for axes in plot.figure.axes}
    assert labels == {("", "input (V)"), ("time (s)", "output (µm)"), ("input (V)", "output (µm)")}
    plot.savefig(tmp_path / "slow.png")
    assert (tmp_path / "slow.png").read_bytes().startswith(b"\x89PNG")


def test_a_recording_shows_its_numbers_and_its_figure(recording: Recording) -> None:
    html = recording._repr_html_()
    for said in (
        "&lt;slow&gt;",
        "2,000 at 1000 Hz, 2 s",
        "0 … 10 V, without noise",
        "0.800 µm/V",
        "aux_temperature",
        "<svg",
    ):
        assert said in html
    assert "<slow>" not in html and "<script" not in html
    empty = Recording("none", np.empty(0), np.empty(0), np.empty(0), 1000.0)
    assert empty._repr_html_() == "<b>none</b>: empty"


def test_importing_recordings_does_not_import_matplotlib() -> None:
    code = "import torchpi.recordings.recording, sys; assert 'matplotlib' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)
