"""Trajectories: the paper's start from rest; those of files are used as they are or refused in one line."""

from pathlib import Path

import numpy as np
import pytest

from torchpi.errors import RecordingError
from torchpi.excitation.trajectory import load_trajectory

FS_HZ = 10_000.0


def sine(frequency_hz: float = 20.0, samples: int = 1_000) -> np.ndarray:
    """0 … 6 µm from rest, µm."""
    return 3.0 - 3.0 * np.cos(2 * np.pi * frequency_hz * np.arange(samples) / FS_HZ)


@pytest.mark.parametrize(
    ("which", "duration_s", "low_um", "high_um"), [("slow", 2.0, 1.0, 7.0), ("fast", 1.0, 1.0, 7.826)]
)
def test_the_papers_trajectories_start_from_rest(
    which: str, duration_s: float, low_um: float, high_um: float
):
    trajectory = load_trajectory(which, fs_hz=FS_HZ)
    assert len(trajectory.yd) == duration_s * FS_HZ
    assert (trajectory.yr.min(), trajectory.yr.max()) == pytest.approx((low_um, high_um), abs=2e-3)
    assert trajectory.yd[0] == 0.0
    # With ζ = 1 and ω = 200π, the initial transient has decayed to (1 + ωt) e^(-ωt) after t = 50 ms.
    late = slice(int(0.05 * FS_HZ), None)
    np.testing.assert_allclose(trajectory.yd[late], trajectory.yr[late], atol=1e-11)


def write_csv(path: Path, t: np.ndarray, y: np.ndarray, header: str = "time_s,yd_um") -> Path:
    path.write_text(
        header + "\n" + "".join(f"{a!r},{b!r}\n" for a, b in zip(t.tolist(), y.tolist(), strict=True))
    )
    return path


@pytest.mark.parametrize("header", ["time_s,yd_um", "time_s, output_um"])
def test_a_trajectory_file_gives_its_samples(tmp_path: Path, header: str):
    y = sine()
    path = write_csv(tmp_path / "scan.csv", 3.0 + np.arange(len(y)) / FS_HZ, y, header)
    trajectory = load_trajectory(path, fs_hz=FS_HZ)
    np.testing.assert_array_equal(trajectory.yd, y)
    assert (trajectory.name, trajectory.title, len(trajectory.sha256 or "")) == ("scan", "scan.csv", 64)


def test_a_file_can_be_the_input_of_the_reference_filter(tmp_path: Path):
    y = 1.0 + sine()
    path = write_csv(tmp_path / "scan.csv", np.arange(len(y)) / FS_HZ, y)
    trajectory = load_trajectory(path, fs_hz=FS_HZ, through_reference_filter=True)
    np.testing.assert_array_equal(trajectory.yr, y)
    assert trajectory.yd[0] == 0.0
    assert trajectory.yd[-1] == pytest.approx(y[-1])


def test_resampling_interpolates_and_never_overshoots(tmp_path: Path):
    t = np.arange(201) / 1_000.0
    t[1:-1] += 2e-4 * np.sin(np.arange(199))  # uneven, too
    path = write_csv(tmp_path / "scan.csv", t, 3.0 - 3.0 * np.cos(2 * np.pi * 20.0 * t))
    trajectory = load_trajectory(path, fs_hz=FS_HZ, resample=True)
    assert len(trajectory.yd) == 2_001
    # The error bound of linear interpolation across the widest gap, 1.4 ms: amplitude · (ω · gap)² / 8.
    straight_lines = 3.0 * (2 * np.pi * 20.0 * 1.4e-3) ** 2 / 8
    np.testing.assert_allclose(trajectory.yd, sine(20.0, 2_001), atol=straight_lines)
    assert trajectory.yd.max() <= 6.0


def rows(*changed: tuple[int, str]) -> str:
    lines = ["time_s,yd_um", *(f"{k * 1e-4:.4f},{k % 7}" for k in range(30))]
    for number, text in changed:
        lines[number - 1] = text
    return "\n".join(lines)


@pytest.mark.parametrize(
    ("text", "found"),
    [
        (rows((1, "time_s,yd")), r"yd_um.*'yd'"),
        ("", r"empty"),
        (rows((9, "0.0007,nan")), r"row 9.*yd_um.*nan"),
        (rows((9, "0.0007,inf")), r"row 9.*yd_um.*inf"),
        (rows((9, "0.0007")), r"row 9"),
        (rows((9, "x,1")), r"row 9.*time_s.*x"),
        (rows((9, "")), r"row 10.*option resample"),
        (rows((9, "0.0006,1")), r"row 9"),
        ("time_s,yd_um\n0,0\n0.0001,1\n", r"2 samples"),
        (rows().replace("0.00", "0.000"), r"sampled at 100000 Hz; expected 10000 Hz.*--resample"),
    ],
)
def test_a_trajectory_file_that_cannot_be_used_is_refused_in_one_line(tmp_path: Path, text: str, found: str):
    path = tmp_path / "scan.csv"
    path.write_text(text)
    with pytest.raises(RecordingError, match=found) as raised:
        load_trajectory(path, fs_hz=FS_HZ)
    assert str(path) in str(raised.value)
    assert "\n" not in str(raised.value)


def test_a_missing_trajectory_file_is_refused():
    with pytest.raises(RecordingError, match=r"quick: no such file; expected 'slow', 'fast'"):
        load_trajectory("quick", fs_hz=FS_HZ)
