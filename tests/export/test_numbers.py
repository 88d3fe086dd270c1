"""The JSON file holds enough to implement the step by hand."""

import json
import math
from pathlib import Path
from typing import Any

import torch

from tests.control.test_direct_inverse import compensator, trajectory
from torchpi.export import export_files


def by_hand(numbers: dict[str, Any], yd: list[float]) -> list[float]:
    """Compute the step as a reader of the JSON would implement it, from the JSON alone."""
    period = numbers["sample_period_s"]
    r, h = numbers["plays"]["r"], [0.0] * len(numbers["plays"]["r"])
    xi = [0.0] * len(numbers["creep"]["g"])
    y1 = y2 = y3 = yd[0]
    voltages = []
    for y0 in yd:
        rate = (3 * (y0 - y1) - (y1 - y2)) / (2 * period)
        acceleration = (2 * (y0 - y1) - 3 * (y1 - y2) + (y2 - y3)) / period**2
        y1, y2, y3 = y0, y1, y2
        x = y0 + sum(tau * d for tau, d in zip(numbers["lead"]["tau"], (rate, acceleration), strict=False))
        crept = sum(g * state for g, state in zip(numbers["creep"]["g"], xi, strict=True))
        xi = [a * s + (1 - a) * x for a, s in zip(numbers["creep"]["decay"], xi, strict=True)]
        x += crept
        s = sum(c * x ** (i + 1) for i, c in enumerate(numbers["saturation"]["c"]))
        weights = numbers["weights"]
        z = rate / weights["rate_scale_um_s"]
        p = [a * z + c for a, c in zip(weights["slope"], weights["shift"], strict=True)]
        basis = [1.0, z, *(value / (1 + abs(value)) for value in p)]
        u = numbers["output"]["u_0_v"]
        for i, theta in enumerate(weights["theta"]):
            h[i] = max(s - r[i], min(s + r[i], h[i]))
            own = numbers["output_functions"]
            z_own = h[i] / own["scale_um"]
            w = sum(t * phi for t, phi in zip(theta, basis, strict=True))
            w += sum(psi * z_own ** (q + 1) for q, psi in enumerate(own["psi"][i]))
            u += w * h[i]
        voltages.append(min(max(u, numbers["output"]["min_v"]), numbers["output"]["max_v"]))
    return voltages


def test_a_step_written_by_hand_from_the_json_gives_the_same_voltages(tmp_path: Path) -> None:
    made = compensator()
    export_files(made, tmp_path / "c", ["json"])
    numbers = json.loads((tmp_path / "c.json").read_text())
    yd = trajectory(400)
    expected = made.stream().block(yd)
    assert torch.allclose(
        torch.tensor(by_hand(numbers, yd.tolist()), dtype=torch.float64), expected, atol=1e-9
    )


def test_json_is_versioned_and_has_units(tmp_path: Path) -> None:
    export_files(compensator(), tmp_path / "c", ["json"])
    numbers = json.loads((tmp_path / "c.json").read_text())
    assert numbers["schema"] == "torchpi.control.direct_inverse/1"
    assert numbers["input"] == {"signal": "desired displacement y_d", "unit": "um", "preview_samples": 3}
    assert math.isclose(numbers["sample_period_s"], 1e-4)
    assert {"k_unit", "b_unit"} <= numbers["weights"].keys()
