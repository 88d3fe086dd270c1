"""Small results to draw: a stage with a play and a delay, and compensators that undo part of it."""

import math
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib.figure import Figure

from tests.hostile.sequences import compensator
from tests.paper.short_run import short_run
from tests.report.synthetic_diagnosis import diagnosis
from torchpi.cli.check import check_files
from torchpi.diagnosis.diagnosis import Diagnosis
from torchpi.export import safety_card
from torchpi.loop import run_loop
from torchpi.loop.result import LoopResult
from torchpi.recordings.options import RecordingOptions
from torchpi.recordings.recording import Recording
from torchpi.report import commission_page
from torchpi.report.diagnosis_figures import diagnosis_figures
from torchpi.report.diagnosis_page import write_diagnosis
from torchpi.report.page import training_page, write_loop_report
from torchpi.report.safety_page import safety_page
from torchpi.report.training import RecordFit, Saturation, TrainingReport, WeightsAgainstRate
from torchpi.report.what_was_run import Provenance
from torchpi.stage import Stage

FS_HZ = 10_000.0


class PlayStream:
    """y follows 0.8 u through a play of 0.4 V, one sample late."""

    def reset(self, seed: int) -> None:
        self.h, self.y, self.noise = 0.0, 0.0, np.random.default_rng(seed)

    def step(self, u: float) -> tuple[float, float]:
        y = self.y
        self.h = max(u - 0.4, min(u + 0.4, self.h))
        self.y = 0.3 * u + 0.5 * self.h
        return y, y + 0.002 * self.noise.standard_normal()


class PlayStage:
    sample_period_s = 1 / FS_HZ
    min_voltage_v = 0.0
    max_voltage_v = 10.0
    seed = 0

    def stream(self) -> PlayStream:
        return PlayStream()


@dataclass
class Turning:
    """Adds `jump_v` when the trajectory rises, and subtracts it when it falls."""

    jump_v: float
    preview: int = 1
    sample_period_s: float = 1 / FS_HZ

    def reset(self) -> None:
        self.previous = 0.0

    def step(self, yd: float) -> float:
        jump_v = math.copysign(self.jump_v, yd - self.previous)
        self.previous = yd
        return min(max(yd / 0.8 + jump_v, 0.0), 10.0)


@pytest.fixture(scope="session")
def results() -> list[LoopResult]:
    def run(name: str, title: str, frequency_hz: float) -> LoopResult:
        t = np.arange(8_000) / FS_HZ
        yd = 3.5 - 3.5 * np.cos(2 * np.pi * frequency_hz * t) * (1 - 0.2 * np.sin(2 * np.pi * 2.5 * t) ** 2)
        return run_loop(
            Turning(0.25),
            PlayStage(),
            yd,
            fs_hz=FS_HZ,
            name=name,
            title=title,
            compare={"two_stage_least_squares": Turning(0.15)},
            seed=3,
        )

    return [run("slow", "eq. 15 (slow)", 5.0), run("fast", "eq. 16 (fast)", 40.0)]


@pytest.fixture(scope="session")
def provenance() -> Provenance:
    return Provenance(
        command="torchpi run exports/a.pt --stage '<b>.yaml'",
        seed=3,
        files={"compensator: exports/a.pt": "0" * 64, "stage: <b>.yaml": "1" * 64},
        versions={"python": "3.11", "torch": "2.13"},
        machine="Linux x86_64",
    )


