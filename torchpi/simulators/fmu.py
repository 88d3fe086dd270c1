"""A Functional Mock-up Unit for co-simulation (FMI 2 or 3), through `fmpy`.

    u(k) is held from t(k-1) to t(k); y(k) is the output at t(k)

which is the convention of the recordings: the first reading already responds to the first voltage.
"""

import importlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from torchpi.errors import SimulationError

INSTALL = "pip install 'torchpi[fmi]'"


@dataclass(frozen=True)
class Fmu:
    """An FMU with one input, V, and one output, µm."""

    path: str
    input: str
    output: str

    @classmethod
    def of(cls, path: str) -> "Fmu":
        """Read the description of an FMU file.

        Raises:
            SimulationError: No such file, no FMU for co-simulation, another number of inputs or outputs, or
                `fmpy` is not installed.
        """
        fmpy = _fmpy(path)
        if not Path(path).is_file():
            raise SimulationError(f"simulation {path}: no such file, expected an FMU")
        try:
            described = fmpy.read_model_description(path)
        except Exception as error:  # an archive or its XML may be wrong in any way
            text = f"{type(error).__name__}: {error}".splitlines()[0]
            raise SimulationError(f"simulation {path}: found {text}, expected an FMU") from error
        version = str(described.fmiVersion)
        if described.coSimulation is None or version[0] not in "23":
            kind = "model exchange" if described.coSimulation is None else "co-simulation"
            raise SimulationError(
                f"simulation {path}: found FMI {version} for {kind}, expected FMI 2 or 3 for co-simulation"
            )
        names: dict[str, list[str]] = {"input": [], "output": []}
        for variable in described.modelVariables:
            if variable.causality in names:
                names[variable.causality].append(variable.name)
        for causality, found in names.items():
            if len(found) != 1:
                listed = ", ".join(found) or "none"
                raise SimulationError(
                    f"simulation {path}: found {listed} as {causality}, expected one {causality}"
                )
        return cls(path, names["input"][0], names["output"][0])

    def __call__(self, u_v: np.ndarray, fs_hz: float) -> np.ndarray:
        """Simulate from the initial state of the FMU: (time,) V in, (time,) µm out."""
        fmpy, samples = _fmpy(self.path), len(u_v)
        held = np.empty(samples + 1, dtype=[("time", np.float64), (self.input, np.float64)])
        held["time"] = np.arange(samples + 1) / fs_hz
        held[self.input] = np.append(u_v, u_v[-1:])
        # A step ends where the next voltage begins, so its final output responds to its own voltage.
        result = fmpy.simulate_fmu(
            self.path,
            start_time=0.0,
            stop_time=samples / fs_hz,
            step_size=1 / fs_hz,
            output_interval=1 / fs_hz,
            input=held,
            output=[self.output],
            fmi_type="CoSimulation",
        )
        y: np.ndarray = np.asarray(result[self.output], dtype=np.float64)[1:]
        return y


def _fmpy(path: str) -> Any:
    try:
        return importlib.import_module("fmpy")
    except ImportError:
        raise SimulationError(
            f"simulation {path}: found no package fmpy, expected it installed; {INSTALL}"
        ) from None
