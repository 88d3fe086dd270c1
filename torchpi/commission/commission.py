"""Make a tested compensator from recordings: check, fit, stage, loop, export, page.

The last recording is held out. Nothing is written until everything has been computed; then all files are put
in place together.
"""

import json
import math
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path

from rich.console import Console

from torchpi.commission.outcome import Outcome
from torchpi.control.direct_inverse import DirectInverse
from torchpi.control.trained import to_checkpoint
from torchpi.diagnosis.forward_stage import identify_stage
from torchpi.errors import RecordingError
from torchpi.export import made_files, write_together
from torchpi.export.formats import Files
from torchpi.export.torchscript import script, warm
from torchpi.files import check_output_folder, save_tensors
from torchpi.identification import InversePair, inverse_errors, inverse_pair
from torchpi.identification.pair import seen_ahead
from torchpi.identification.recipe import RECORDED, Recipe
from torchpi.identification.selection import Richest, Selection
from torchpi.loop import run_loop
from torchpi.loop.result import LoopResult
from torchpi.recordings.identity import check_one_rate, recordings_sha256
from torchpi.recordings.options import RecordingOptions
from torchpi.recordings.recording import Recording, read_recording
from torchpi.report import commission_page, provenance
from torchpi.stage import Stage

NAME = "compensator"
FORMATS = ("torchscript", "c", "json", "page")
MOST_LOOP_SAMPLES = 50_000
"""Maximum number of samples of the held-out motion, from its beginning, that are followed in the loop."""


def commission(
    paths: Sequence[Path],
    output: Path,
    options: RecordingOptions,
    command: str,
    max_slew_v_s: float | None = None,
    log: Callable[[str], None] = print,
) -> Outcome:
    """Make a compensator from recordings, identify the stage, and test the compensator on it.

    Args:
        paths: Two recordings or more, all at one sample rate; the last one is held out.
        output: Folder for the files.
        options: How the recordings are read.
        command: The command line as typed, for the page.
        max_slew_v_s: Highest rate of the voltage that the amplifier bears, V/s.
        log: Called with each line of the report, ten at most.

    Raises:
        RecordingError: A file is unusable, there are fewer than two, two are the same, or rates differ.
        ArtifactError: `output` cannot be a folder.
    """
    check_output_folder(output)
    recordings = read(paths, options)
    *train, heldout = recordings
    samples, looped = sum(map(len, train)), min(len(heldout), MOST_LOOP_SAMPLES)
    # Estimated seconds on two cores of 2020, printed as an order of magnitude.
    fit_s, stage_s = 3 + 1.5e-4 * min(samples, 200_000), 3 + 3e-4 * min(samples, 400_000)
    loop_s, files_s = 3 + 1.2e-4 * looped, 8.0
    log(
        f"check   {len(train)} recordings to train on, {samples:,} samples at {heldout.fs_hz:g} Hz; "
        f"held out: {heldout.source}; about {fit_s + stage_s + loop_s + files_s:.0f} s"
    )
    with _timed("inverse: its form by cross-validation", fit_s) as clock:
        pairs = [inverse_pair(recording, 0, None, options.skip_s) for recording in recordings]
        selection = selected(recordings, pairs)
        compensator = selection.compensator.requires_grad_(False)
        errors = inverse_errors(compensator, [seen_ahead(pairs[-1], compensator.preview)])
    log(
        f"fit     {selection.steps[-1].form}; held out {1e3 * errors.rms_v:.3g} mV rms, "
        f"{errors.rms_percent:.2g} % of the motion ({clock()})"
    )
    with _timed("stage: plays, then dynamics", stage_s) as clock:
        forward = identify_stage(train, heldout, skip_s=options.skip_s)
    log(f"stage   {commission_page.stage_sentence(forward.stage)} ({clock()})")
    with _timed("loop: the held-out motion on the stage", loop_s) as clock:
        loop = followed(compensator, forward.stage, heldout, pairs[-1], max_slew_v_s)
    outcome = Outcome(
        train, heldout, compensator, selection.steps, errors, forward, loop, looped / heldout.fs_hz
    )
    log(f"loop    {commission_page.headline(outcome)} ({clock()})")
    log(f"limits  {commission_page.limits_sentence(outcome)}")
    with _timed("files and page", files_s):
        files = made(outcome, output, command, options)
        write_together(files)
    deployable = ", ".join(path.name for path in files if path.stem.startswith(NAME))
    log(f"export  {output}: {deployable}")
    log(f"stage   {output / 'stage.pt'}: torchpi run {output / NAME}.pt uses it, for your own motions")
    log(f"page    {output / 'commission.html'}; the same numbers in commission.json")
    return outcome


