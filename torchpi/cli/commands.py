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

  1. torchpi simulate          records the simulated stage; or take recordings of your own
  2. torchpi train fit         trains a compensator on recordings
  3. torchpi export            makes a file of it for a controller
  4. torchpi run               tries that file in a control loop against the simulated stage

  torchpi commission           does all of that for recordings of yours, and predicts how well it will track

  torchpi check                shows what recordings hold, and the options to read them by
  torchpi diagnose             names the physics that the simulation lacks, and models it
  torchpi predict              simulates what a diagnosis left behind
  torchpi excite               writes the recordings' voltages that a diagnosis needs

  torchpi reproduce            runs the whole paper (Qin et al. 2013), with torchpi's errors beside its
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
        stage: Stage file (YAML, physical parameters with units), or default or qin2013, torchpi's own; or the
            stage.pt of several axes, whose inputs are each moved by a multisine of its own.
        output: CSV to write.
        duration_s: Length of the recording, s; each excitation has its own default.
        seed: Of the sensor's noise, and of random phases.
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
    """Write the voltages to record a stage with, about a minute in all, and what to do with them.

    CSVs with columns time_s,input_v: a hold, a multisine at two amplitudes, stairs, triangles with minor
    loops, and the multisine again for ten minutes later. They begin and end at 0 V.

    Example: torchpi excite --for diagnosis --max_voltage_v 7.5 --high_hz 500 --output excitations

    Args:
        output: Folder for the files.
        for_: What the recordings are for; diagnosis is the only purpose there is.
        min_voltage_v: Lowest voltage that the stage bears, V of the controller; 0 or less.
        max_voltage_v: Highest voltage, V.
        max_rate_v_s: Largest rate of the voltage, V/s.
        sample_rate_hz: Rate at which the voltage is played and the displacement recorded.
        high_hz: Highest frequency to drive. Above the first resonance it shows the mechanics, if the stage
            bears it.
        seed: Of random phases.
    """
    from torchpi.excitation.files import INSTRUCTIONS, write_diagnostic_set
    from torchpi.excitation.limits import DriveLimits

    if for_ != "diagnosis":
        raise ConfigError(f"--for is '{for_}', expected diagnosis, the only purpose there is so far")
    limits = DriveLimits(min_voltage_v, max_voltage_v, max_rate_v_s, sample_rate_hz, high_hz)
    print(write_diagnostic_set(output, limits, seed))
    print(f"\n{output / INSTRUCTIONS}: the same words")


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
    """Export the compensator of a training run, for a controller: all files, or none.

    The stage that the run identified goes with it, as NAME_stage.pt: `torchpi run` takes it. Of a stage of
    several axes the inverse is NAME, and the stage itself as a step NAME_forward.

    Example: torchpi export runs/demo --to torchscript,c,json --output exports/demo

    Args:
        run: Run folder of `torchpi train fit`, or one of its checkpoints.
        output: Path without suffix; the formats add theirs. By default exports/ and the name of the run.
        to: Formats, comma between: torchscript (.pt), c (.h, .c and _selftest.c, C99), fmu (FMI 3.0,
            co-simulation), pt2 (torch.export), json (the bare numbers with units), page (.html, the safety
            card, which json has as well). By default torchscript,json,page; of several axes
            torchscript,c,json, which are all there are.
        reference_filter: Put the paper's reference filter (eq. 14) inside: `step` then takes y_r.
        max_slew_v_s: Limit the rate of the output voltage inside the step, V/s.
        capacitance_uf: Of the piezo, µF: the safety card then has the current.
        amplifier_gain: Voltage at the piezo per volt of the controller, for the current.
        allow_backwards: Export a compensator that lowers the voltage to raise the stage somewhere in its
            trained range.
        band_hz: Of several axes: highest frequency of the trajectories, Hz; by default a twentieth of the
            sample rate.
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

    Reports the tracking error with and without compensation, where the voltage or its rate meets a limit, and
    the time of a step against the sample period; leaves loop.html (one page, to send to a colleague) and
    loop.json.

    An inverse of several axes (NAME.pt or NAME.json, NAME_stage.pt beside it) runs by its numbers, and
    leaves loop.json: errors, and how much each axis moves the others, beside the best linear inverse.

    Example: torchpi run exports/demo.pt --trajectory '[slow, fast]'

    Args:
        compensator: Exported TorchScript file.
        stage: Stage file (YAML), a stage.pt, or a name (default, qin2013). By default the one identified
            from the recordings, beside the compensator (NAME_stage.pt or stage.pt), else the built-in one.
        trajectory: slow (eq. 15, the default), fast (eq. 16), a CSV with columns time_s,yd_um, or a list of
            these. Of several axes: random (the default), or a CSV with columns time_s,yd_1_um,yd_2_um,….
        output: Folder for the page; by default beside the compensator.
        compare: Other exported compensators by name, such as {two-stage: runs/demo/baseline.pt}.
        resample: Interpolate a trajectory file to the compensator's sample rate.
        max_slew_v_s: Rate of the voltage that your amplifier bears, V/s.
        seed: Of the sensor's noise; the stage's own by default.
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
    """Go from recordings to a compensator that has been tried: check, fit, stage, loop, export, one page.

    The last recording is held out. Leaves compensator.pt, .h, .c, .json and .html to deploy, stage.pt (your
    stage, identified from the same recordings), and commission.html: the tracking error without and with
    compensation, simulated on that stage, with the stage's own error beside it.

    Example: torchpi commission recordings/slow.csv recordings/fast.csv recordings/judge.csv --output mine

    Args:
        recordings: Two or more of one stage, at the sample rate of the control loop, first sample
            de-energised.
        output: Folder for the results.
        max_slew_v_s: Rate of the voltage that your amplifier bears, V/s: the page shows where it is met.
        reading: How the files are read.
    """
    options = RecordingOptions(**reading)
    from torchpi.commission.commission import commission as commission_files

    command = shlex.join(["torchpi", *sys.argv[1:]])
    commission_files(recordings, output, options, command, max_slew_v_s)


def check(files: list[Path], output: Path = Path("check"), **reading: Any) -> None:
    """Show what recordings hold, what is wrong with them, and the commands to go on with.

    Columns with their units, range and first values; sample rate and jitter; holds, range, noise, sign of the
    gain, remanence at the start, wrong readings, clipping. Leaves check.html, the same with a plot of each.

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
    """Say where recordings and a simulation differ, what physics was left out, and show the fit improve.

    Leaves report.html (one page, to send to a colleague), diagnosis.json, stage.pt (the fitted stage, for
    `torchpi predict` and for training through it), next_excitation.csv (the recording that would decide what
    is open) and the figures.

    The simulation may be anyone's: a stage (stage.yaml, stage.pt, or default by its name), an FMU with one
    input and one output (model.fmu), a function simulate(u_v, fs_hz) -> y_um (package.module:simulate, or
    file.py:simulate), or column: what a simulator made of each recording's voltage stands in it as
    simulated_um.

    Recordings of several axes (time_s,input_1_v,…,output_1_um,…) are compared with the stage.pt of such a
    stage, or with a linear one made of them; the last realisation of each amplitude is held out.

    Example: torchpi diagnose recordings/a.csv recordings/b.csv --output diagnosis

    Args:
        recordings: Recordings of one stage: time_s,input_v,output_um[,aux_…].
        output: Folder for the results.
        simulation: What to compare with: stage.yaml, stage.pt, default, model.fmu, package.module:function,
            file.py:function, or column. Without it a plain stage: symmetric, rate-independent
            Prandtl–Ishlinskii hysteresis, everything else ideal.
        executor: Where independent fits run: processes, or here.
        seconds: Of several axes: time for the fit at the end, s; 480 by default.
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
    """Predict what a stage does with a voltage: time_s,input_v[,aux_…] in, the same with output_um out.

    From the de-energised state, at the file's own rate, without noise. A stage of several axes takes
    input_1_v, input_2_v, … at its own rate and gives output_1_um, output_2_um, …; an oscillator, force_n.

    Example: torchpi predict runs/diagnosis/stage.pt voltage.csv --output predicted.csv

    Args:
        stage: The stage.pt of `torchpi diagnose`, a stage file (YAML), or a name (default, qin2013).
        recording: CSV, or any other kind that a recording may have; an output_um in it is left out.
        output: CSV to write.
        simulation: What the stage corrects, where it was diagnosed with a function or an FMU: stage.pt only
            names it, and no code is loaded that is not named here.
        periodic: The file is one period of many before: predict the steady state; of an oscillator.
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
    """Run every figure and claim of Qin et al. (2013) against the calibrated stage, in minutes.

    Leaves paper.html, in the paper's order, its figures beside ours, and results.json. Every result is
    kept: an interrupted run goes on where it stopped.

    Example: torchpi reproduce --only fig8,fig12

    Args:
        output: Folder for the page and the results.
        only: Names of figures and experiments, comma between; an unknown one lists them all.
        stage: Stage file (YAML) that stands for the paper's rig, or a name (default, qin2013).
    """
    from torchpi.cli.reproduce import reproduce as run_paper

    page = run_paper(output, [name.strip() for name in only.split(",")] if only else None, stage)
    print(f"{page}: the page\n{output / 'results.json'}: the same numbers")


COMMANDS: list[Callable[..., None]] = [
    simulate, excite, train, export, run, commission, check, diagnose_, predict, reproduce
]  # fmt: skip
