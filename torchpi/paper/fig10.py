"""Fig. 10 and Table I, Qin et al. (2013): the direct inverse, identified in two stages from two recordings.

The paper quotes an error of the voltage, 0.21, in µm. Here it is given in V, and converted to µm with the
local slope of the measured loop: the displacement by which the stage would miss.
"""

import time
from dataclasses import dataclass

import numpy as np
import torch

from torchpi.control.direct_inverse import DirectInverse
from torchpi.excitation.signals import paper_multisine, sine_5hz
from torchpi.identification import InversePair, TwoStageResult, fit_two_stage, inverse_pair, local_slope
from torchpi.paper.tracking import Plant, record
from torchpi.recordings.recording import Recording

THRESHOLDS = (0.0, 0.05, 0.1, 0.2, 0.3, 0.5, 1.0, 1.5, 2.0, 3.0)
"""Thresholds r of the paper's compensator, in the unit of S(y)."""
DEGREE = 4
"""Degree m of its saturation polynomial."""
# Five periods of each; for eq. 13 these are 5,000 samples, the minimum that the paper requires.
SINE_S, MULTISINE_S = 1.0, 0.5
EQ_12 = [1.40, -7.62e-2, 1.45e-2, -7.53e-4]  # c_1 … c_4, as identified on the paper's rig


@dataclass(frozen=True)
class Identified:
    """The paper's compensator, and the recordings it was identified from."""

    compensator: DirectInverse
    slow: Recording
    fast: Recording
    pairs: tuple[InversePair, InversePair]
    stages: TwoStageResult
    seconds: float


@dataclass(frozen=True)
class ModelError:
    """Error of the identified model relative to the measured voltage."""

    max_v: float
    rms_v: float
    max_um: float
    rms_um: float


@dataclass(frozen=True)
class Fig10:
    """The record of eq. 13, measured and predicted."""

    t: np.ndarray  # (time,), s
    y: np.ndarray  # (time,), µm, input of the model
    u: np.ndarray  # (time,), V, measured: the ideal inversion
    u_model: np.ndarray  # (time,), V
    loading_s: float  # until the voltage first reaches its maximum, which erases the start from the plays
    whole: ModelError
    after_loading: ModelError
    stages: TwoStageResult
    seconds: float
    c: list[float]  # c_1 … c_4, eq. 4
    k: list[float]  # V/µm per µm/s, eq. 7
    b: list[float]  # V/µm


def identify(
    plant: Plant,
    seed: int | None = None,  # of the noise; by default that of the plant
) -> Identified:
    """Fit the two stages (eq. 10, 11) to the two recordings, with no other knowledge of the plant."""
    period_s, rate_hz = plant.sample_period_s, plant.sample_rate_hz
    # The seeds are spaced so that no two records share their noise.
    first = 4 * (plant.seed if seed is None else seed)
    slow = record(plant, "5 Hz sine", sine_5hz(SINE_S, rate_hz), first)
    fast = record(plant, "eq. 13", paper_multisine(MULTISINE_S, rate_hz), first + 1)
    pairs = inverse_pair(slow), inverse_pair(fast)
    compensator = paper_form(pairs, period_s)
    start = time.perf_counter()
    stages = fit_two_stage(compensator, pairs, several_starts=False)
    return Identified(compensator, slow, fast, pairs, stages, time.perf_counter() - start)


def paper_form(pairs: tuple[InversePair, ...], period_s: float, preview: int = 0) -> DirectInverse:
    """Return the unfitted form: n = 10 plays at the paper's thresholds, m = 4, weights linear in the rate."""
    return DirectInverse(
        period_s,
        THRESHOLDS,
        DEGREE,
        preview=preview,
        range_um=max(float(pair.motion.yd.max()) for pair in pairs),
        rate_scale_um_s=max(float(pair.motion.yd_dot.abs().max()) for pair in pairs),
    )


def fig10(identified: Identified) -> Fig10:
    """Evaluate the identified model on its own second record, as in the paper."""
    pair, compensator = identified.pairs[1], identified.compensator
    y, u = pair.motion.yd[0], pair.u[0].numpy()
    with torch.no_grad():
        u_model = compensator(pair.motion)[0].numpy()
        c = compensator.saturation.c.tolist()
        k, b = compensator.weights.k.tolist(), compensator.weights.b.tolist()
    volts = u_model - u
    microns = volts * local_slope(y, pair.u[0]).numpy()
    end = int(np.argmax(u >= u.max() - 1e-9 * np.ptp(u)))
    return Fig10(
        t=identified.fast.t,
        y=y.numpy(),
        u=u,
        u_model=u_model,
        loading_s=end * pair.sample_period_s,
        whole=_model_error(volts, microns),
        after_loading=_model_error(volts[end:], microns[end:]),
        stages=identified.stages,
        seconds=identified.seconds,
        c=c,
        k=k,
        b=b,
    )


def saturation(c: list[float], x: np.ndarray) -> np.ndarray:
    """Return S(x) of eq. 4; `c` has c_1 first."""
    return np.asarray(np.polyval([*c[::-1], 0.0], x))


def _model_error(volts: np.ndarray, microns: np.ndarray) -> ModelError:
    return ModelError(
        max_v=float(np.abs(volts).max()),
        rms_v=float(np.sqrt(np.mean(volts**2))),
        max_um=float(np.abs(microns).max()),
        rms_um=float(np.sqrt(np.mean(microns**2))),
    )
