"""The compensators compared with the paper's in the reproduction: all are learned from recordings alone."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch

from torchpi.control.corrected import CorrectedInverse
from torchpi.control.direct_inverse import DirectInverse
from torchpi.excitation import signals
from torchpi.identification import InversePair, fit_joint, fit_two_stage, inverse_pair
from torchpi.identification.corrections import fit_corrections
from torchpi.identification.two_stage import fit_weights
from torchpi.operators.motion import backward_motion
from torchpi.paper.fig7_plant import Fig7Plant
from torchpi.recordings.recording import Recording
from torchpi.stage import Stage

# Forward models and starting points are not deployed; the limits of the compensator built from them count.
LOW_V, HIGH_V = -1e3, 1e3
SENSOR_NOISE_UM = 0.005
# The stage responds about two samples late. The bandwidth of rates lies above the first mode and below the
# range where the steps of the converter dominate.
FORM: dict[str, Any] = {
    "output_degree": 2,
    "preview": 2,
    "lead": 2,
    "creep_time_constants_s": [0.01, 0.1, 1.0, 10.0],
}
BANDWIDTH_HZ = 1000.0
PASSES = 4


def fig7_compensator(passes: int = PASSES) -> CorrectedInverse:
    """Fit the compensator for the plant of Fig. 7 to noisy recordings, none at a frequency of the evaluation.

    The forward model has the form of the plant, plays with weights linear in the rate, but none of its
    numbers: thresholds start on a wrong grid and are fitted. The output may go below 0 V, as that of the
    exact inverse does, because the plant cannot come down to 1 µm otherwise.
    """
    plant = Fig7Plant()
    period, fs_hz = plant.sample_period_s, plant.sample_rate_hz
    voltages = [
        torch.from_numpy(u)[None]
        for _, u in (
            signals.multisine(2.0, fs_hz, 0, 10, 1, 20, 1, seed=1),
            signals.multisine(2.0, fs_hz, 0, 10, 1, 60, 1, seed=2),
            signals.multisine(1.0, fs_hz, 0, 10, 1, 120, 1, seed=3),
            signals.multisine(1.0, fs_hz, 0, 10, 1, 200, 1, seed=4),
            signals.multisine(2.0, fs_hz, 0, 6, 1, 60, 1, seed=5),
            signals.multisine(1.0, fs_hz, 3, 10, 1, 120, 1, seed=6),
        )
    ]
    generator = torch.Generator().manual_seed(0)
    readings = [plant.simulate(u)[0] for u in voltages]
    readings = [
        y + SENSOR_NOISE_UM * torch.randn(y.shape, generator=generator, dtype=torch.float64) for y in readings
    ]

    forwards = _pairs(voltages, readings, period)
    model = DirectInverse(
        period,
        [0.43 * i for i in range(14)],
        degree=1,
        range_um=10.0,
        rate_scale_um_s=_fastest(forwards),
        train_thresholds=True,
        min_voltage_v=LOW_V,
        max_voltage_v=HIGH_V,
    )
    model.saturation.requires_grad_(False)  # fixed at 1: thresholds and weights already span its scale
    fit_weights(model, forwards)
    fit_joint(model, forwards, evaluations=80)

    # The responses of the model to the same voltages are free of noise.
    with torch.no_grad():
        answers = [model.voltage(pair.motion)[0] for pair in forwards]
    backwards = _pairs(answers, voltages, period)
    start = DirectInverse(
        period,
        [0.25 * i for i in range(20)],
        degree=1,
        range_um=10.0,
        rate_scale_um_s=_fastest(backwards),
        min_voltage_v=LOW_V,
        max_voltage_v=HIGH_V,
    )
    fit_weights(start, backwards)
    return fit_corrections(
        start,
        model,
        voltages,
        passes,
        min_voltage_v=plant.min_voltage_v,
        max_voltage_v=plant.max_voltage_v,
    )


def stage_compensator(stage: Stage) -> DirectInverse:
    """Fit the compensator for a simulated stage as in `configs/demo.yaml`, to more sensor recordings."""
    return learn(stage_recordings(stage), stage.min_voltage_v, stage.max_voltage_v)


def learn(
    recordings: Sequence[Recording],
    min_voltage_v: float,
    max_voltage_v: float,
    form: Mapping[str, Any] = FORM,
    evaluations: int = 200,
    bandwidth_hz: float = BANDWIDTH_HZ,
) -> DirectInverse:
    """Fit a direct inverse of this form in two stages, then jointly unless `evaluations` is 0."""
    largest = max(float(np.ptp(recording.y)) for recording in recordings)
    pairs = [inverse_pair(recording, form["preview"], bandwidth_hz) for recording in recordings]
    compensator = DirectInverse(
        pairs[0].sample_period_s,
        # Denser near 0 for the reversals; up to nearly the whole range, which the initial loading covers.
        [0.92 * largest * (i / 13) ** 2 for i in range(14)],
        range_um=largest,
        rate_scale_um_s=_fastest(pairs),
        min_voltage_v=min_voltage_v,
        max_voltage_v=max_voltage_v,
        **form,
    )
    fit_two_stage(compensator, pairs)
    # The states still use every sample; for a band of 100 Hz at 10 kHz, every fifth error is sufficient.
    thinned = [pair._replace(counted=slice(pair.counted.start, pair.counted.stop, 5)) for pair in pairs]
    if evaluations > 0:
        fit_joint(compensator, thinned, evaluations)
    return compensator


def stage_recordings(stage: Stage, seed: int = 0) -> list[Recording]:
    """Simulate what a user would record: the paper's two records, multisines of several ranges, triangles.

    The triangles have minor loops. Each `seed` gives other phases and other noise.
    """
    fs_hz = stage.sample_rate_hz
    played = {
        "sine_5hz": signals.sine_5hz(1.0, fs_hz),
        "paper_multisine": signals.paper_multisine(1.0, fs_hz),
        "multisine": signals.multisine(4.0, fs_hz, high_hz=100, seed=3 + 100 * seed),
        "triangles": signals.triangles(6.0, fs_hz),
        "multisine_low": signals.multisine(3.0, fs_hz, high_hz=60, high_v=7.0, seed=5 + 100 * seed),
        "triangles_low": signals.triangles(4.0, fs_hz, high_v=5.0),
    }
    recordings = []
    for noise, (name, (t, u)) in enumerate(played.items(), start=1 + 100 * seed):
        with torch.no_grad():
            _, y = stage.simulate(torch.from_numpy(u)[None], noise)
        recordings.append(Recording(name, t, u, y[0].numpy(), fs_hz))
    return recordings


def _pairs(
    inputs: Sequence[torch.Tensor], outputs: Sequence[torch.Tensor], period_s: float
) -> list[InversePair]:
    """Pair input and output records in either direction, with rates formed as in the deployed step."""
    return [
        InversePair(str(i), backward_motion(x, period_s), y, slice(200, x.shape[1]), period_s)
        for i, (x, y) in enumerate(zip(inputs, outputs, strict=True))
    ]


def _fastest(pairs: Sequence[InversePair]) -> float:
    return max(float(pair.motion.yd_dot.abs().max()) for pair in pairs)
