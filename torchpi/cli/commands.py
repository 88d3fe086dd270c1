"""The `torchpi` command. Each function is a command: its signature gives the options, its docstring the help.

Nothing heavy is imported at module level, so that `torchpi --help` responds at once.
"""

import os
import shlex
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from torchpi import __version__
from torchpi.cli import duration
from torchpi.cli.command_line import run_chosen, run_program
from torchpi.cli.train import parsers as parsers_of_train
from torchpi.cli.train import train_cli
from torchpi.cli.workers import THREADS
from torchpi.errors import ConfigError
from torchpi.recordings.options import RecordingOptions

DESCRIPTION = """Makes piezo stages go where they are told.

  1. torchpi simulate          records a simulated stage; or use recordings of your own
  2. torchpi train fit         trains a compensator on recordings
  3. torchpi export            exports it to a file for a controller
  4. torchpi run               tests that file in a control loop with a simulated stage

  torchpi commission           does all of this with your own recordings, and predicts the tracking error

  torchpi check                shows what recordings contain, and the options for reading them
  torchpi diagnose             names the physics that the simulation lacks, and models it
  torchpi predict              simulates the stage that a diagnosis identified
  torchpi excite               writes the voltages to play and record for a diagnosis

  torchpi reproduce            reproduces the paper (Qin et al. 2013) and compares torchpi's errors with its
"""
DEFAULT_STAGE = Path("default")
IN_ONE_THREAD = ("commission", "diagnose")
"""Commands with small matrices or parallel fits, where more threads would only wait for each other."""


def main() -> None:
    """Run the command given in `sys.argv`; the entry point."""
    if sys.argv[1:2] and sys.argv[1] in IN_ONE_THREAD:
        for name in THREADS:  # set here, because parsing already loads such a library
            os.environ.setdefault(name, "1")
    if sys.argv[1:2] == ["train"]:
        run_program(train, "torchpi")  # Lightning parses the rest
    below = {"train": parsers_of_train}
    run_program(lambda: run_chosen(COMMANDS, "torchpi", DESCRIPTION, __version__, below), "torchpi")


def simulate(
    excitation: str = "paper_multisine",
    stage: Path = DEFAULT_STAGE,
    output: Path = Path("recordings/simulated.csv"),
    duration_s: float | None = None,
    seed: int = 0,
    options: dict[str, Any] | None = None,
) -> None:
    """Record the simulated stage: play an excitation, write time_s,input_v,output_um.

    Example: torchpi simulate --excitation multisine --output recordings/m.csv --options '{high_hz: 100}'

    Args:
        excitation: sine_5hz (paper, stage 1), paper_multisine (eq. 13), multisine, triangles (with minor
            loops), stairs (up and down with holds), or hold.
        stage: Stage file (YAML, physical parameters with units); default or qin2013, which are built in; or a
            multi-axis stage.pt, where each input is driven by its own multisine.
        output: CSV to write.
        duration_s: Length of the recording, s; each excitation has its own default.
        seed: Seed of the sensor noise and of random phases.
        options: Further options of the excitation, such as {low_v: 1, high_v: 9}.
    """
    import torch

    from torchpi.excitation.signals import make_excitation
    from torchpi.recordings.recording import Recording, write_recording
    from torchpi.stage import Stage

    if stage.suffix == ".pt":
        from torchpi.cli.simulate_axes import simulate_axes

        simulate_axes(stage, excitation, output, duration_s, seed, options or {})
        return
    simulated = Stage.from_yaml(stage)
    t, u = make_excitation(excitation, simulated.sample_rate_hz, duration_s, seed, options or {})
    _, y = simulated.simulate(torch.from_numpy(u)[None], seed)
    recording = Recording(output.stem, t, u, y[0].detach().numpy(), simulated.sample_rate_hz)
    write_recording(output, recording)
    print(
        f"{output}: {excitation} on {stage}, {len(u):,} samples at {recording.fs_hz:g} Hz, "
        f"u {u.min():.2f} … {u.max():.2f} V, y {recording.y.min():.3f} … {recording.y.max():.3f} µm"
    )


