"""A stage that is not modelled by the compensator's own equations, and recordings of it."""

from pathlib import Path

import numpy as np
import pytest

from torchpi.recordings.recording import Recording, write_recording

FS_HZ = 1000.0


def stage(u: np.ndarray, noise_um: float = 1e-3, seed: int = 0) -> np.ndarray:
    """Plays of the voltage, a quadratic term, one sample of delay: (time,) V to (time,) µm."""
    y = np.zeros_like(u)
    for r, w in ((0.0, 0.5), (0.3, 0.1), (0.8, 0.1), (1.6, 0.1)):
        h = 0.0
        for k, voltage in enumerate(u):
            h = max(voltage - r, min(voltage + r, h))
            y[k] += w * h
    y = np.concatenate(([0.0], y[:-1]))
    return y + 0.004 * y**2 + np.random.default_rng(seed).normal(0.0, noise_um, len(u))


def recording(name: str, seed: int, seconds: float = 1.0, fs_hz: float = FS_HZ) -> Recording:
    """Record a smooth random voltage of 0…10 V that starts from 0 V."""
    t = np.arange(round(seconds * fs_hz)) / fs_hz
    phases = np.random.default_rng(seed).uniform(0, 2 * np.pi, 4)
    wave = sum(np.sin(2 * np.pi * f * t + phase) for f, phase in zip((2, 3, 5, 7), phases, strict=True))
    u = 5 * (1 + wave / 4) * (1 - np.exp(-t / 0.05))
    return Recording(name, t, u, stage(u, seed=seed), fs_hz)


@pytest.fixture(scope="session")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """Three files of the stage at one sample rate."""
    folder = tmp_path_factory.mktemp("recordings")
    return [write(folder, recording(f"r{seed}", seed)) for seed in range(3)]


def write(folder: Path, record: Recording) -> str:
    path = folder / f"{record.name}.csv"
    write_recording(path, record)
    return str(path)
