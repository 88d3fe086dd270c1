"""Several axes as C99: a header, a source, and a program that tests them on the target.

The templates hold the equations. Every sum runs in the order of the Python step, so the bits are the same.
"""

import textwrap
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np

import torchpi
from torchpi.control.multi_axis import MultiAxisInverse
from torchpi.export.c_source import check_name
from torchpi.export.templates import rendered
from torchpi.operators.modal_feedback import DIVERGED, SMALLEST_MEAN
from torchpi.operators.oversampled_inputs import FACTOR, low_pass_taps, taps_by_phase
from torchpi.stage.multi_axis import MultiAxisStage, MultiAxisStream

FLAGS = "-std=c99 -ffp-contract=off -fno-math-errno -O2"
RECORDED, EVERY = 160, 16
"""Number of rows of the self-test, and number of samples per row."""
BYTES = 8


def c_source(exported: MultiAxisStage | MultiAxisInverse, name: str) -> dict[str, str]:
    """Return NAME.h, NAME.c and NAME_selftest.c.

    Raises:
        ArtifactError: NAME cannot be used in C.
    """
    check_name(name)
    context = _context(exported, name)
    filters: dict[str, Callable[..., str]] = {
        "number": _number,
        "numbers": _numbers,
        "rows": _rows,
        "hexadecimal": _hexadecimal,
    }
    files = {f"{name}.h": "step.h.j2", f"{name}.c": "step.c.j2", f"{name}_selftest.c": "selftest.c.j2"}
    return {file: rendered(f"multi_axis/{one}", context, **filters) for file, one in files.items()}


def _context(exported: MultiAxisStage | MultiAxisInverse, name: str) -> dict[str, Any]:
    inverse = isinstance(exported, MultiAxisInverse)
    stage = exported.stage if isinstance(exported, MultiAxisInverse) else exported
    passes = exported.passes if isinstance(exported, MultiAxisInverse) else 0
    context: dict[str, Any] = {
        "name": name,
        "version": torchpi.__version__,
        "flags": FLAGS,
        "inverse": inverse,
        "passes": passes,
        "with_stage": passes > 0 or not inverse,
        **of_stage(stage),
    }
    m, p, delay = stage.inputs, stage.outputs, stage.delay_samples
    ends = ("u", "y") if not inverse else ("yd", "u")
    units = ("V", "um") if not inverse else ("um", "V")
    context |= dict(zip(("given", "taken", "given_unit", "taken_unit"), ends + units, strict=True))
    context |= {"takes": p if inverse else m, "gives": m if inverse else p}
    if isinstance(exported, MultiAxisInverse):
        context |= _of_inverse(exported)
        scale = np.minimum(exported.accepted_um, 1.0)
        contract = (
            f"yd has {p} desired displacements in um, {exported.preview} samples ahead of the {m} voltages u "
            "in V."
        )
        summary = "voltages for a piezo stage of several axes, without feedback."
        accepts = ", or further from 0 than ACCEPTED in the source,"
        doubles = m * (len(exported.first) + 1) * (passes + 1) + 2 * passes * m * context["wait"]
    else:
        scale = np.full(m, max(stage.input_thresholds_v, default=1.0))
        contract = f"y has {p} displacements in um, {delay} samples behind the {m} voltages u in V."
        summary, accepts, doubles = "a piezo stage of several axes, as it was identified.", "", 0
    taps = len(low_pass_taps())
    of_one_stage = m * (taps + FACTOR + taps // FACTOR + delay) + 2 * stage.shapes.modes
    doubles += of_one_stage * (passes if inverse else 1)
    return context | {
        "contract": "\n * ".join(textwrap.wrap(contract, 100)),
        "summary": summary,
        "accepts": accepts,
        "state_kib": max(1, round(doubles * BYTES / 1024)),
        "scale": scale,
        "every": EVERY,
        "recorded": recorded(exported, scale),
    }


def of_stage(stage: MultiAxisStage) -> dict[str, Any]:
    """Return the numbers of a stage by name: parameters, constants and inputs."""
    inputs, constants = stage.input_stream(), stage.thresholds_of_kernel()
    interpolation, decimation = taps_by_phase()
    arrays = stage.arrays()
    pairs = {"poles": 1, "drive": 1, "force": 1, "sensed": 2, "seen": 2}  # axis of (re, im)
    halves = {
        f"{name}_{part}": arrays[name].take(k, axis).T
        for name, axis in pairs.items()
        for k, part in enumerate(("re", "im"))
    }
    return {
        **arrays,
        **halves,
        "m": stage.inputs,
        "p": stage.outputs,
        "n": stage.shapes.elements,
        "modes": stage.shapes.modes,
        "functions": stage.shapes.functions,
        "delay": stage.delay_samples,
        "period_s": 1 / stage.sample_rate_hz,
        "factor": FACTOR,
        "blocks": decimation.shape[1],
        "interpolation": interpolation,
        "newest": low_pass_taps()[0],
        "decimation": decimation.tolist(),
        "diverged": repr(DIVERGED),
        "smallest_mean": repr(SMALLEST_MEAN),
        "of_inputs": inputs,
        "plays": len(inputs.thresholds),
        "widths": len(inputs.widths),
        "added": inputs.columns,
        "offset": stage.offset(),
        "of_elements": constants,
        "zones": len(constants.zones),
        "element_plays": len(constants.thresholds),
        "means": len(constants.shares),
    }


def _of_inverse(inverse: MultiAxisInverse) -> dict[str, Any]:
    outputs = range(inverse.stage.outputs)
    return {
        "length": len(inverse.first),
        "preview": inverse.preview,
        "wait": inverse.half + inverse.stage.delay_samples,
        "first": [inverse.first[:, :, o].ravel() for o in outputs],
        "corrections": [inverse.corrections[:, :, o].ravel() for o in outputs],
        "limits": inverse.limits_v,
        "accepted": inverse.accepted_um,
    }


def recorded(exported: MultiAxisStage | MultiAxisInverse, scale: np.ndarray) -> np.ndarray:
    """Return the response of the step to the noise of the self-test, at the last of every `EVERY` samples."""
    seed, noise = 1, np.empty((RECORDED * EVERY, len(scale)))
    for sample in noise:
        for k in range(len(scale)):
            seed = (seed * 1664525 + 1013904223) % 2**32
            sample[k] = scale[k] * ((seed >> 8) / 8388608.0 - 1.0)
    if isinstance(exported, MultiAxisStage):
        answers = MultiAxisStream(exported).block(noise)
    else:
        exported.reset()
        answers = exported.block(noise)
        exported.reset()
    return answers[EVERY - 1 :: EVERY]


def _number(value: float) -> str:
    return repr(float(value))


def _numbers(values: Iterable[float]) -> str:
    """Format numbers in lines of readable width."""
    return "\n    ".join(textwrap.wrap(", ".join(map(_number, values)), 106))


def _rows(values: Iterable[Iterable[float]]) -> str:
    return ",\n    ".join(f"{{ {_numbers(row)} }}" for row in values)


def _hexadecimal(values: Iterable[float]) -> str:
    return ", ".join(float(value).hex() for value in values)
