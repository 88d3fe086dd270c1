"""Load a simulation from its reference: `package.module:function`, `file.py:function` or `model.fmu`."""

import importlib
import sys
from pathlib import Path
from typing import Final

from torchpi.errors import SimulationError
from torchpi.simulators.simulator import Simulator

COLUMN: Final = "column"
"""Used in place of a simulation whose output is in the recordings."""
EXPECTED = "expected a stage (file or name), model.fmu, package.module:function, file.py:function or column"


def load_simulator(reference: str) -> Simulator:
    """Load the simulation that a reference names: import its module, or load the FMU's binary.

    Modules are also looked for in the current folder.

    Args:
        reference: `file.py:function`, `package.module:function`, or the path of an `.fmu`.

    Raises:
        SimulationError: There is no such simulation, or it cannot be called.

    Example:
        >>> from pathlib import Path
        >>> import numpy as np
        >>> from torchpi.simulators import load_simulator
        >>> written = Path("linear.py").write_text("def simulate(u_v, fs_hz): return 0.8 * u_v")
        >>> load_simulator("linear.py:simulate")(np.array([0.0, 5.0]), fs_hz=1e4).tolist()
        [0.0, 4.0]
    """
    if Path(reference).suffix.lower() == ".fmu":
        from torchpi.simulators.fmu import Fmu

        return Simulator(Fmu.of(reference), reference)
    module, colon, name = reference.rpartition(":")
    if not colon or not module or not name:
        raise SimulationError(f"simulation: found '{reference}', {EXPECTED}")
    path = Path(module)
    folder = path.resolve().parent if path.suffix == ".py" else Path.cwd()
    if path.suffix == ".py" and not path.is_file():
        raise SimulationError(f"simulation {reference}: found no file '{module}', expected one with '{name}'")
    if str(folder) not in sys.path:
        sys.path.insert(0, str(folder))  # worker processes get the same path
    importlib.invalidate_caches()
    try:
        found: object = importlib.import_module(path.stem if path.suffix == ".py" else module)
    except Exception as error:  # a user's module may raise anything
        text = f"{type(error).__name__}: {error}".splitlines()[0]
        raise SimulationError(
            f"simulation {reference}: found {text}, expected a module that can be imported"
        ) from error
    for part in name.split("."):
        found = getattr(found, part, None)
    if not callable(found):
        raise SimulationError(
            f"simulation {reference}: found no function '{name}' in '{module}', expected {name}(u_v, fs_hz)"
        )
    return Simulator(found, reference)
