"""`diagnosis.json`: the diagnosis in a fixed file format, for other programs."""

import json
import math
from typing import Any

from torchpi.diagnosis.diagnosis import Diagnosis, Errors, NamedEffect, Where
from torchpi.report.what_was_run import Provenance

SCHEMA = "torchpi diagnosis 1"


def diagnosis_json(diagnosis: Diagnosis, provenance: Provenance) -> str:
    """Return the diagnosis as strict JSON. A number that is not finite, or a noise
    that was not measured, is null."""
    content = {
        "verdict": diagnosis.verdict,
        "effects": [_effect(effect) for effect in diagnosis.effects],
        "open": [
            {"name": one.name, "alternatives": list(one.alternatives), "probability": one.probability}
            for one in diagnosis.open
        ],
        "where": [_where(cell) for cell in diagnosis.where],
        "fit": {
            "nominal": _errors(diagnosis.nominal),
            "retuned": _errors(diagnosis.retuned),
            "augmented": _errors(diagnosis.augmented),
            "noise_floor_um": diagnosis.noise_floor_um,
            "heldout": diagnosis.heldout,
        },
        "across_recordings": [
            {"recording": one.recording, "rms_um": one.rms_um, "fitted_rms_um": one.fitted_rms_um}
            for one in diagnosis.across
        ],
        "another_motion_um": diagnosis.another_motion_um,
        "joint_share": diagnosis.joint_share,
        "unexplained_share": diagnosis.unexplained_share,
        "next_recording": {
            "why": diagnosis.next_recording.why,
            "excitation": diagnosis.next_recording.excitation,
        },
        "says": diagnosis.says,
        "notes": list(diagnosis.notes),
        "schema": SCHEMA,
        "versions": dict(provenance.versions),
        "run": {
            "command": provenance.command,
            "seed": provenance.seed,
            "files_sha256": dict(provenance.files),
            "machine": provenance.machine,
        },
    }
    return json.dumps(_finite(content), indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def _effect(effect: NamedEffect) -> dict[str, Any]:
    return {
        "name": effect.name,
        "block": effect.block,
        "alternatives": list(effect.alternatives),
        "probability": effect.probability,
        "parameters": {
            one.name: {"value": one.value, "unit": one.unit, "interval_90": one.interval_90}
            for one in effect.parameters
        },
        "share": effect.share,
    }


def _where(cell: Where) -> dict[str, Any]:
    return {
        "domain": cell.domain,
        "range": list(cell.range),
        "unit": cell.unit,
        "share": cell.share,
        "significance": cell.significance,
        "label": cell.label,
    }


def _errors(errors: Errors) -> dict[str, float]:
    return {
        "train_rms_um": errors.train_rms_um,
        "heldout_rms_um": errors.heldout_rms_um,
        "heldout_max_um": errors.heldout_max_um,
    }


def _finite(value: Any) -> Any:
    """Return the value in plain Python types; NumPy numbers are converted, non-finite ones become None."""
    if isinstance(value, dict):
        return {key: _finite(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(one) for one in value]
    if value is None or isinstance(value, str | bool | int):
        return value
    number = float(value)
    return number if math.isfinite(number) else None
