"""The numbers of a stage with several axes as JSON, with units: enough to implement the step by hand."""

import json
from pathlib import Path
from typing import Any

import numpy as np

import torchpi
from torchpi.control.multi_axis import MultiAxisInverse
from torchpi.errors import ArtifactError
from torchpi.operators.modal_feedback import SMALLEST_MEAN
from torchpi.operators.oversampled_inputs import FACTOR, low_pass_taps
from torchpi.stage.multi_axis import MultiAxisStage

STAGE_SCHEMA, INVERSE_SCHEMA = "torchpi.stage.multi_axis/1", "torchpi.control.multi_axis/1"


def numbers(exported: MultiAxisStage | MultiAxisInverse) -> str:
    """Return the text of the file."""
    found = of_stage(exported) if isinstance(exported, MultiAxisStage) else of_inverse(exported)
    return json.dumps(found, indent=2, allow_nan=False) + "\n"


def of_stage(stage: MultiAxisStage) -> dict[str, Any]:
    """Return the equations in the order in which a step uses them, each with its numbers."""
    a = {name: value.tolist() for name, value in stage.arrays().items()}
    zones, thresholds, kept, shares = (one.tolist() for one in stage.thresholds_of_kernel())
    inputs = stage.input_stream()
    return {
        "schema": STAGE_SCHEMA,
        "torchpi_version": torchpi.__version__,
        "sample_period_s": 1 / stage.sample_rate_hz,
        "input": {"signal": "u_i", "unit": "V", "count": stage.inputs},
        "output": {
            "signal": "y_o",
            "unit": "um",
            "count": stage.outputs,
            "delay_samples": stage.delay_samples,
        },
        "interpolation": {
            "equation": f"x = ({FACTOR} taps) * (u_i with {FACTOR - 1} zeros behind each sample), "
            f"at {FACTOR} times the rate",
            "factor": FACTOR,
            "taps": low_pass_taps().tolist(),
        },
        "actuator_plays": {
            "equation": "e = x - h; h <- x - a e / sqrt(1 + (1 - a^2) (e/r)^2); adds h - x; at the higher "
            "rate",
            "r": inputs.thresholds.tolist(),
            "r_unit": "V",
            "a": inputs.kept.tolist(),
        },
        "amplifier_crossover": {
            "equation": "s/(s + omega), as f = b0 x + g, g <- b1 x - a1 f, of x gives f; sigma = "
            "(omega f / width) / sqrt(1 + (omega f / width)^2); adds s/(s + omega) of each sigma, then of "
            "each sigma^2, at the higher rate",
            "omega_rad_s": inputs.omega,
            "width_v_per_s": inputs.widths.tolist(),
            "b0_b1_a1": inputs.high_pass.tolist(),
        },
        "actuator": {
            "equation": "v_i = u_i + sum_r g_ir (taps * what is added)_r, every "
            f"{FACTOR}th sample; u_i {stage.delay_samples} samples late",
            "g": a["play_weights"],
        },
        "elements": {
            "equation": "z_n = sum_m a_nm . x_m + sum_i f_ni v_i; w_n = sum_j theta_nj phi_nj; phi: "
            "max(z - r, 0) for each r >= 0 of dead_zones and min(z - r, 0) for r < 0; h - z of each play; "
            "z sqrt(s + smallest) of each mean s of |z|, s <- s + max(share, 1/k) (|z| - s) at sample k; "
            "z v_i, i = n mod inputs",
            "a": a["sensed"],
            "f": a["through"],
            "theta": a["weights"],
            "dead_zones": zones,
            "play_r": thresholds,
            "play_a": kept,
            "share": shares,
            "smallest": SMALLEST_MEAN,
        },
        "modes": {
            "equation": "y_o = sum_m c_om . x_m + sum_i d_oi v_i + offset_o + sum_ij a_oij u_i, j from 1 on "
            "samples later; then x_m <- [[p, -q], [q, p]] x_m + sum_i b_mi v_i + sum_n e_mn w_n",
            "p_q": a["poles"],
            "b": a["drive"],
            "e": a["force"],
            "c": a["seen"],
            "c_unit": "um",
            "d": a["direct"],
            "d_unit": "um/V",
            "a": a["ahead"],
            "offset_um": stage.offset().tolist(),
        },
    }


def read_inverse(path: Path, stage: MultiAxisStage) -> MultiAxisInverse:
    """Read an inverse from its JSON file.

    Args:
        path: NAME.json.
        stage: The stage that the inverse was made for.

    Raises:
        ArtifactError: The file is of another kind, was changed, or belongs to another stage.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        filters = content["filters"]
        inverse = MultiAxisInverse(
            stage,
            np.array(filters["first"], dtype=np.float64),
            np.array(filters["corrections"], dtype=np.float64),
            int(filters["passes"]),
            np.array(content["output"]["limits_v"], dtype=np.float64),
            np.array(content["guard"]["accepted_um"], dtype=np.float64),
        )
        same = content["schema"] == INVERSE_SCHEMA and content["stage"]["modes"] == of_stage(stage)["modes"]
    except (OSError, KeyError, TypeError, ValueError) as error:
        raise ArtifactError(f"{path}: not readable, expected the numbers of 'torchpi export'") from error
    if not same:
        raise ArtifactError(
            f"{path}: found the numbers of another stage, expected those of the one beside it"
        )
    return inverse


def of_inverse(inverse: MultiAxisInverse) -> dict[str, Any]:
    """Return the filters, the limits and the stage that the filters run against."""
    return {
        "schema": INVERSE_SCHEMA,
        "torchpi_version": torchpi.__version__,
        "sample_period_s": 1 / inverse.stage.sample_rate_hz,
        "input": {
            "signal": "desired displacement y_d",
            "unit": "um",
            "count": inverse.stage.outputs,
            "preview_samples": inverse.preview,
        },
        "guard": {
            "rule": "a sample with a value that is not finite, or further from 0 than accepted_um, is held: "
            "the last accepted one stands in",
            "accepted_um": inverse.accepted_um.tolist(),
        },
        "filters": {
            "equation": "u_0 = first * y_d; u_j = u_(j-1) + corrections * (y_d - y(u_(j-1))) for each of the "
            "passes, y of the stage without its offset; taps[j][input][output], the newest sample first; "
            "y_d and u_(j-1) are delayed by the samples that stage and filter are late",
            "passes": inverse.passes,
            "delay_samples": inverse.half + inverse.stage.delay_samples,
            "first": inverse.first.tolist(),
            "corrections": inverse.corrections.tolist(),
            "unit": "V/um",
        },
        "output": {"unit": "V", "count": inverse.stage.inputs, "limits_v": inverse.limits_v.tolist()},
        "stage": of_stage(inverse.stage),
    }
