"""Compare the default recipe with its two baselines on held-out recordings.

    python benchmarks/recipe.py [--only piezo_stack,preisach] [--seeds 1] [--first_seed 1]
        [--output recipe.json]

The recipe is `configs/recorded.yaml`: the form of the inverse is selected by cross-validation over training
data. The baselines are the paper's two-stage least squares (eq. 10, 11), and least squares on plays of the
displacement with an offset. A ratio is the recipe's held-out rms in V over the smaller one of the baselines.

The recordings are, if `../shared/data` is available, the piezo stack, each axis of the steering mirror by
itself (without knowing the other two voltages) and the Bouc–Wen benchmark as a stage; and simulated stages of
four hysteresis families (those of the proof's published plant) with two samples of delay, creep, and a
sensor with noise of 0.05 % and a drift of about 0.1 % of the range, under three excitations: one sum of
two sines, evaluated on triangles; one sine, evaluated on a decaying one; a set of three records, evaluated
on others.
"""

import argparse
import json
import sys
import time
import warnings
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import torch
import yaml

from torchpi.errors import RecordingWarning
from torchpi.recordings.recording import Recording, read_recording
from train.data import RecordingsData, Records
from train.module import InverseTraining

sys.path.insert(0, str(Path(__file__).parent / "proof"))
from concealed.plant import blocks
from concealed.plant.hysteresis import draw_hysteresis

DATA = Path(__file__).parents[2] / "shared" / "data"
RECIPE = Path(__file__).parents[1] / "configs" / "recorded.yaml"
FAMILIES = ("pi", "generalised_play", "preisach", "bouc_wen")
FS_HZ, SAMPLES, SPAN_V, RANGE_UM = 1000.0, 12_000, 10.0, 20.0

Signal = np.ndarray


@dataclass(frozen=True)
class Row:
    """Held-out errors of one case, V rms, and the form that was selected."""

    case: str
    recipe_v: float
    two_stage_v: float
    plays_v: float
    ratio: float
    seconds: float
    form: str


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--only", default="", help="cases whose names contain one of these")
    parser.add_argument("--seeds", type=int, default=1, help="simulated stages of each family")
    parser.add_argument("--first_seed", type=int, default=1, help="seed of the first of them")
    parser.add_argument("--output", type=Path, help="write the rows as JSON too")
    options = parser.parse_args()
    torch.set_num_threads(1)
    wanted = [part for part in options.only.split(",") if part]
    rows = []
    print(f"{'case':34} {'recipe V':>9} {'two-stage':>9} {'plays':>9} {'ratio':>6} {'s':>5}  form")
    for name, make in cases(options.seeds, options.first_seed):
        if wanted and not any(part in name for part in wanted):
            continue
        row = run(name, make())
        rows.append(row)
        print(
            f"{row.case:34} {row.recipe_v:9.4g} {row.two_stage_v:9.4g} {row.plays_v:9.4g} "
            f"{row.ratio:6.2f} {row.seconds:5.1f}  {row.form}",
            flush=True,
        )
    ratios = [row.ratio for row in rows]
    print(f"ratio: median {np.median(ratios):.2f}, largest {max(ratios):.2f}, of {len(ratios)} cases")
    if options.output:
        options.output.write_text(json.dumps([asdict(row) for row in rows], indent=1) + "\n")


def run(name: str, data: RecordingsData) -> Row:
    """Train by the recipe on one case and return its errors."""
    settings = yaml.safe_load(RECIPE.read_text(encoding="utf-8"))["model"]
    start = time.perf_counter()
    model = InverseTraining(**settings)
    model.build(data)
    seconds = time.perf_counter() - start
    _, heldout = model.errors(model.split)
    two_stage, plays = (model.baseline_errors(one).rms_v for one in (model.baseline, model.plays_baseline))
    assert model.selection is not None
    return Row(
        name,
        heldout.rms_v,
        two_stage,
        plays,
        heldout.rms_v / min(two_stage, plays),
        seconds,
        str(model.selection.steps[-1].form),
    )


def cases(seeds: int, first: int = 1) -> Iterator[tuple[str, Callable[[], RecordingsData]]]:
    """Yield the name of each case and a function that makes its recordings."""
    if DATA.is_dir():
        yield "piezo_stack", piezo_stack
        for axis in range(3):
            yield f"steering_mirror, axis {axis + 1}", lambda axis=axis: steering_mirror(axis)
        yield "bouc_wen as a stage", bouc_wen
    for seed in range(first, first + seeds):
        for family in FAMILIES:
            for name, play in EXCITATIONS.items():
                yield (
                    f"{family}, {name}, seed {seed}",
                    lambda f=family, p=play, s=seed: simulated(f, p, s),
                )


def of_records(train: list[Recording], heldout: list[Recording], **options: object) -> RecordingsData:
    """Wrap recordings held in memory as training data."""
    data = RecordingsData(recordings=[record.name for record in train], **options)
    data.records = Records(train, heldout)
    return data


def piezo_stack() -> RecordingsData:
    """As in configs/piezo_stack.yaml: train on one sine, evaluate on growing and shrinking amplitudes."""
    read, folder = dict(input_column=1, output_column=5, fs_hz=200.0, zero="first"), DATA / "piezo_stack"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RecordingWarning)
        train, judge = (
            read_recording(folder / name, **read) for name in ("Model_Vi_Do.dat", "Test_Vi_Do_Di.dat")
        )
    return of_records([train], [judge], skip_s=1.0, evaluate_s=(56.0, 70.5), zero_s=(1.0, 15.0))


