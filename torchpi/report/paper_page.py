"""The page of the whole paper: figures, the paper's numbers beside ours, and how open points were settled."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jinja2
import yaml
from markupsafe import Markup

from torchpi.files import write_text
from torchpi.report import words
from torchpi.report.linked import linked_markup
from torchpi.report.linked_traces import paper_traces
from torchpi.report.paper_figures import FIGURES, fast_trajectory
from torchpi.report.png import write_png
from torchpi.report.rendering import FOLDER, environment
from torchpi.report.svg import inline_svg
from torchpi.report.what_was_run import Provenance

if TYPE_CHECKING:
    from torchpi.paper.result import Row

TITLE = "The paper, reproduced and beaten"
TEXTS: dict[str, dict[str, Any]] = yaml.safe_load(
    (FOLDER / "templates" / "paper_texts.yaml").read_text(encoding="utf-8")
)
"""Texts of the page by section."""


@dataclass(frozen=True)
class Section:
    """One computed item of the reproduction."""

    name: str
    result: Any
    rows: Sequence["Row"]
    seconds: float


def write_paper_page(
    sections: Sequence[Section], missing: Sequence[str], provenance: Provenance, directory: str | Path
) -> Path:
    """Write `paper.html` into `directory`, and its figures as PNG into `figures/`; return the page's path.

    Args:
        sections: What was computed, in the order of the page.
        missing: Names of items that were not computed.
        provenance: What was run.
        directory: Folder to write into.
    """
    directory = Path(directory)
    html = paper_page(sections, missing, provenance, directory / "figures")
    page = directory / "paper.html"
    write_text(page, html)
    return page


def paper_page(
    sections: Sequence[Section],
    missing: Sequence[str],
    provenance: Provenance,
    figures: Path | None = None,
) -> str:
    """Return the page as text; if `figures` is given, also write the figures there as PNG."""
    asked = [row for section in sections for row in section.rows if row.met is not None]
    return (
        _environment()
        .get_template("paper.html.j2")
        .render(
            title=TITLE,
            provenance=provenance,
            answer=_answer(sections, asked),
            lead=_lead(sections),
            headlines=_headlines(sections),
            asked=asked,
            missing=missing,
            sections=[_section(section, figures) for section in sections],
        )
    )


@dataclass(frozen=True)
class _Line:
    label: str
    values: Sequence[float | str | None]
    ours: bool = False


@dataclass(frozen=True)
class _Table:
    caption: str
    columns: Sequence[str]
    rows: Sequence[_Line]


@dataclass(frozen=True)
class _Extra:
    """Content of a section besides figures and rows."""

    verdict: str = ""
    tables: Sequence[_Table] = ()
    paragraphs: Sequence[str] = ()
    says: str = ""


def _section(section: Section, figures: Path | None) -> dict[str, Any]:
    text = TEXTS[section.name]
    extra = _EXTRAS.get(section.name, lambda result: _Extra())(section.result)
    drawn = []
    for number, (draw, caption) in enumerate(FIGURES.get(section.name, ()), start=1):
        figure = draw(section.result)
        if figures is not None:
            write_png(figure, figures / f"{draw.__name__}.png")
        drawn.append(
            {"svg": Markup(inline_svg(figure, f"{section.name}-{number}", caption)), "caption": caption}
        )
    return {
        "name": section.name,
        "title": text["title"],
        "says": extra.says or text.get("says", ""),
        "verdict": extra.verdict,
        "figures": drawn,
        "rows": section.rows,
        "tables": extra.tables,
        "paragraphs": [*text.get("explains", ()), *extra.paragraphs],
        "settled": text.get("settled", ()),
        "seconds": section.seconds,
    }


def _answer(sections: Sequence[Section], asked: Sequence["Row"]) -> tuple[str, str] | None:
    """Return the number that was asked for and its description; None if nothing was asked for."""
    for section in sections:
        if section.name == "fig12":
            tracked = section.result.panels["fast"].tracked
            paper, ours = (words.figure(tracked[of].error.max_percent, 2) for of in ("paper", "torchpi"))
            return (
                f"{paper} % → {ours} %",
                "largest tracking error on the paper's fast trajectory, of its peak to peak, "
                "with the paper's method and with torchpi",
            )
    if asked:
        met = sum(bool(row.met) for row in asked)
        return f"{met} of {len(asked)}", "required values are reached"
    return None


def _lead(sections: Sequence[Section]) -> dict[str, Any] | None:
    """Return the picture at the top of the page: the fast trajectory of Fig. 12, if it was computed."""
    for section in sections:
        if section.name == "fig12":
            caption = "The fast trajectory of Fig. 12, with the paper's method and with torchpi."
            still = Markup(inline_svg(fast_trajectory(section.result), "lead", caption))
            panel = section.result.panels["fast"]
            motions = {name: tracked.y for name, tracked in panel.tracked.items()}
            traces = paper_traces(panel.t, panel.yd, motions["paper"], motions["torchpi"])
            return {"svg": linked_markup([traces], still), "caption": caption}
    return None


def _headlines(sections: Sequence[Section]) -> list[str]:
    """Return the outcome in a sentence or two, for the sections that were computed."""
    results = {section.name: section.result for section in sections}
    lines = []
    if "fig12" in results:
        panels = results["fig12"].panels
        paper, ours = (
            [panels[name].tracked[method].error for name in ("slow", "fast")]
            for method in ("paper", "torchpi")
        )
        better = min(a.max_um / b.max_um for a, b in zip(paper, ours, strict=True))
        lines.append(
            f"torchpi tracks the paper's slow trajectory to {words.figure(ours[0].max_percent, 2)} % and "
            f"its fast one to {words.figure(ours[1].max_percent, 2)} % of peak to peak at most, initial "
            f"loading included, where the paper's method reaches {words.figure(paper[0].max_percent, 2)} % "
            f"and {words.figure(paper[1].max_percent, 2)} %: {words.times(better)} or more."
        )
    if "fig8" in results:
        result = results["fig8"]
        worst = list(result.indirect)[-1]
        indirect, direct = result.indirect[worst].max_percent, result.direct[worst].max_percent
        lines.append(
            f"On the plant of Fig. 7 at {worst} Hz, one direct compensator has an error of "
            f"{words.figure(direct, 2)} %, the indirect approach one of {words.figure(indirect, 3)} %."
        )
    return lines


def _claim(result: Any) -> _Extra:
    claim = result.claim
    columns = list(next(iter(claim.variants.values())))
    return _Extra(
        verdict=("Holds here. " if claim.holds else "Does not hold here. ") + claim.found,
        says=claim.statement,
        tables=[
            _Table(
                "Each is fitted to recordings of the stage; a multisine of 1 … 80 Hz is held out."
                if "held out, rms V" in columns
                else "Steady state, true displacement.",
                ["", *columns],
                [
                    _Line(name, [variant[column] for column in columns])
                    for name, variant in claim.variants.items()
                ],
            )
        ],
    )


def _calibration(result: Any) -> _Extra:
    keys = ("model", "slow", "fast")
    lines = [_Line("the whole stage", [*[result.max_um[key] for key in keys], None, None, None], ours=True)]
    lines += [
        _Line(
            f"without {part}",
            [*[max_um[key] for key in keys], *[result.max_um[key] - max_um[key] for key in keys]],
        )
        for part, max_um in result.shares.items()
    ]
    return _Extra(
        tables=[
            _Table(
                "What each part of the stage adds to the largest error of the paper's method, µm: the "
                "error on the whole stage minus that without the part. Where parts compensate for each "
                "other, a share is negative.",
                ["", *keys, *[f"share of {key}" for key in keys]],
                lines,
            )
        ]
    )


def _table1(result: Any) -> _Extra:
    numbered = range(1, len(result.k) + 1)
    return _Extra(
        tables=[
            _Table(
                "Table I, on this stage.",
                ["", *[str(i) for i in numbered]],
                [
                    _Line("k (10⁻³ V/µm per µm/s)", [1e3 * value for value in result.k]),
                    _Line("b (V/µm)", list(result.b)),
                ],
            )
        ]
    )


def _methods(result: Any) -> _Extra:
    from torchpi.paper.methods import LABELS

    hz = list(next(iter(result.fig7.values())))
    columns = ["", *[f"{one}\N{NO-BREAK SPACE}Hz" for one in hz], "eq. 15, max", "rms", "eq. 16, max", "rms"]
    columns += [f"{head}, {result.preview} ahead" for head in ("eq. 15, max", "eq. 16, max")]

    def line(name: str) -> _Line:
        values: list[float | None] = [result.fig7.get(name, {}).get(one) for one in hz]
        of = result.stage.get(name)
        for trajectory in ("slow", "fast"):
            error = of[trajectory] if of else None
            values += [error.max_percent, error.rms_percent] if error else [None, None]
        of = result.ahead.get(name)
        values += [of[trajectory].max_percent if of else None for trajectory in ("slow", "fast")]
        return _Line(LABELS[name], values, ours=name == "torchpi")

    return _Extra(
        tables=[
            _Table(
                "Largest error in %: of 9 µm on the plant of Fig. 7 (steady state), of the trajectory's peak "
                "to peak on the stage (initial loading included).",
                columns,
                [line(name) for name in LABELS],
            )
        ],
        paragraphs=[f"Al Janaideh and Krejčí on eq. 16: {result.dilation}."],
    )


def _fig13(result: Any) -> _Extra:
    lines = [
        _Line(
            f"{hz} Hz",
            [
                before.width_percent,
                result.after[hz].width_percent,
                before.nonlinearity_percent,
                result.after[hz].nonlinearity_percent,
                before.max_percent,
                result.after[hz].max_percent,
            ],
        )
        for hz, before in result.before.items()
    ]
    columns = [
        f"{what}, {when}" for what in ("width", "nonlinearity", "max error") for when in ("before", "after")
    ]
    return _Extra(
        tables=[_Table("% of the range of 6 µm, sines over 1 … 7 µm, steady state.", ["", *columns], lines)]
    )


def _ablation(result: Any) -> _Extra:
    table = result.table
    heads = {"slow_max": "eq. 15, max", "slow_rms": "rms", "fast_max": "eq. 16, max", "fast_rms": "rms"}
    stage_lines = [
        _Line(
            variant,
            [
                f"{_shown(spreads[key].mean)} ± {_shown((spreads[key].most - spreads[key].least) / 2)}"
                for key in heads
            ],
            ours=variant.endswith(": torchpi"),
        )
        for variant, spreads in table.stage.items()
    ]
    tables = [
        _Table(
            "Tracking error on the stage, % of peak to peak, initial loading included: mean and half the "
            f"range over {table.seeds} sets of recordings, with other phases and other noise.",
            ["", *heads.values()],
            stage_lines,
        )
    ]
    if table.fig7:
        hz = list(next(iter(table.fig7.values())))
        tables.append(
            _Table(
                "Largest error on the plant of Fig. 7, % of 9 µm, by number of correction passes.",
                ["", *[f"{one} Hz" for one in hz]],
                [_Line(f"{passes} passes", list(row.values())) for passes, row in table.fig7.items()],
            )
        )
    return _Extra(tables=tables)


_EXTRAS = {
    "ablation": _ablation,
    "calibration": _calibration,
    "table1": _table1,
    "methods": _methods,
    "fig13": _fig13,
    **{name: _claim for name in ("polynomial", "jointly", "two_sets", "multisine", "above_80hz")},
}


def _shown(value: float) -> str:
    """Format to three digits; small and large values with an exponent, counts as whole numbers."""
    if isinstance(value, int):
        return f"{value:,}".replace("-", "−")
    if value != 0 and (abs(value) < 1e-3 or abs(value) >= 1e6):
        return f"{value:.2e}".replace("-", "−")
    return words.figure(float(f"{value:.3g}"))


def _plainly(value: float) -> str:
    """Format a target as it was stated: 0.5, 20."""
    return f"{value:g}"


def _time(seconds: float) -> str:
    return "less than 0.1 s" if seconds < 0.1 else f"{seconds:.1f} s"


def _signed(value: float) -> str:
    return ("+" if value > 0 else "") + _shown(value)


def _signed_percent(value: float) -> str:
    return f"{'+' if value > 0 else ''}{words.figure(value, 2)} %"


def _environment() -> jinja2.Environment:
    return environment(
        shown=_shown,
        minus=lambda text: text.replace("-0", "−0"),
        plainly=_plainly,
        time=_time,
        signed=_signed,
        signed_percent=_signed_percent,
    )
