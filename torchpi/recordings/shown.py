"""A recording in a notebook. What draws it stands above the recordings, and is loaded when asked for."""

from typing import TYPE_CHECKING, cast

if TYPE_CHECKING:
    from torchpi.recordings.recording import Recording
    from torchpi.report.notebook import Plot


class Shown:
    """What draws and shows itself as a recording does."""

    def plot(self) -> "Plot":
        """A figure: voltage and displacement over time, wrong readings marked, and the one over the other.

        A notebook shows it as the last line of a cell; `.savefig(path)` saves it, `.figure` is matplotlib's.
        """
        from torchpi.notebook.recorded import recording_plot

        return recording_plot(cast("Recording", self))

    def _repr_html_(self) -> str:
        from torchpi.notebook.recorded import recording_html

        return recording_html(cast("Recording", self))
