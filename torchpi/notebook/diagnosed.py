"""`torchpi.diagnose`: a diagnosis of recordings in memory that draws and shows itself."""

from collections.abc import Sequence
from concurrent.futures import Executor

from torchpi.diagnosis import Diagnosis
from torchpi.diagnosis import diagnose as diagnosis_of
from torchpi.diagnosis.simulation import Simulation
from torchpi.errors import ConfigError, SimulationError, kind_of
from torchpi.notebook.given import given_recordings
from torchpi.recordings.recording import Recording
from torchpi.report.diagnosis_figures import diagnosis_figures
from torchpi.report.notebook import Plot, diagnosed_html
from torchpi.simulators import COLUMN
from torchpi.stage import Stage


class Diagnosed(Diagnosis):
    """What `torchpi.diagnose` gives: verdict, effects with parameters and alternatives, errors, fitted stage.

    The fields are those of `Diagnosis`.

    Example:
        >>> [effect.name for effect in found.effects] != []
        True
        >>> figure = found.plot("spectrum")
    """

    def plot(self, what: str = "heldout") -> Plot:
        """A figure by its name: heldout, loop, spectrum, errors, where, remains, next_excitation, ….

        A notebook shows it as the last line of a cell; `.savefig(path)` saves it, `.figure` is matplotlib's.

        Raises:
            ConfigError: Another name; the text lists all.
        """
        figures = diagnosis_figures(self)
        if what not in figures:
            raise ConfigError(f"what: found '{what}', expected one of {', '.join(figures)}")
        return Plot(figures[what], what.replace("_", " "))

    def __repr__(self) -> str:
        names = ", ".join(f"{effect.name} {effect.probability:.2f}" for effect in self.effects)
        return f"Diagnosed({self.verdict!r}, [{names}], held-out {self.augmented.heldout_rms_um:.3g} µm rms)"

    def _repr_html_(self) -> str:
        return diagnosed_html(self)


def diagnose(
    recordings: Recording | Sequence[Recording],
    simulation: Simulation | None = None,
    *,
    executor: Executor | None = None,
) -> Diagnosed:
    """Where a simulation and recordings differ, and what physics was left out of it. Takes a minute or more.

    Args:
        recordings: One or more of the same stage.
        simulation: What they are compared with: a `Stage`, a function simulate(u_v, fs_hz) -> y_um, or
            "column", the `simulated` of each recording. By default a plain stage: symmetric,
            rate-independent Prandtl–Ishlinskii hysteresis, everything else ideal.
        executor: Where independent fits run, such as a `concurrent.futures.ProcessPoolExecutor`; by default
            in this process.

    Raises:
        RecordingError: No recordings, or some that no diagnosis can be made of.
        SimulationError: A simulation that fails, or returns what is no displacement.
        ConfigError: An executor that takes no work.

    Example:
        >>> import torchpi
        >>> found = torchpi.diagnose(recordings[0])
        >>> found.verdict != "nothing_missing"
        True
        >>> figure = found.plot("errors")
    """
    if not (simulation is None or isinstance(simulation, str | Stage) or callable(simulation)):
        found = kind_of(simulation)
        raise SimulationError(f"simulation: found {found}, expected a stage, a function or '{COLUMN}'")
    if executor is not None and not hasattr(executor, "submit"):
        raise ConfigError(f"executor: found {kind_of(executor)}, expected a concurrent.futures.Executor")
    found = diagnosis_of(given_recordings(recordings), simulation, executor=executor)
    return Diagnosed(**vars(found))