def train() -> None:
    """Train a compensator on recordings, with Lightning: `torchpi train fit --help` lists the options.

    Example: torchpi train fit --config recorded --data.recordings '[slow.csv, fast.csv, other.csv]'
    """
    duration.announce_fit(sys.argv[2:])
    train_cli().fit(sys.argv[2:], "torchpi train")


def excite(
    output: Path = Path("excitations"),
    for_: str = "diagnosis",
    min_voltage_v: float = 0.0,
    max_voltage_v: float = 10.0,
    max_rate_v_s: float = 2000.0,
    sample_rate_hz: float = 10_000.0,
    high_hz: float = 200.0,
    seed: int = 0,
) -> None:
    """Write the voltages to play for a diagnosis, about a minute in total, with instructions.

    CSVs with columns time_s,input_v: a hold, a multisine at two amplitudes, stairs, triangles with minor
    loops, and the multisine again for ten minutes later. They begin and end at 0 V.

    Example: torchpi excite --for diagnosis --max_voltage_v 7.5 --high_hz 500 --output excitations

    Args:
        output: Folder for the files.
        for_: Purpose of the recordings; only diagnosis is supported.
        min_voltage_v: Lowest permissible voltage, V at the controller; 0 or less.
        max_voltage_v: Highest permissible voltage, V at the controller.
        max_rate_v_s: Largest rate of the voltage, V/s.
        sample_rate_hz: Rate at which the voltage is played and the displacement recorded.
        high_hz: Highest excited frequency. Above the first resonance, if the stage tolerates that, the
            recordings also show the mechanics.
        seed: Seed of the random phases.
    """
    from torchpi.excitation.files import INSTRUCTIONS, write_diagnostic_set
    from torchpi.excitation.limits import DriveLimits

    if for_ != "diagnosis":
        raise ConfigError(f"--for: found '{for_}', expected diagnosis, the only supported purpose")
    limits = DriveLimits(min_voltage_v, max_voltage_v, max_rate_v_s, sample_rate_hz, high_hz)
    print(write_diagnostic_set(output, limits, seed))
    print(f"\n{output / INSTRUCTIONS}: these instructions")