def read(paths: Sequence[Path], options: RecordingOptions) -> list[Recording]:
    """Read the recordings whole: samples that are not counted set the state.

    Raises:
        RecordingError: As for `commission`.
    """
    recordings = [read_recording(path, options.with_changes(skip_s=0.0)) for path in paths]
    check_together(recordings)
    return recordings


def check_together(recordings: Sequence[Recording]) -> None:
    """Raise `RecordingError` unless a compensator can be made from all but the last, and judged on that."""
    if len(recordings) < 2:
        raise RecordingError(
            f"recordings: found {len(recordings)}, expected two or more: the last is held out for validation"
        )
    first_of: dict[str, str] = {}
    for recording in recordings:
        name = recording.source or recording.name
        first = first_of.setdefault(recordings_sha256([recording]), name)
        if first is not name:
            raise RecordingError(
                f"{name}: found the content of {first}, expected different recordings; leave one out"
            )
    check_one_rate(recordings)


def selected(
    recordings: Sequence[Recording],
    pairs: Sequence[InversePair],
    richest: Richest = RECORDED,
    min_voltage_v: float | None = None,  # by default the lowest that was recorded
    max_voltage_v: float | None = None,
) -> Selection:
    """Fit the inverse of the form that generalises best to all recordings but the last."""
    u = [recording.u for recording in recordings]
    recipe = Recipe(
        pairs[:-1],
        min_voltage_v=min(float(one.min()) for one in u) if min_voltage_v is None else min_voltage_v,
        max_voltage_v=max(float(one.max()) for one in u) if max_voltage_v is None else max_voltage_v,
        recordings_sha256=recordings_sha256(recordings[:-1]),
    )
    return recipe.select(lambda ahead: [seen_ahead(pair, ahead) for pair in pairs[:-1]], richest)


def followed(
    compensator: DirectInverse,
    stage: Stage,
    heldout: Recording,
    pair: InversePair,
    max_slew_v_s: float | None,
) -> LoopResult:
    """Follow the motion of the held-out recording, without its noise, on the stage."""
    deployed = script(compensator)
    warm(deployed)
    return run_loop(
        deployed,
        stage,
        pair.motion.yd[0, :MOST_LOOP_SAMPLES].numpy(),
        fs_hz=heldout.fs_hz,
        name=heldout.name,
        title=f"the motion of {heldout.name}",
        max_slew_v_s=math.inf if max_slew_v_s is None else max_slew_v_s,
    )


def made(outcome: Outcome, output: Path, command: str, options: RecordingOptions) -> Files:
    """Return everything that is to be written, by path."""
    recordings = {f"trained on: {r.source}": r.sha256 for r in outcome.train}
    recordings[f"held out: {outcome.heldout.source}"] = outcome.heldout.sha256
    run = replace(provenance(command, {}), files=recordings)
    numbers = {**outcome.as_json(), "run": run.as_json(), "skip_s": options.skip_s}
    text = json.dumps(numbers, indent=1, ensure_ascii=False, allow_nan=False) + "\n"
    html = commission_page.page(outcome, run)
    files = made_files(outcome.compensator, output / NAME, FORMATS)
    files[output / "stage.pt"] = outcome.stage.write
    files[output / "checkpoints" / "best.ckpt"] = partial(save_tensors, to_checkpoint(outcome.compensator))
    files[output / "commission.json"] = lambda path: path.write_text(text, encoding="utf-8")
    files[output / "commission.html"] = lambda path: path.write_text(html, encoding="utf-8")
    return files


@contextmanager
def _timed(what: str, about_s: float) -> Iterator[Callable[[], str]]:
    """Show the present task and its estimated duration; yield a function that formats the seconds taken."""
    start = time.perf_counter()
    with Console(stderr=True).status(f"{what}, about {about_s:.0f} s"):
        yield lambda: f"{time.perf_counter() - start:.0f} s"
