"""Step a stage of several axes as a rig: voltages in, displacements out."""

from collections.abc import Sequence

import numpy as np

from torchpi.errors import StageError
from torchpi.stage.multi_axis.stage import MultiAxisStage


class MultiAxisStream:
    """A stage of several axes that runs by samples or windows, bit-identical to a run over the whole record.

    Args:
        stage: The stage that is stepped.

    Attributes:
        delay_samples: Delay of the displacements in samples.
    """

    def __init__(self, stage: MultiAxisStage) -> None:
        self.stage, self.delay_samples = stage, stage.delay_samples
        self.reset()

    def reset(self) -> None:
        """Return to rest."""
        self._inputs, self._state = self.stage.input_stream(), self.stage.initial_state(1)
        self._late = np.zeros((self.delay_samples, self.stage.inputs))
        self._to_come = self.delay_samples

    def step(self, u: Sequence[float]) -> list[float]:
        """Return displacements, µm, of `delay_samples` samples before these voltages, V; until then at rest.

        Raises:
            StageError: A wrong number of voltages, one that is not finite, or states that diverge.
        """
        return [float(y) for y in self.block(np.asarray(u, dtype=np.float64).reshape(1, -1))[0]]

    def block(self, u: np.ndarray) -> np.ndarray:
        """Return displacements, (time, outputs), µm, for voltages, (time, inputs), V, with the same delay.

        Raises:
            StageError: As for `step`; the state is unchanged unless it diverges.
        """
        if u.ndim != 2 or u.shape[1] != self.stage.inputs or not np.isfinite(u).all():
            raise StageError(
                f"voltages: found an array of shape {u.shape}, "
                f"expected finite numbers (time, {self.stage.inputs})"
            )
        known = np.concatenate([self._late, u])
        driven, self._late = known[: len(u)], known[len(u) :]
        driven = driven + self._inputs.advance(u)[:, :, 0]
        # The stage rests until the first sample, although the inputs' filters respond to it earlier.
        first = min(self._to_come, len(u))
        self._to_come -= first
        y = np.empty((1, len(u), self.stage.outputs))
        y[0, :first] = self.stage.offset()
        self.stage.advance(driven[None, first:], self._state, y[:, first:])
        y[0, first:] += self.stage.foreseen(known[first : len(u) + self.stage.shapes.ahead])
        return np.asarray(y[0])
