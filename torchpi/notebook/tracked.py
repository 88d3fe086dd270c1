"""A tracked trajectory that displays and plots itself."""

from typing import Literal

from torchpi.errors import ConfigError
from torchpi.loop.result import LoopResult, Signal
from torchpi.report import loop_figures
from torchpi.report.notebook import Plot, tracked_html

FIGURES = {name: draw for name, draw in loop_figures.FIGURES.items() if name != "latency"}


class Tracked(LoopResult):
    """Result of `Compensator.track`: motions without and with compensation, their errors, and limits reached.

    The fields are those of `LoopResult`; each of `drives` has its voltage `u`, its motion `y_true` and its
    errors. The properties below give the most common results of the compensated drive.

    Example:
        >>> bool(result.rms_um < result.max_um)
        True
        >>> result.error_um.shape == result.u_v.shape
        True
        >>> figure = result.plot("linearity")
    """

    @property
    def u_v(self) -> Signal:
        """Applied voltage, (time,), V."""
        return self.compensated.u

    @property
    def y_um(self) -> Signal:
        """True displacement of the stage, (time,), µm."""
        return self.compensated.y_true

    @property
    def error_um(self) -> Signal:
        """True minus desired displacement, (time,), µm."""
        error: Signal = self.y_um - self.yd
        return error

    @property
    def rms_um(self) -> float:
        """RMS of the tracking error with compensation, µm."""
        return self.compensated.on_true.whole.rms_um

    @property
    def max_um(self) -> float:
        """Maximum of the tracking error with compensation, µm."""
        return self.compensated.on_true.whole.max_um

    def plot(self, what: Literal["trajectory", "linearity", "error", "voltage"] = "trajectory") -> Plot:
        """Plot the motion with its error, the motion over the reference, the error, or the voltage.

        A notebook shows it as the last line of a cell; `.savefig(path)` saves it, `.figure` is matplotlib's.

        Raises:
            ConfigError: The name is unknown.
        """
        if what not in FIGURES:
            raise ConfigError(f"what: found '{what}', expected one of {', '.join(FIGURES)}")
        return Plot(FIGURES[what](self), f"{what} of {self.title}")

    def __repr__(self) -> str:
        return (
            f"Tracked({self.title!r}, {len(self.yd):,} samples, error {self.rms_um:.3g} µm rms, "
            f"{self.without.on_true.whole.rms_um:.3g} µm without compensation)"
        )

    def _repr_html_(self) -> str:
        return tracked_html(self)
