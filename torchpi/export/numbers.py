"""The numbers of a compensator as JSON, with units: enough to implement the step by hand."""

import json
from pathlib import Path
from typing import Any

import torchpi
from torchpi.control.direct_inverse import DirectInverse
from torchpi.control.step_guard import CONFIRMATIONS
from torchpi.errors import ArtifactError
from torchpi.export.deployable import Deployable
from torchpi.export.formats import Files, written
from torchpi.export.safety_card import Load, safety_card
from torchpi.operators.reference_filter import ReferenceFilter

SCHEMA = "torchpi.control.direct_inverse/1"


def json_files(
    compensator: Deployable,
    output: Path,
    reference_filter: ReferenceFilter | None = None,
    load: Load | None = None,
) -> Files:
    """Return NAME.json.

    Raises:
        ArtifactError: The compensator is not a direct inverse, or has a number that is not finite.
    """
    if not isinstance(compensator, DirectInverse):
        raise ArtifactError(
            f"{type(compensator).__name__} has no JSON form: only a direct inverse has; "
            "use --to torchscript for this model"
        )
    try:
        text = json.dumps(numbers(compensator, reference_filter, load), indent=2, allow_nan=False)
    except ValueError as error:
        raise ArtifactError("a number of the model: found inf or nan, expected finite numbers") from error
    return {output.with_name(output.name + ".json"): written(text + "\n")}


def numbers(
    compensator: DirectInverse,
    reference_filter: ReferenceFilter | None = None,
    load: Load | None = None,
) -> dict[str, Any]:
    """Return the numbers of the compensator in the order in which a step uses them, and its safety card."""
    weights, limits = compensator.weights, compensator.step_limits()
    rate_um_s = f"rate in units of {weights.rate_scale_um_s:g} µm/s"
    return {
        "schema": SCHEMA,
        "torchpi_version": torchpi.__version__,
        "recordings_sha256": compensator.recordings_sha256,
        "source": "Qin et al., IEEE/ASME Trans. Mechatronics 18(3), 2013, eq. 1, 4, 7, 8",
        "input": {
            "signal": "reference y_r" if reference_filter else "desired displacement y_d",
            "unit": "um",
            "preview_samples": compensator.preview,
        },
        "sample_period_s": compensator.sample_period_s,
        "guard": {
            "rule": "an input inside trained_um, within trained_step_um of the last accepted one, is taken; "
            "inside accepted_um and within largest_step_um it is taken and counted in outside_range; from "
            "further away the last accepted one stands in (held_inputs), unless the input and the "
            "confirmations - 1 before it were each within largest_step_um of the one before: then the last "
            "accepted one moves by largest_step_um towards it (outside_range); an input further from the "
            "input before it than that was from its own by more than trained_step_um, and those after it "
            "until confirmations in a row are not, are taken no further than the least and largest input so "
            "far within trained_um (held_inputs beyond), and one that is so by more than sharp_um alone no "
            "further beyond these than the last accepted one moved by the step before and sharp_um; outside "
            "accepted_um, inf and nan the last accepted one stands in (held_inputs), and so it does for a "
            "first input outside trained_um until confirmations more agree; after a sample that was held, "
            "moved, or more than trained_step_um away, the lead is left out until three were taken, and "
            "beyond trained_accelerations_um_s2 it carries no further than the plays' input went before",
            "accepted_um": list(limits.accepted_um),
            "largest_step_um": limits.largest_step_um,
            "confirmations": CONFIRMATIONS,
            "trained_um": list(limits.trained_um),
            "trained_step_um": limits.trained_step_um,
            "sharp_um": limits.sharp_um,
            "largest_output_change_v": limits.max_change_v,
        },
        "reference_filter": None
        if reference_filter is None
        else {
            "equation": "14: e = y_d - y_r decays freely from e(0) = -y_r(0), e'(0) = -y_r'(0)",
            "natural_frequency_rad_s": reference_filter.natural_frequency_rad_s,
            "damping_ratio": reference_filter.damping_ratio,
        },
        "motion": {
            "rate": "(3 (y0 - y1) - (y1 - y2)) / (2 T)",
            "acceleration": "(2 (y0 - y1) - 3 (y1 - y2) + (y2 - y3)) / T^2",
            "start": "y1 is one sample before y0; before the first sample y rests at it",
        },
        "lead": {
            "equation": "x = y_d + tau_1 rate + tau_2 acceleration",
            "tau": compensator.lead.tolist(),
            "units": ["s", "s^2"][: len(compensator.lead)],
        },
        "creep": {
            "equation": "x <- x + sum g_j xi_j; xi_j <- decay_j xi_j + (1 - decay_j) x, x before the sum",
            "g": compensator.creep_gains.tolist(),
            "decay": compensator.creep_decay.tolist(),
        },
        "saturation": {
            "equation": "4: S(x) = c_1 x + ... + c_m x^m",
            "c": compensator.saturation.c.tolist(),
            "unit": "c_i in um^(1-i)",
        },
        "plays": {
            "equation": "1: h_i = max(S - r_i, min(S + r_i, h_i)), from h_i = 0",
            "r": compensator.plays.r.tolist(),
            "unit": "um",
        },
        "weights": {
            "equation": "7: w_i = theta_i0 + theta_i1 z + sum_j theta_i(2+j) q_j, "
            "z = rate / rate_scale, q_j = p / (1 + |p|), p = slope_j z + shift_j",
            "kind": weights.kind,
            "rate_scale_um_s": weights.rate_scale_um_s,
            "theta": weights.theta.tolist(),
            "unit": f"V/um, {rate_um_s}",
            "k": weights.k.tolist(),
            "k_unit": "V/um per um/s",
            "b": weights.b.tolist(),
            "b_unit": "V/um",
            "slope": weights.slope.tolist(),
            "shift": weights.shift.tolist(),
        },
        "output_functions": {
            "equation": "w_i <- w_i + sum_q psi_iq (h_i / scale)^q, q = 1, 2, ...; none is the paper",
            "psi": compensator.psi.tolist(),
            "scale_um": compensator.range_um,
        },
        "output": {
            "equation": "8: u = sum_i w_i h_i + u_0, then limited",
            "u_0_v": compensator.offset.item(),
            "min_v": compensator.min_voltage_v,
            "max_v": compensator.max_voltage_v,
        },
        "safety": safety_card(compensator, load).as_json(),
    }
