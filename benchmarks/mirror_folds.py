"""Cross-validate the mirror: one fit per realisation, with that realisation of every amplitude left out.

    python benchmarks/mirror_folds.py [--output runs/mirror_folds] [--folds 1,2,3,4,5,6] [--without 200mV]
        [--seconds 540]

Prints the rms error of the left-out realisations (µm; infinite if the response is unbounded), which includes
the noise of their mean period, and that noise; then the median and the worst of each amplitude. `--without`
leaves all realisations of an amplitude out of every fit. *Not linear* is the part of the errors at an
amplitude that no linear correction removes: the residual of least squares on the three voltages at each
frequency, over the remaining degrees of freedom. For a left-out amplitude, *model-free* is the error of a
response whose dynamic stiffness is interpolated linearly over the root of the amplitude, as a resonance
shifts roughly in proportion to that root. A fold takes four to nine minutes on two idle cores; on one it
needs twice the `--seconds` of the config. A fold that has its `metrics.json` is not fitted again.
"""

import argparse
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from torchpi.identification.multi_axis.fit import PeriodicFit
from torchpi.identification.multi_axis.identify import by_amplitude, periods, response_of
from torchpi.recordings.multi_axis import MultiAxisRecording, read_realisations
from torchpi.stage.multi_axis import MultiAxisStage

ROOT = Path(__file__).parents[1]
CONFIG = ROOT / "configs" / "mirror.yaml"
MOVED_HZ = (2260, 2350)
"""Band in which two resonances do not shift with the amplitude as the others do."""
FOLDS = ("1", "2", "3", "4", "5", "6")


@dataclass(frozen=True)
class Level:
    """Errors of the stages of all folds at one amplitude.

    Attributes:
        left_out: The rms error of each left-out realisation and the noise in it, µm.
        not_linear_um: The rms error after a linear correction at this amplitude, µm, for each fold.
    """

    left_out: list[tuple[float, float]] = field(default_factory=list)
    not_linear_um: list[float] = field(default_factory=list)

    @property
    def median_um(self) -> float:
        """The median error."""
        return float(np.median([rms for rms, _ in self.left_out]))

    @property
    def worst(self) -> tuple[float, float]:
        """The largest error, and the noise in it."""
        return max(self.left_out)


@dataclass(frozen=True)
class Between:
    """Error of the response at one amplitude with its dynamic stiffness interpolated between its neighbours.

    Attributes:
        missed_um: The rms error, µm, with noise and the nonlinear part subtracted.
        share: Share of the squared error within `MOVED_HZ`, 0–1.
    """

    missed_um: float
    share: float

    @classmethod
    def of(cls, every: Sequence[MultiAxisRecording], name: str) -> "Between":
        """Evaluate it at the amplitude of this name."""
        levels = by_amplitude(every)
        at = [level_of(level[0]) for level in levels].index(name)
        hertz, missed = missed_between(*levels[at - 1 : at + 2])
        there = (hertz > MOVED_HZ[0]) & (hertz < MOVED_HZ[1])
        return cls(float(np.sqrt(missed.sum())), float(missed[there].sum() / missed.sum()))


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
    if options.without:
        found_between = Between.of(recorded(), options.without)
        low, high = MOVED_HZ
        print(
            f"model-free: {found_between.missed_um:.4f} µm, {found_between.share:.0%} from {low} to {high} Hz"
        )


def measured(
    output: Path,
    folds: Sequence[str] = FOLDS,
    without: str = "",
    seconds: float | None = None,
    log: Callable[[str], None] = lambda text: None,
) -> dict[str, Level]:
    """Fit every fold and return the levels by name, the lowest first."""
    settings = configured()
    settings["seconds"] = seconds or settings["seconds"]
    every = recorded()
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


def configured() -> dict[str, Any]:
    """Return the settings of the config, with an absolute path of the recordings."""
    settings: dict[str, Any] = yaml.safe_load(CONFIG.read_text(encoding="utf-8"))["multi_axis"]
    return {**settings, "recordings": str((ROOT / settings["recordings"]).resolve())}