def export(
    run: Path,
    output: Path | None = None,
    to: str | None = None,
    reference_filter: bool = False,
    max_slew_v_s: float | None = None,
    capacitance_uf: float | None = None,
    amplifier_gain: float = 1.0,
    allow_backwards: bool = False,
    band_hz: float | None = None,
) -> None:
    """Export the compensator of a training run for a controller; either all files are written or none.

    The stage that the run identified is written beside it as NAME_stage.pt, for `torchpi run`. For a
    multi-axis stage, NAME is the inverse and NAME_forward the stage itself, as a step.

    Example: torchpi export runs/demo --to torchscript,c,json --output exports/demo

    Args:
        run: Run folder of `torchpi train fit`, or one of its checkpoints.
        output: Path without suffix; each format adds its own. By default exports/ and the name of the run.
        to: Formats, separated by commas: torchscript (.pt), c (.h, .c and _selftest.c, C99), fmu (FMI 3.0,
            co-simulation), pt2 (torch.export), json (the bare numbers with units), page (.html, the safety
            card, which json has as well). By default torchscript,json,page; for several axes
            torchscript,c,json, the only ones available.
        reference_filter: Include the paper's reference filter (eq. 14): `step` then takes y_r.
        max_slew_v_s: Limit the rate of the output voltage inside the step, V/s.
        capacitance_uf: Capacitance of the piezo, µF: the safety card then states the current.
        amplifier_gain: Voltage at the piezo per volt from the controller, to calculate the current.
        allow_backwards: Export even a compensator that somewhere in its trained range lowers the voltage to
            raise the stage.
        band_hz: For several axes only: highest frequency of the trajectories, Hz; by default a twentieth of
            the sample rate.
    """
    from torchpi.cli.axes import refuse
    from torchpi.cli.export_axes import export_axes
    from torchpi.control.trained import load_compensator, with_slew_limit
    from torchpi.errors import ArtifactError
    from torchpi.export import Load, made_files, safety_card, write_together
    from torchpi.export.formats import without_suffix
    from torchpi.operators import ReferenceFilter
    from torchpi.stage import Stage
    from torchpi.stage.beside import NAME, exported_stage
    from torchpi.stage.kinds import load_axes

    output = without_suffix(output or Path("exports") / run.resolve().name)
    names = None if to is None else [name.strip() for name in to.split(",")]
    if (axes := load_axes(run / NAME)) is not None:
        refuse(
            reference_filter=reference_filter or None,
            max_slew_v_s=max_slew_v_s,
            capacitance_uf=capacitance_uf,
            amplifier_gain=None if amplifier_gain == 1.0 else amplifier_gain,
            allow_backwards=allow_backwards or None,
        )
        print("\n".join(map(str, export_axes(axes, run, output, names, band_hz))))
        return
    if band_hz is not None:
        raise ConfigError(f"--band_hz: found {band_hz:g}, expected none for a stage of one axis")
    compensator = load_compensator(run)
    if max_slew_v_s is not None:
        compensator = with_slew_limit(compensator, max_slew_v_s)
    load = Load(capacitance_uf, amplifier_gain)
    card = safety_card(compensator, load)
    if card.monotone is False and not allow_backwards:
        raise ArtifactError(f"{run}: {card.monotone_summary}; or export it with --allow_backwards true")
    inside = ReferenceFilter(compensator.sample_period_s) if reference_filter else None
    files = made_files(compensator, output, names or ["torchscript", "json", "page"], inside, load)
    if (run / NAME).is_file():
        files[exported_stage(output)] = Stage.load(run / NAME).write
    write_together(files)
    signal = "y_r" if reference_filter else "y_d"
    print(
        f"step({signal} at t + {compensator.preview} samples, µm) -> V, "
        f"every {compensator.sample_period_s:g} s:"
    )
    if card.monotone is None:
        print(f"Careful: {card.monotone_summary}: it may run backwards; train it again.")
    for file in files:
        print(file)


def run(
    compensator: Path,
    stage: Path | None = None,
    trajectory: str | list[str] | None = None,
    output: Path | None = None,
    compare: dict[str, Path] | None = None,
    resample: bool = False,
    max_slew_v_s: float | None = None,
    seed: int | None = None,
) -> None:
    """Run an exported compensator in a control loop against a simulated stage, sample by sample.

    Reports the tracking error with and without compensation, where the voltage or its rate reaches a limit,
    and the computing time of a step relative to the sample period. Writes loop.html (a single page to send to
    a colleague) and loop.json.

    A multi-axis inverse (NAME.pt or NAME.json, with NAME_stage.pt beside it) is run from its JSON file. Only
    loop.json is written: errors and coupling between the axes, compared with the best linear inverse.

    Example: torchpi run exports/demo.pt --trajectory '[slow, fast]'

    Args:
        compensator: Exported TorchScript file.
        stage: Stage file (YAML), a stage.pt, or a name (default, qin2013). By default the stage identified
            from the recordings (NAME_stage.pt or stage.pt beside the compensator), else the built-in one.
        trajectory: slow (eq. 15, the default), fast (eq. 16), a CSV with columns time_s,yd_um, or a list of
            these. For several axes: random (the default), or a CSV with columns time_s,yd_1_um,yd_2_um,….
        output: Folder for the page; by default beside the compensator.
        compare: Other exported compensators by name, such as {two-stage: runs/demo/baseline.pt}.
        resample: Interpolate a trajectory file to the compensator's sample rate.
        max_slew_v_s: Slew-rate limit of your amplifier, V/s.
        seed: Seed of the sensor noise; by default that of the stage.
    """
    from torchpi.cli.axes import numbers_of_axes, refuse

    if (numbers := numbers_of_axes(compensator)) is not None:
        from torchpi.cli.run_axes import run_axes

        refuse(compare=compare, max_slew_v_s=max_slew_v_s, seed=seed)
        run_axes(numbers, stage, trajectory, output or compensator.with_suffix(""))
        return
    trajectory = trajectory or "slow"
    if compensator.is_file():  # otherwise an error follows at once
        duration.announce_run(trajectory, len(compare or {}))
    from torchpi.cli.run import run_files

    names = [trajectory] if isinstance(trajectory, str) else trajectory
    command = shlex.join(["torchpi", *sys.argv[1:]])
    run_files(compensator, stage, names, output, compare or {}, resample, max_slew_v_s, seed, command)


