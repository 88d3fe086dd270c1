"""The comparison as a Markdown table, and as the page docs/peers.md."""

import platform
from collections.abc import Mapping, Sequence
from datetime import date
from importlib.metadata import PackageNotFoundError, version

from row import Row

HEADINGS = (
    "peer",
    "fit, s",
    "compile, s",
    "held-out rms, V (%)",
    "held-out max, V (%)",
    "step, µs",
)
PACKAGES = ("torch", "numba", "numpy", "jax-sysid", "jax", "dynonet", "sysidentpy")


# The peers that need no further package are measured by `make figures` as well.
FIGURES = {
    "torchpi, joint": "peers_joint_v",
    "torchpi, two stages": "peers_two_stage_v",
    "lstsq on play states": "peers_lstsq_v",
}


def table(rows: Sequence[Row], figures: Mapping[str, str] | None = None) -> str:
    """Return the table with one line per peer; a dash stands for what a peer does not have.

    Args:
        rows: Results of the peers.
        figures: Figure names by peer, for a comment behind the held-out rms error.
    """
    cells = [_cells(row, (figures or {}).get(row.peer.name)) for row in rows]
    lines = [HEADINGS, ("---",) + ("---:",) * (len(HEADINGS) - 1), *cells]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def page(rows: Sequence[Row], commit: str) -> str:
    """Return the page, with today's date and the commit."""
    return f"""# Peers side by side

Written by `python benchmarks/peers/compare.py --write`: do not edit.
Measured on {date.today().isoformat()} at commit {commit}, all in one run, on one core. Times drift with the
machine and its load; quote the ratios. Peers are installed by `pip install -r
benchmarks/peers/requirements.txt`, best in an environment of their own.

**The task.** A direct inverse: displacement, rate and acceleration in, voltage out. The recordings are of
the simulated stage of [`configs/stage/qin2013.yaml`](../configs/stage/qin2013.yaml), which is as hard as
the paper's rig (noise, converters, creep, delay and a 450 Hz mode are in). One record of 12,000 samples at
10 kHz is fitted, a random-phase multisine from 1 to 100 Hz over 0 to 10 V. Three others of 12,000 samples,
with other phases, judge: each is predicted whole, from the de-energised state, without the measured
voltage. Every peer is given the same motion, smoothed, two samples ahead.

{table(rows, FIGURES)}

Errors are of the held-out voltage; per cent is of its range, 10 V. *Fit* is without compilation, the median
where it is repeated, in seconds of the processor: on one idle core, what one waits. *Step* is the median
time of one streamed sample, called from Python. A dash: nothing is compiled, or the library does not run
sample by sample. JAX compiles again for every fit; torchpi's kernels are compiled once and kept on disk, the
same ones for both of its rows.

![Held-out error against the time to fit](peers.png)

*Filled: without compilation; the line ends where it is included. Both axes are logarithmic; low and left is
good.*

{_ratios(rows)}

## What was fitted, and what each is for

torchpi, jax-sysid and both PyTorch loops fit the same equations: a lead of second order, three creep
relaxations with fixed times, a polynomial of degree 4, 10 plays with fixed thresholds, and weights linear
in the rate. Settings of each peer are the best of some trials by hand, up to about a minute of fitting, on
records like these; the trials showed the held-out error as well.

{_settings(rows)}

Versions: {_versions()}.
"""


def _cells(row: Row, figure: str | None) -> tuple[str, ...]:
    comment = f"<!-- figure: {figure} -->" if figure else ""
    return (
        row.peer.name,
        _three_digits(row.fit_s),
        "–" if row.compile_s is None else _three_digits(row.compile_s),
        f"{row.rms_v:.4f}{comment} ({100 * row.rms_v / row.range_v:.2f})",
        f"{row.max_v:.3f} ({100 * row.max_v / row.range_v:.2f})",
        "–" if row.step_us is None else _three_digits(row.step_us),
    )


def _three_digits(value: float) -> str:
    return f"{value:,.0f}" if value >= 100 else f"{value:#.3g}".rstrip(".")


def _ratios(rows: Sequence[Row]) -> str:
    """How much longer the others take than the joint fit, and how much larger their error is."""
    joint = next((row for row in rows if row.peer.name == "torchpi, joint"), None)
    if joint is None:
        return ""
    lines = ["Against torchpi, joint:", ""]
    for row in rows:
        if row is not joint:
            lines.append(
                f"- {row.peer.name}: {_three_digits(row.fit_s / joint.fit_s)} × its time "
                f"({_three_digits(row.whole_s / joint.whole_s)} × with compilation), "
                f"{_three_digits(row.rms_v / joint.rms_v)} × its held-out rms error."
            )
    return "\n".join(lines)


def _settings(rows: Sequence[Row]) -> str:
    return "\n".join(
        f"- **{row.peer.name}.** {row.peer.settings} *Made for:* {row.peer.purpose}" for row in rows
    )


def _versions() -> str:
    found = [f"Python {platform.python_version()}"]
    for package in PACKAGES:
        try:
            found.append(f"{package} {version(package)}")
        except PackageNotFoundError:
            continue
    return ", ".join(found)
