"""The mirror, fitted once for each realisation, with that realisation of every amplitude left out.

    python benchmarks/mirror_folds.py [--output runs/mirror_folds] [--folds 1,2,3,4,5,6] [--without 200mV]
        [--seconds 540]

Prints the rms error of the realisations that were left out, µm, infinite without a bounded answer, and the
noise of their mean period, which is part of it; then the median and the worst of each amplitude. `--without`
leaves all realisations of an amplitude out of every fit. *Not linear* is what no linear correction takes away
of the errors of all realisations of an amplitude: at each frequency, what is left by least squares on the
three voltages, over the freedom that this leaves. A fold takes four to nine minutes on two idle cores; on one
it needs twice the `--seconds` of the config. One that has its `metrics.json` is not fitted again.
"""

import argparse
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import yaml

from torchpi.identification.multi_axis.fit import PeriodicFit
from torchpi.identification.multi_axis.identify import by_amplitude, periods
from torchpi.recordings.multi_axis import MultiAxisRecording, read_realisations
from torchpi.stage.multi_axis import MultiAxisStage

ROOT = Path(__file__).parents[1]
CONFIG = ROOT / "configs" / "mirror.yaml"
FOLDS = ("1", "2", "3", "4", "5", "6")


@dataclass(frozen=True)
class Level:
    """What the stages of all folds make of one amplitude.

    Attributes:
        left_out: The rms error of each realisation that was not fitted and the noise in it, µm.
        not_linear_um: What a linear correction of this amplitude leaves, µm, for each fold.
    """

    left_out: list[tuple[float, float]] = field(default_factory=list)
    not_linear_um: list[float] = field(default_factory=list)

    @property
    def median_um(self) -> float:
        """Of the errors."""
        return float(np.median([rms for rms, _ in self.left_out]))

    @property
    def worst(self) -> tuple[float, float]:
        """The largest error, and the noise in it."""
        return max(self.left_out)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--output", type=Path, default=Path("runs/mirror_folds"))
    parser.add_argument("--folds", default=",".join(FOLDS))
    parser.add_argument("--without", default="")
    parser.add_argument("--seconds", type=float)
    options = parser.parse_args()
    found = measured(options.output, options.folds.split(","), options.without, options.seconds, print)
    for name, level in found.items():
        worst, noise = level.worst
        print(
            f"{name}: median {level.median_um:.4f} µm, worst {worst:.4f} µm, of which noise {noise:.4f} µm, "
            f"of {len(level.left_out)}; not linear {np.median(level.not_linear_um):.4f} µm"
        )


def measured(
    output: Path,
    folds: Sequence[str] = FOLDS,
    without: str = "",
    seconds: float | None = None,
    log: Callable[[str], None] = lambda text: None,
) -> dict[str, Level]:
    """The levels by their names, the lowest first, after a fit for each fold."""
    settings = yaml.safe_load(CONFIG.read_text(encoding="utf-8"))["multi_axis"]
    settings["recordings"] = str((ROOT / settings["recordings"]).resolve())
    settings["seconds"] = seconds or settings["seconds"]
    every = read_realisations(settings["recordings"], settings["fs_hz"], settings["um_per_unit"])
    found: dict[str, Level] = {}
    for fold in folds:
        names = [one.name for one in every if one.name.endswith(f" {fold}") or level_of(one) == without]
        stage = fitted(output / f"{without or 'all'}_{fold}", settings, names)
        for level in by_amplitude(every):
            errors = errors_of(stage, level)
            into = found.setdefault(level_of(level[0]), Level())
            rms = [np.inf if e is None else float(np.sqrt(np.square(e).mean())) for e in errors]
            into.left_out.extend(
                (r, one.period[2]) for r, one in zip(rms, level, strict=True) if one.name in names
            )
            pairs = [(one, e) for one, e in zip(level, errors, strict=True) if e is not None]
            into.not_linear_um.append(not_linear(*zip(*pairs, strict=True)))
            last, noise = into.left_out[-1]
            log(f"fold {fold}, {level_of(level[0])}: {last:.4f} µm, of which noise {noise:.4f} µm")
    return found


def level_of(one: MultiAxisRecording) -> str:
    """The amplitude, of its name."""
    return one.name.split("_")[0]


def fitted(folder: Path, settings: dict[str, object], heldout: list[str]) -> MultiAxisStage:
    """By the config's recipe without these realisations; read where it has been fitted before."""
    if not (folder / "metrics.json").is_file():
        folder.parent.mkdir(parents=True, exist_ok=True)
        config = folder.with_suffix(".yaml")
        config.write_text(yaml.safe_dump({"multi_axis": {**settings, "heldout": heldout}}), encoding="utf-8")
        command = ["-m", "train", "fit", "--config", str(config.resolve()), "--output", str(folder.resolve())]
        subprocess.run([sys.executable, *command], check=True, cwd=ROOT, stdout=subprocess.DEVNULL)
    return MultiAxisStage.load(folder / "stage.pt")


def errors_of(stage: MultiAxisStage, level: Sequence[MultiAxisRecording]) -> list[np.ndarray | None]:
    """Of the mean period of each, (samples, outputs), µm; None where the stage has no bounded answer."""
    each = [PeriodicFit(stage, periods([one])).errors() for one in level]
    return [None if one is None else one[0] for one in each]


def not_linear(level: Sequence[MultiAxisRecording], errors: Sequence[np.ndarray]) -> float:
    """The rms of what a linear correction of this amplitude leaves, µm."""
    u = np.stack([np.fft.rfft(one.period[0], axis=0)[1:-1] for one in level], 1)
    e = np.stack([np.fft.rfft(one, axis=0)[1:-1] for one in errors], 1)  # (lines, realisations, outputs)
    power = np.square(np.abs(u)).sum((1, 2))
    excited = power > 1e-4 * power.max()
    u, seen = u[excited], e[excited]
    left = seen - u @ (np.linalg.pinv(u) @ seen)
    free = 1 - u.shape[2] / len(level)
    square = np.square(np.abs(e[~excited])).sum() + np.square(np.abs(left)).sum() / free
    return float(np.sqrt(2 * square / (len(level) * e.shape[2] * len(errors[0]) ** 2)))


if __name__ == "__main__":
    main()