def commission(
    recordings: list[Path],
    output: Path = Path("commission"),
    max_slew_v_s: float | None = None,
    **reading: Any,
) -> None:
    """Make a tested compensator from recordings: check, fit, stage, loop, export, one page.

    The last recording is held out. Writes compensator.pt, .h, .c, .json and .html to deploy, stage.pt (your
    stage, identified from the same recordings), and commission.html: the tracking error without and with
    compensation, simulated on that stage, with the stage's own error beside it.

    Example: torchpi commission recordings/slow.csv recordings/fast.csv recordings/judge.csv --output mine

    Args:
        recordings: Two or more recordings of one stage at the sample rate of the control loop, each starting
            de-energised.
        output: Folder for the results.
        max_slew_v_s: Slew-rate limit of your amplifier, V/s: the page shows where it is reached.
        reading: How the files are read.
    """
    options = RecordingOptions(**reading)
    from torchpi.commission.commission import commission as commission_files

    command = shlex.join(["torchpi", *sys.argv[1:]])
    commission_files(recordings, output, options, command, max_slew_v_s)


def check(files: list[Path], output: Path = Path("check"), **reading: Any) -> None:
    """Show what recordings contain, what is wrong with them, and the commands to continue with.

    Columns with their units, range and first values; sample rate and jitter; holds, range, noise, sign of the
    gain, remanence at the start, wrong readings, clipping. Writes check.html, which adds a plot of each.

    Example: torchpi check recordings/slow.csv recordings/fast.csv

    Args:
        files: Recordings, in any format that the other commands read.
        output: Folder for the page.
        reading: How the files are read.
    """
    options = RecordingOptions(**reading)
    if all(file.is_file() for file in files):  # otherwise an error follows at once
        duration.announce_check(files)
    from torchpi.cli.check import check_files
    from torchpi.cli.check_axes import check_axes_files
    from torchpi.recordings.multi_axis import has_axes
    from torchpi.recordings.readers import open_source

    of_axes = files[0].is_file() and has_axes(open_source(files[0]))
    command = shlex.join(["torchpi", *sys.argv[1:]])
    if of_axes:
        check_axes_files(files, output, options, command)
    else:
        check_files(files, output, options, command)


