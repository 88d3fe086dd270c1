"""Figures as PNG files."""

from pathlib import Path

from matplotlib.figure import Figure

from torchpi.files import write_atomically
from torchpi.report.style import drawing


def write_png(figure: Figure, path: str | Path, dots_per_inch: int = 150) -> None:
    """Write the figure as PNG, whole or not at all."""
    with write_atomically(path) as temporary, drawing():
        figure.savefig(temporary, dpi=dots_per_inch, metadata={"Software": None})
