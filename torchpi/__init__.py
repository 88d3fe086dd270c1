"""torchpi makes piezo stages go where they are told.

    recordings of voltage and displacement → a trained direct inverse → a control loop

Names are loaded when they are first used, so that `import torchpi` and `torchpi --help` stay quick.
"""

import importlib
from typing import TYPE_CHECKING, Any

from torchpi.files import provide_cache_folders

if TYPE_CHECKING:
    from torchpi.control.direct_inverse import DirectInverse as DirectInverse
    from torchpi.errors import TorchpiError as TorchpiError
    from torchpi.loop.loop import run_loop as run_loop
    from torchpi.notebook.compensator import Compensator as Compensator
    from torchpi.notebook.diagnosed import diagnose as diagnose
    from torchpi.operators import (
        PlayBank as PlayBank,
    )
    from torchpi.operators import (
        Polynomial as Polynomial,
    )
    from torchpi.operators import (
        PrandtlIshlinskii as PrandtlIshlinskii,
    )
    from torchpi.operators import (
        ReferenceFilter as ReferenceFilter,
    )
    from torchpi.operators.motion import Motion as Motion
    from torchpi.recordings.options import RecordingOptions as RecordingOptions
    from torchpi.recordings.recording import Recording as Recording
    from torchpi.recordings.recording import read_recording as read_recording
    from torchpi.recordings.recording import write_recording as write_recording
    from torchpi.stage import Stage as Stage

__version__ = "0.2.0"

provide_cache_folders()  # before Numba and Matplotlib are imported, which read once where they may write

_HOME = {
    "Compensator": "torchpi.notebook.compensator",
    "DirectInverse": "torchpi.control.direct_inverse",
    "Motion": "torchpi.operators.motion",
    "PlayBank": "torchpi.operators",
    "Polynomial": "torchpi.operators",
    "PrandtlIshlinskii": "torchpi.operators",
    "Recording": "torchpi.recordings.recording",
    "RecordingOptions": "torchpi.recordings.options",
    "ReferenceFilter": "torchpi.operators",
    "Stage": "torchpi.stage",
    "TorchpiError": "torchpi.errors",
    "diagnose": "torchpi.notebook.diagnosed",
    "read_recording": "torchpi.recordings.recording",
    "run_loop": "torchpi.loop",
    "write_recording": "torchpi.recordings.recording",
}

__all__ = [*_HOME, "__version__"]


def __getattr__(name: str) -> Any:
    if name in _HOME:
        return getattr(importlib.import_module(_HOME[name]), name)
    raise AttributeError(f"module 'torchpi' has no attribute '{name}'")


def __dir__() -> list[str]:
    return sorted(__all__)
