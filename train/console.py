"""Output of a training run in the terminal."""

from collections.abc import Mapping, Sequence
from typing import Any

from rich.console import Console
from rich.table import Table

from torchpi.recordings.recording import Recording
from torchpi.report.words import METRICS

from .data import RecordingsData
from .module import InverseTraining
from .results import stage_notes
from .run_folder import RunFolder
from .tracking import tracking_notes

CONSOLE = Console(highlight=False, soft_wrap=True)


def show_data(data: RecordingsData, folder: RunFolder, warnings: Sequence[str]) -> None:
    """Print the training and held-out recordings, and warnings about them."""
    records = data.load()
    for warning in warnings:
        CONSOLE.print(f"torchpi: warning: {warning}", markup=False, style="yellow")
    CONSOLE.print(f"Training a direct inverse compensator into {folder.path}/", markup=False, style="bold")
    for recording in records.train:
        CONSOLE.print(f"  trained on  {_line(recording)}", markup=False)
    for recording in records.heldout:
        CONSOLE.print(f"  held out    {_line(recording)}", markup=False)
    if not records.heldout:
        CONSOLE.print("  held out    its last part", markup=False)


def show_start(model: InverseTraining) -> None:
    """Print the two-stage fit of the paper, from which training starts and which it must beat."""
    start = model.start
    errors = model.baseline_errors()
    CONSOLE.print(
        f"Two-stage least squares (eq. 10 on {start.slow}, eq. 11 on {', '.join(start.fast)}; "
        f"condition number {start.condition_number:.2g}): held out {errors.rms_v:.4g} V rms, "
        f"{errors.rms_um:.4g} µm rms",
        markup=False,
    )
    if model.selection:
        for step in model.selection.steps:
            CONSOLE.print(f"Cross-validation: {1e3 * step.rms_v:.4g} mV rms with {step.form}", markup=False)
    ahead = model.compensator.preview
    CONSOLE.print(f"Look-ahead: {ahead} samples, {1e3 * ahead * model.compensator.sample_period_s:.4g} ms")


def show_interrupted(folder: RunFolder) -> None:
    """Print how to continue an interrupted run."""
    if folder.last.is_file():
        CONSOLE.print(f"Continue with --output {folder.path} --ckpt_path last", markup=False)


def show_results(metrics: Mapping[str, Any], folder: RunFolder) -> None:
    """Print the table of errors and the paths of the files."""
    table = Table(box=None, pad_edge=False, header_style="bold")
    table.add_column("error of the voltage")
    for heading in ("rms V", "max V", "rms µm", "max µm", "rms %", "max %"):
        table.add_column(heading, justify="right")
    for key, label in METRICS.items():
        row = metrics[key]
        table.add_row(label, *(f"{row[name]:.3g}" for name in NAMES))
    CONSOLE.print(table)
    for note in (*tracking_notes(metrics), *stage_notes(metrics)):
        CONSOLE.print(note, markup=False)
    for text in metrics["how"]["on_bound"]:
        CONSOLE.print(f"Careful: {text}.", markup=False, style="yellow")
    if not metrics["how"]["monotone"]:
        CONSOLE.print(f"Careful: {metrics['how']['monotone_summary']}.", markup=False, style="yellow")
    for path, what in (
        (folder.compensator, "to deploy: TorchScript; the numbers alone are in compensator.json"),
        (folder.report, "the page with all figures"),
        (folder.metrics, "these numbers; % is relative to the recording's peak-to-peak value"),
        (folder.path, f"tensorboard --logdir {folder.path}"),
    ):
        CONSOLE.print(f"{path}  {what}", markup=False)


NAMES = ("rms_v", "max_v", "rms_um", "max_um", "rms_percent", "max_percent")


def _line(recording: Recording) -> str:
    u, y = recording.u, recording.y
    return (
        f"{recording.source or recording.name}: {len(u):,} samples at {recording.fs_hz:g} Hz, "
        f"{u.min():.3g} … {u.max():.3g} V, {y.min():.4g} … {y.max():.4g} µm"
    )
