"""Self-contained HTML that a notebook shows for a compensator, a tracked trajectory and a diagnosis."""

import uuid
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from markupsafe import Markup
from matplotlib.figure import Figure

from torchpi.control.direct_inverse import DirectInverse
from torchpi.diagnosis.diagnosis import Diagnosis
from torchpi.diagnosis.say import percent, spoken, stated
from torchpi.errors import ConfigError
from torchpi.files import as_path, write_atomically
from torchpi.identification import InverseErrors
from torchpi.identification.selection import Form
from torchpi.loop.result import LoopResult
from torchpi.report import loop_figures, words
from torchpi.report.diagnosis_fit import errors_figure
from torchpi.report.diagnosis_words import headline, in_prose
from torchpi.report.style import drawing
from torchpi.report.svg import inline_svg
from torchpi.report.words import figure
from torchpi.stage import Stage


@dataclass(frozen=True)
class Plot:
    """A figure that a notebook shows with any matplotlib backend.

    Attributes:
        figure: The matplotlib figure, with its `axes`.
        describes: Description for readers who cannot see the figure.
    """

    figure: Figure
    describes: str

    def savefig(self, path: str | Path) -> None:
        """Write the figure, whole or not at all, in the format of the path's suffix: .png, .svg, .pdf.

        Raises:
            ArtifactError: The path cannot be written.
            ConfigError: The suffix is not supported.
        """
        known = self.figure.canvas.get_supported_filetypes()
        if as_path(path).suffix.removeprefix(".").lower() not in known:
            raise ConfigError(
                f"{path}: found '{Path(path).suffix}', expected one of .{', .'.join(sorted(known))}"
            )
        with write_atomically(path) as temporary, drawing():
            self.figure.savefig(temporary, dpi=150)

    def _repr_html_(self) -> str:
        # Unique identifiers, because a notebook is one page and may show the same figure twice.
        return inline_svg(self.figure, f"torchpi-{uuid.uuid4().hex[:8]}", self.describes)


def compensator_html(
    inverse: DirectInverse, form: Form | None, errors: InverseErrors | None, stage: Stage | None
) -> str:
    """Return a table of rate, look-ahead, limits, form, and errors on the held-out recording."""
    rows = [
        ("sample rate", f"{1 / inverse.sample_period_s:g} Hz"),
        ("look-ahead", f"{inverse.preview} samples"),
        ("voltage", f"{inverse.min_voltage_v:g} … {inverse.max_voltage_v:g} V"),
    ]
    if form is not None:
        rows.append(("form, by cross-validation", str(form)))
    if errors is not None:
        rows.append(
            (
                "held-out error",
                f"{figure(errors.rms_v)} V rms, {figure(errors.max_v)} V at most; "
                f"{figure(errors.rms_percent, 2)} % of the motion rms",
            )
        )
    if stage is not None and stage.identified is not None:
        rows.append(
            (
                "stage, identified",
                f"held-out error {figure(stage.identified.heldout_rms_um)} µm rms, "
                f"{figure(stage.identified.heldout_max_um)} µm at most",
            )
        )
    return str(Markup("<b>Compensator</b>") + _table((), rows))


def tracked_html(result: LoopResult) -> str:
    """Return the result in a sentence, the errors of every drive, and a figure of the motion."""
    rows = [
        (
            drive.label,
            *(figure(value) for value in (drive.on_true.whole.rms_um, drive.on_true.whole.max_um)),
            figure(drive.on_true.whole.rms_percent, 2),
        )
        for drive in result.drives.values()
    ]
    drawn = Markup(Plot(loop_figures.trajectory_figure(result), "motion and error over time")._repr_html_())
    sentences = [words.headline(result), *words.limits(result)]
    head = ("", "error rms, µm", "largest, µm", "rms, % of motion")
    return str(_paragraphs(sentences) + _table(head, rows) + drawn)


def diagnosed_html(diagnosis: Diagnosis) -> str:
    """Return the verdict, the named effects with their parameters, and the errors before and after."""
    rows = [
        (
            spoken(effect.name),
            percent(effect.probability),
            "; ".join(map(stated, effect.parameters)),
            ", ".join(spoken(name) for name in effect.alternatives) or "–",
        )
        for effect in diagnosis.effects
    ]
    head = ("missing", "probability", "parameters", "cannot be distinguished from")
    answer = Markup("<b>{}</b>").format(headline(diagnosis)) + _paragraphs([in_prose(diagnosis.says)])
    drawn = Markup(Plot(errors_figure(diagnosis), "held-out errors of three stages")._repr_html_())
    return str(answer + (_table(head, rows) if rows else "") + drawn)


def _paragraphs(sentences: Iterable[str]) -> Markup:
    return _joined("<p>{}</p>", sentences)


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> Markup:
    lines = [_joined("<th>{}</th>", head)] if head else []
    lines += [_joined("<td>{}</td>", row) for row in rows]
    return Markup("<table>{}</table>").format(_joined("<tr>{}</tr>", lines))


def _joined(pattern: str, parts: Iterable[str]) -> Markup:
    """Join the parts, each formatted by the pattern; text is escaped, Markup is not."""
    return Markup("").join(Markup(pattern).format(part) for part in parts)