def recorded() -> list[MultiAxisRecording]:
    """Read all realisations."""
    settings = configured()
    return read_realisations(settings["recordings"], settings["fs_hz"], settings["um_per_unit"])


def level_of(one: MultiAxisRecording) -> str:
    """Return the amplitude that the name of a realisation starts with."""
    return one.name.split("_")[0]


def fitted(folder: Path, settings: dict[str, object], heldout: list[str]) -> MultiAxisStage:
    """Fit by the config's recipe without these realisations, or read the stage if it was fitted before."""
    if not (folder / "metrics.json").is_file():
        folder.parent.mkdir(parents=True, exist_ok=True)
        config = folder.with_suffix(".yaml")
        config.write_text(yaml.safe_dump({"multi_axis": {**settings, "heldout": heldout}}), encoding="utf-8")
        command = ["-m", "train", "fit", "--config", str(config.resolve()), "--output", str(folder.resolve())]
        subprocess.run([sys.executable, *command], check=True, cwd=ROOT, stdout=subprocess.DEVNULL)
    return MultiAxisStage.load(folder / "stage.pt")


def errors_of(stage: MultiAxisStage, level: Sequence[MultiAxisRecording]) -> list[np.ndarray | None]:
    """Return the error of each mean period, (samples, outputs), µm; None where the response is unbounded."""
    each = [PeriodicFit(stage, periods([one])).errors() for one in level]
    return [None if one is None else one[0] for one in each]


def not_linear(level: Sequence[MultiAxisRecording], errors: Sequence[np.ndarray]) -> float:
    """Return the rms error that remains after a linear correction at this amplitude, µm."""
    u, e = spectra([one.period[0] for one in level]), spectra(errors)
    power = np.square(np.abs(u)).sum((1, 2))
    excited = power > 1e-4 * power.max()
    u, seen = u[excited], e[excited]
    left = seen - u @ (np.linalg.pinv(u) @ seen)
    free = 1 - u.shape[2] / len(level)
    square = np.square(np.abs(e[~excited])).sum() + np.square(np.abs(left)).sum() / free
    return float(np.sqrt(2 * square / (len(level) * e.shape[2] * len(errors[0]) ** 2)))


def missed_between(
    lower: Sequence[MultiAxisRecording],
    level: Sequence[MultiAxisRecording],
    upper: Sequence[MultiAxisRecording],
) -> tuple[np.ndarray, np.ndarray]:
    """Return the frequencies of the lines, Hz, and mean squared errors, µm²; noise makes some negative."""
    roots = [np.sqrt(np.mean([one.u.std() for one in each])) for each in (lower, level, upper)]
    share = (roots[1] - roots[0]) / (roots[2] - roots[0])
    (_, below), (z, response), (_, above) = map(response_of, (lower, level, upper))
    between = np.linalg.inv((1 - share) * np.linalg.inv(below) + share * np.linalg.inv(above))
    samples, lines = len(level[0].period[0]), np.angle(z) / (2 * np.pi)
    at = np.rint(samples * lines).astype(int) - 1
    u, y = spectra([one.period[0] for one in level])[at], spectra([one.period[1] for one in level])[at]
    rest = np.square(np.abs(y - u @ response)).sum((1, 2)) / (len(level) - u.shape[2])
    missed = np.square(np.abs(u @ (response - between))).sum((1, 2)) - u.shape[2] * rest
    return level[0].fs_hz * lines, 2 * missed / (len(level) * y.shape[2] * samples**2)


def spectra(signals: Sequence[np.ndarray]) -> np.ndarray:
    """Return the spectra, (lines, signals, channels), of signals of shape (samples, channels) each."""
    return np.stack([np.fft.rfft(one, axis=0)[1:-1] for one in signals], 1)


if __name__ == "__main__":
    main()