def steering_mirror(axis: int) -> RecordingsData:
    """Train on two realisations and evaluate on another, each of two periods."""
    file = np.load(DATA / "steering_mirror" / "train.npz")
    u, y = (file[f"{signal}_200mV_train"][:, axis].astype(float) for signal in "uy")
    made = [
        record(f"realisation {r + 1}", u[:, r].T.ravel(), 1e6 * y[:, r].T.ravel(), 6400.0) for r in (0, 1, 4)
    ]
    return of_records(made[:2], made[2:], skip_s=0.1)


def bouc_wen() -> RecordingsData:
    """Train on the first 32 s and evaluate on the rest; the force takes the place of the voltage."""
    import h5py

    with h5py.File(DATA / "bouc_wen" / "train.h5") as file:
        u, y = (file["multisine"][name][:].ravel() for name in "uy")
    halves = [record(name, u[part], 1e6 * y[part], 750.0) for name, part in PARTS.items()]
    return of_records(halves[:1], halves[1:], skip_s=0.5)


PARTS = {"first": slice(0, 24_000), "last": slice(24_000, None)}


def record(name: str, u: Signal, y: Signal, fs_hz: float) -> Recording:
    return Recording(name, np.arange(len(u)) / fs_hz, u, y, fs_hz, source=name, sha256=name)


def simulated(
    family: str, play: Callable[[np.random.Generator], tuple[list[Signal], list[Signal]]], seed: int
) -> RecordingsData:
    """Simulate a stage of this family under one excitation."""
    rng = np.random.default_rng([seed, FAMILIES.index(family)])
    hysteresis = draw_hysteresis(family, rng, SPAN_V, RANGE_UM)
    train, judge = play(np.random.default_rng([seed, 77]))
    made = []
    for i, u in enumerate([*train, *judge]):
        noise = np.random.default_rng([seed, i, 9])
        x = hysteresis.respond(np.concatenate([[0.0, 0.0], u[:-2]]))
        x = blocks.creep(x, np.array([0.01, 0.01]), np.array([0.1, 2.0]), 1 / FS_HZ)
        warming = noise.uniform(-1, 1) * (1 - np.exp(-np.linspace(0, 2, len(u))))
        walk = np.cumsum(noise.standard_normal(len(u))) / np.sqrt(len(u))
        sensor = 1e-3 * warming + 5e-4 * walk + 5e-4 * noise.standard_normal(len(u))
        made.append(record(f"{family} {i}", u, x + RANGE_UM * sensor, FS_HZ))
    return of_records(made[: len(train)], made[len(train) :], skip_s=0.2)


def two_sines(rng: np.random.Generator) -> tuple[list[Signal], list[Signal]]:
    """A sum of two sines; evaluated on triangles."""
    t = np.arange(SAMPLES) / FS_HZ
    wave = 1 - 0.7 * np.cos(2 * np.pi * t) - 0.3 * np.cos(2 * np.pi * 3.7 * t)
    return [np.clip(0.5 * SPAN_V * wave, 0.0, SPAN_V)], [_triangle(1.0, 0.95, SAMPLES), _minor_loops()]


def one_sine(rng: np.random.Generator) -> tuple[list[Signal], list[Signal]]:
    """One loop over the full range; evaluated on a decaying sine."""
    t = np.arange(SAMPLES) / FS_HZ
    return [0.5 * SPAN_V * (1 - np.cos(np.pi * t))], [_decaying()]


def three_records(rng: np.random.Generator) -> tuple[list[Signal], list[Signal]]:
    """A sine, a multisine, triangles with minor loops; evaluated on a decaying sine, another multisine."""
    [sine], [decaying] = one_sine(rng)
    return [sine, _multisine(rng), _minor_loops()], [decaying, _multisine(rng)]


EXCITATIONS = {"two sines": two_sines, "one sine": one_sine, "three records": three_records}


def _triangle(hz: float, share: float, samples: int) -> Signal:
    phase = (np.arange(samples) / FS_HZ * hz) % 1
    return share * SPAN_V * (1 - np.abs(2 * phase - 1))


def _minor_loops() -> Signal:
    quarter = SAMPLES // 4
    biased = 0.3 * SPAN_V + _triangle(2.1, 0.36, quarter)
    return np.concatenate(
        [_triangle(1.0, 1.0, quarter), _triangle(1.3, 0.6, quarter), biased, _triangle(2.7, 0.4, quarter)]
    )


def _decaying() -> Signal:
    t = np.arange(SAMPLES) / FS_HZ
    return 0.5 * SPAN_V * (1 - np.cos(3 * np.pi * t) * np.exp(-t / 5)) * (1 - np.exp(-t / 0.1))


def _multisine(rng: np.random.Generator) -> Signal:
    t = np.arange(SAMPLES) / FS_HZ
    hertz = (0.7, 1.9, 4.1, 7.7, 13.0, 21.0)
    wave = sum(np.cos(2 * np.pi * f * t + rng.uniform(0, 2 * np.pi)) / np.sqrt(f) for f in hertz)
    return SPAN_V * (0.5 + 0.48 * wave / np.abs(wave).max()) * (1 - np.exp(-t / 0.2))


if __name__ == "__main__":
    main()
