"""`torchpi.diagnose`: a diagnosis of recordings in memory that displays and plots itself."""

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
    """Result of `torchpi.diagnose`: verdict, effects with parameters and alternatives, errors, fitted stage.

    The fields are those of `Diagnosis`.

    Example:
        >>> 3 * found.augmented.heldout_rms_um < found.retuned.heldout_rms_um
        True
        >>> figure = found.plot("spectrum")
    """

    def plot(self, what: str = "heldout") -> Plot:
        """Return a figure by its name: heldout, loop, spectrum, errors, where, remains, next_excitation, ….

        A notebook shows it as the last line of a cell; `.savefig(path)` saves it, `.figure` is matplotlib's.

        Raises:
            ConfigError: The name is unknown; the message lists all names.
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
    """Find where a simulation differs from recordings, and which physics it lacks; takes a minute or more.

    Args:
        recordings: One or more recordings of the same stage.
        simulation: Simulation to compare with: a `Stage`, a function simulate(u_v, fs_hz) -> y_um, or
            "column", the `simulated` of each recording. By default a plain stage: symmetric,
            rate-independent Prandtl–Ishlinskii hysteresis, everything else ideal.
        executor: Runs independent fits, such as a `concurrent.futures.ProcessPoolExecutor`; by default they
            run in this process.

    Raises:
        RecordingError: There are no recordings, or some that cannot be diagnosed.
        SimulationError: The simulation fails, or returns something other than a displacement.
        ConfigError: The executor accepts no work.

    Example:
        >>> from torchpi import Recording, Stage, diagnose
        >>> from torchpi.excitation.signals import make_excitation
        >>> rig = Stage.from_yaml("default").at_sample_rate(2000)  # in place of your own stage
        >>> t, u = make_excitation("multisine", rig.sample_rate_hz, 0.5, seed=1)
        >>> recording = Recording.from_arrays(t, u, rig.simulate(u[None])[1][0])
        >>> known = rig.to_dict()
        >>> known["effects"] = [one for one in known["effects"] if one["name"] != "creep"]
        >>> found = diagnose(recording, simulation=Stage.from_dict(known))
        >>> [effect.name for effect in found.effects]
        ['creep']
        >>> figure = found.plot("errors")
    """
    if not (simulation is None or isinstance(simulation, str | Stage) or callable(simulation)):
        found = kind_of(simulation)
        raise SimulationError(f"simulation: found {found}, expected a stage, a function or '{COLUMN}'")
    if executor is not None and not hasattr(executor, "submit"):
        raise ConfigError(f"executor: found {kind_of(executor)}, expected a concurrent.futures.Executor")
    found = diagnosis_of(given_recordings(recordings), simulation, executor=executor)
    return Diagnosed(**vars(found))
