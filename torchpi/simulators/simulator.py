"""Black-box simulations: a call maps the voltage of a whole record to its displacement."""

import inspect
import pickle
from collections import OrderedDict
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from hashlib import sha256
from pathlib import Path
from threading import RLock
from uuid import uuid4

import numpy as np

from torchpi.errors import SimulationError

Simulate = Callable[[np.ndarray, float], np.ndarray]
"""simulate(u_v, fs_hz) → y_um: (time,) V, held between samples, and Hz in; (time,) µm out, from the
de-energised state. The same voltage always gives the same displacement, without noise."""

KEPT_BYTES = 300_000_000
"""Most bytes of outputs that each process keeps, because a call may take seconds."""

_outputs: OrderedDict[tuple[str, bytes, float], np.ndarray] = OrderedDict()
_one_at_a_time = RLock()


@dataclass(frozen=True, eq=False)
class Simulator:
    """A user's simulation. Calling it checks the output, and reuses the outputs of earlier calls.

    Args:
        function: See `Simulate`.
        reference: How it is named in files and messages, such as `package.module:function`.

    Raises:
        SimulationError: When called: it fails, its output has another shape or is not finite, or a second
            call returns a different output.

    Example:
        >>> import numpy as np
        >>> from torchpi.simulators import Simulator
        >>> linear = Simulator(lambda u_v, fs_hz: 0.8 * u_v, "a straight line")
        >>> linear(np.array([0.0, 5.0]), fs_hz=1e4).tolist()
        [0.0, 4.0]
    """

    function: Simulate
    reference: str
    token: str = field(default_factory=lambda: uuid4().hex)
    """Distinguishes it from other simulations, in any process."""

    @classmethod
    def of(cls, function: Simulate) -> "Simulator":
        """Wrap any function, named by its module and its own name."""
        kind = type(function)
        name = getattr(function, "__qualname__", kind.__qualname__)
        return cls(function, f"{getattr(function, '__module__', None) or kind.__module__}:{name}")

    def __call__(
        self,
        u_v: np.ndarray,  # (time,), V
        fs_hz: float,
    ) -> np.ndarray:  # (time,), µm
        """Return the displacement; outputs of earlier calls are kept.

        Raises:
            SimulationError: The call fails, or returns another shape or numbers that are not finite.
        """
        key = self.token, sha256(u_v.tobytes()).digest(), fs_hz
        with _one_at_a_time:
            y = _outputs.get(key)
            if y is None:
                y = self.called(u_v, fs_hz)
                while _outputs and sum(one.nbytes for one in _outputs.values()) + y.nbytes > KEPT_BYTES:
                    _outputs.popitem(last=False)
                _outputs[key] = y
            _outputs.move_to_end(key)
        return y

    def called(
        self,
        u_v: np.ndarray,  # (time,), V
        fs_hz: float,
    ) -> np.ndarray:  # (time,), µm
        """Call the function, even if an output is kept, and check what it returns."""
        where = f"simulation {self.reference}"
        try:
            returned = self.function(u_v.copy(), fs_hz)
            y = np.array(returned, dtype=np.float64)
        except SimulationError:
            raise
        except Exception as error:  # a user's function may raise anything
            text = f"{type(error).__name__}: {error}".splitlines()[0]
            raise SimulationError(
                f"{where}: found {text}, with {len(u_v):,} samples at {fs_hz:g} Hz from {u_v.min():.4g} V to "
                f"{u_v.max():.4g} V; expected a displacement in µm"
            ) from error
        if y.shape != u_v.shape:
            raise SimulationError(f"{where}: found an output of shape {y.shape}, expected {u_v.shape}")
        if not np.isfinite(y).all():
            sample = int(np.flatnonzero(~np.isfinite(y))[0])
            raise SimulationError(f"{where}: found {y[sample]} at sample {sample}, expected finite numbers")
        y.flags.writeable = False
        return y

    def check_repeatable(
        self,
        u_v: np.ndarray,  # (time,), V
        fs_hz: float,
    ) -> None:
        """Raise `SimulationError` if a second call differs, because a fit compares calls."""
        first, second = self(u_v, fs_hz), self.called(u_v, fs_hz)
        if not np.array_equal(first, second):
            raise SimulationError(
                f"simulation {self.reference}: found outputs for the same voltage that differ by "
                f"{np.abs(second - first).max():.3g} µm, expected equal ones; start each call from rest, "
                "without noise"
            )

    @property
    def source(self) -> str:
        """The file that it comes from; empty if there is none."""
        path = getattr(self.function, "path", None)
        if path is None:
            with suppress(TypeError, OSError):  # functions that were not written in a file
                path = inspect.getsourcefile(self.function)
        return str(path) if path and Path(path).is_file() else ""

    @property
    def travels(self) -> bool:
        """Whether another process can call it too."""
        try:
            return b"__main__" not in pickle.dumps(self)  # `__main__` is another module there
        except Exception:  # objects that a function refers to may refuse in their own way
            return False
