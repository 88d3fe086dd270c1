"""Display of a recording in a notebook; the drawing code, in a higher package, is imported on demand."""

from typing import TYPE_CHECKING, cast

if TYPE_CHECKING:
    from torchpi.recordings.recording import Recording
    from torchpi.report.notebook import Plot


class Shown:
    """Base of classes that a notebook plots and shows as a recording."""

    def plot(self) -> "Plot":
        """Plot voltage and displacement over time, with wrong readings marked, and displacement over voltage.

        A notebook shows it as the last line of a cell; `.savefig(path)` saves it, `.figure` is matplotlib's.
        """
        from torchpi.notebook.recorded import recording_plot

        return recording_plot(cast("Recording", self))

    def _repr_html_(self) -> str:
        from torchpi.notebook.recorded import recording_html

        return recording_html(cast("Recording", self))
