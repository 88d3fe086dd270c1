"""A simulation from outside torchpi: which effects can be tried around it, and what remains undecided."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from torchpi.diagnosis.records import Record
from torchpi.errors import RecordingError
from torchpi.recordings.options import SIMULATED_COLUMN
from torchpi.simulators import COLUMN, Simulator
from torchpi.stage.effects.effect import Described, Effect
from torchpi.stage.effects.inside import InsideEffect

Effects = Sequence[type[Effect] | type[InsideEffect]]


@dataclass(frozen=True, eq=False)
class Outside:
    """A simulation that is called with the voltage that drives it, or whose output is in the recordings."""

    simulator: Simulator | None
    """None if its output is recorded."""

    @property
    def reference(self) -> str:
        """Its name in `stage.pt`."""
        return self.simulator.reference if self.simulator else COLUMN

    @property
    def token(self) -> str:
        """An identifier that distinguishes it from other simulations, in any process."""
        return self.simulator.token if self.simulator else COLUMN

    @property
    def alignments(self) -> tuple[int, ...]:
        """By how many samples it may be late: many discrete simulations respond one sample later than the
        timing convention of the recordings says."""
        return (-1, 0, 1)

    def output(self, record: Record, before: int, v: np.ndarray) -> np.ndarray:
        """(time,), µm: the output for one recording, driven by v, (time,), V; a recorded output is that of
        `before` ticks earlier."""
        return self.simulator(v, record.fs_hz) if self.simulator else record.simulated[before]

    def precedes(self, effect: type[Described]) -> bool:
        """Whether an effect acts on the voltage that drives the simulation."""
        return effect.before_hysteresis and not effect.commutes

    def can_try(self, effect: type[Described]) -> bool:
        """Whether an effect can be tried before or behind the simulation, given what is known of it."""
        if self.simulator:
            return not issubclass(effect, InsideEffect)
        return not self.precedes(effect)

    @property
    def travels(self) -> bool:
        """Whether it can also be run in another process."""
        return self.simulator is None or self.simulator.travels

    def check(self, records: Sequence[Record]) -> None:
        """Raise `TorchpiError` for an output that is missing, not finite or not repeatable."""
        if self.simulator:
            shortest = min(records, key=lambda record: len(record.u))
            self.simulator.check_repeatable(shortest.u, shortest.fs_hz)
            return
        for record in records:
            if not record.simulated:
                raise RecordingError(
                    f"{record.name}: found no simulated output, expected a column {SIMULATED_COLUMN}"
                )
            y = record.simulated[0]
            if not np.isfinite(y).all():
                sample = int(np.flatnonzero(~np.isfinite(y))[0])
                raise RecordingError(
                    f"{record.name}: {SIMULATED_COLUMN}: found {y[sample]} at sample "
                    f"{sample}, expected finite numbers"
                )


def untried_note(simulation: Outside | None, untried: Effects) -> tuple[str, ...]:
    """Return a note on the effects that cannot be tried around a simulation, and on what would decide."""
    names = ", ".join(effect.name for effect in untried)
    if simulation is None or not names:
        return ()
    if simulation.simulator:
        return (
            f"Not tried: {names}. These effects act inside the hysteresis of the simulation, which can "
            "only be called as a whole; with a stage file they could be tried.",
        )
    return (
        f"Not tried: {names}. These effects act before the simulation, of which only the output is known; "
        "with a simulation that can be called they could be tried.",
    )