@pytest.fixture(scope="session")
def training() -> TrainingReport:
    t = np.arange(20_000) / FS_HZ
    y = 4 - 4 * np.cos(2 * np.pi * 10 * t)
    u = y + 0.3 * np.sin(2 * np.pi * 10 * t)
    noise = np.random.default_rng(0).standard_normal(len(t))
    u_hat = u + 0.01 * np.sin(2 * np.pi * 30 * t) + 0.002 * noise
    record = RecordFit("multisine_2", "held out", t, y, u, u_hat)
    r = np.array([0, 0.05, 0.1, 0.2, 0.3, 0.5, 1, 1.5, 2, 3])
    rate = np.linspace(-900.0, 900.0, 61)
    w = 1e-4 * np.cos(np.arange(10)) * rate[:, None] + 0.5 / (1 + np.arange(10))
    x = np.linspace(0.0, 8.1, 200)
    c = np.array([1.40, -7.62e-2, 1.45e-2, -7.53e-4])  # eq. 12
    errors = {"rms_v": 0.0103, "max_v": 0.021, "rms_um": 0.0086, "max_um": 0.0175}
    errors |= {"rms_percent": 0.1, "max_percent": 0.2}
    return TrainingReport(
        name="recorded",
        metrics={
            "train": errors,
            "heldout": {key: 1.2 * value for key, value in errors.items()},
            "baseline_lstsq": {key: 3.0 * value for key, value in errors.items()},
            "loading_excluded": errors,
        },
        records=(record,),
        weights=WeightsAgainstRate(rate, w, r),
        saturation=Saturation(x, (c * x[:, None] ** np.arange(1, 5)).sum(1), c),
        notes=("The stage leads by a lag.",),
    )


@pytest.fixture(scope="session")
def loop_html(
    results: list[LoopResult], provenance: Provenance, tmp_path_factory: pytest.TempPathFactory
) -> str:
    page, _ = write_loop_report(results, provenance, tmp_path_factory.mktemp("loop"))
    return page.read_text(encoding="utf-8")


@pytest.fixture(scope="session")
def training_html(training: TrainingReport, provenance: Provenance) -> str:
    return training_page(training, provenance)


@pytest.fixture(scope="session")
def recording() -> Recording:
    t = np.arange(8_000) / FS_HZ
    u = 5 - 5 * np.cos(2 * np.pi * 5 * t)
    y = 0.8 * u + 0.002 * np.random.default_rng(1).standard_normal(len(t))
    return Recording("mine", t, u, y, FS_HZ)


@pytest.fixture(scope="session")
def commission_html(results: list[LoopResult], recording: Recording, provenance: Provenance) -> str:
    stage = Stage.from_yaml("default")
    outcome = SimpleNamespace(
        heldout=recording,
        errors=SimpleNamespace(rms_v=0.02),
        forward=SimpleNamespace(stage=stage, steps=[SimpleNamespace(names=["creep"], unseen_rms_um=0.01)]),
        loop=results[1],
        looped_s=0.8,
        identified=SimpleNamespace(heldout_rms_um=0.004),
        without_um=results[1].without.on_true.whole.rms_um,
        with_um=results[1].compensated.on_true.whole.rms_um,
        times_better=results[1].improvement["torchpi"].whole_rms,
        trusted=True,
    )
    return commission_page.page(outcome, provenance)


@pytest.fixture(scope="session")
def check_html(recording: Recording, tmp_path_factory: pytest.TempPathFactory) -> str:
    folder = tmp_path_factory.mktemp("check")
    table = np.stack([recording.t, recording.u, recording.y], 1)
    for name in ("slow", "fast"):
        header = "time_s,input_v,output_um"
        np.savetxt(folder / f"{name}.csv", table, "%.9g", ",", header=header, comments="")
    check_files([folder / "slow.csv", folder / "fast.csv"], folder, RecordingOptions(), "torchpi check")
    return (folder / "check.html").read_text(encoding="utf-8")


@pytest.fixture(scope="session")
def paper_html() -> str:
    return (short_run() / "paper.html").read_text(encoding="utf-8")


@pytest.fixture(scope="session")
def safety_html(provenance: Provenance) -> str:
    return safety_page("demo", safety_card(compensator()), provenance)


@pytest.fixture(scope="session")
def found() -> Diagnosis:
    return diagnosis()


@pytest.fixture(scope="session")
def figures(found: Diagnosis) -> dict[str, Figure]:
    return diagnosis_figures(found)


@pytest.fixture(scope="session")
def folder(
    found: Diagnosis,
    figures: dict[str, Figure],
    provenance: Provenance,
    tmp_path_factory: pytest.TempPathFactory,
) -> Path:
    directory = tmp_path_factory.mktemp("diagnosis")
    write_diagnosis(found, provenance, directory, figures)
    return directory