def diagnose_(  # the parser looks names up in torchpi, and would load its `diagnose` with torch
    recordings: list[Path],
    output: Path = Path("diagnosis"),
    simulation: str | None = None,
    executor: str = "processes",
    seconds: float | None = None,
    **reading: Any,
) -> None:
    """Find where recordings and a simulation differ, name the missing physics, and show how the fit improves.

    Writes report.html (a single page to send to a colleague), diagnosis.json, stage.pt (the fitted stage, for
    `torchpi predict` and for training through it), next_excitation.csv (the voltage to record next, to decide
    what remains open) and the figures.

    Any simulation can be diagnosed: a stage (stage.yaml, stage.pt, or default by its name), an FMU with one
    input and one output (model.fmu), a function simulate(u_v, fs_hz) -> y_um (package.module:simulate, or
    file.py:simulate), or column: each recording then contains the simulator's response to its voltage, in a
    column simulated_um.

    Multi-axis recordings (time_s,input_1_v,…,output_1_um,…) are compared with a multi-axis stage.pt, or with
    a linear stage identified from them; the last realisation of each amplitude is held out.

    Example: torchpi diagnose recordings/a.csv recordings/b.csv --output diagnosis

    Args:
        recordings: Recordings of one stage: time_s,input_v,output_um[,aux_…].
        output: Folder for the results.
        simulation: What to compare with: stage.yaml, stage.pt, default, model.fmu, package.module:function,
            file.py:function, or column. By default a plain stage: symmetric, rate-independent
            Prandtl–Ishlinskii hysteresis, everything else ideal.
        executor: Where independent fits run: processes (worker processes), or here (this process).
        seconds: For several axes only: time for the final fit, s; 480 by default.
        reading: How the files are read.
    """
    options = RecordingOptions(**reading)
    from torchpi.recordings.multi_axis import has_axes
    from torchpi.recordings.readers import open_source

    command = shlex.join(["torchpi", *sys.argv[1:]])
    if recordings[0].is_file() and has_axes(open_source(recordings[0])):
        fit_s = duration.SEVERAL_AXES_S if seconds is None else seconds
        duration.announce_axes(recordings, fit_s)
        from torchpi.cli.diagnose_axes import diagnose_axes_files

        diagnose_axes_files(recordings, output, simulation, fit_s, command, options)
        return
    if seconds is not None:
        raise ConfigError(f"--seconds: found {seconds:g}, expected none for a stage of one axis")
    if all(file.is_file() for file in recordings):  # otherwise an error follows at once
        duration.announce_diagnose(recordings)
    from torchpi.cli.diagnose import diagnose_files

    diagnose_files(recordings, output, simulation, executor, command, options)


def predict(
    stage: Path,
    recording: Path,
    output: Path = Path("prediction.csv"),
    simulation: str | None = None,
    periodic: bool = False,
    **reading: Any,
) -> None:
    """Predict the response of a stage to a voltage: read time_s,input_v[,aux_…], write output_um with it.

    The prediction starts de-energised, at the file's own sample rate, without noise. A multi-axis stage takes
    input_1_v, input_2_v, … at its rate and gives output_1_um, output_2_um, …; an oscillator takes force_n.

    Example: torchpi predict runs/diagnosis/stage.pt voltage.csv --output predicted.csv

    Args:
        stage: The stage.pt of `torchpi diagnose`, a stage file (YAML), or a name (default, qin2013).
        recording: CSV, or any other format of recordings; a column output_um in it is ignored.
        output: CSV to write.
        simulation: The simulation that the stage corrects, if it was diagnosed with a function or an FMU:
            stage.pt only contains its name, and no code is loaded unless it is named here.
        periodic: Treat the file as one period of a periodic force and predict the steady state; for an
            oscillator only.
        reading: How the file is read.
    """
    options = RecordingOptions(**reading)
    from torchpi.cli.predict import predict_file

    predicted = predict_file(stage, recording, output, options, simulation, periodic)
    print(
        f"{output}: {len(predicted.y):,} samples at {predicted.fs_hz:g} Hz, "
        f"y {predicted.y.min():.3f} … {predicted.y.max():.3f} µm"
    )


def reproduce(
    output: Path = Path("exports/paper"),
    only: str | None = None,
    stage: Path = Path("qin2013"),
) -> None:
    """Reproduce every figure and claim of Qin et al. (2013) with the calibrated stage, in minutes.

    Writes paper.html, in the paper's order with its figures beside ours, and results.json. Every result is
    stored, so that an interrupted run continues where it stopped.

    Example: torchpi reproduce --only fig8,fig12

    Args:
        output: Folder for the page and the results.
        only: Names of figures and experiments, separated by commas; the error for an unknown one lists all.
        stage: Stage file (YAML) that represents the paper's rig, or a name (default, qin2013).
    """
    from torchpi.cli.reproduce import reproduce as run_paper

    page = run_paper(output, [name.strip() for name in only.split(",")] if only else None, stage)
    print(f"{page}: the page\n{output / 'results.json'}: the same numbers")


COMMANDS: list[Callable[..., None]] = [
    simulate, excite, train, export, run, commission, check, diagnose_, predict, reproduce
]  # fmt: skip
