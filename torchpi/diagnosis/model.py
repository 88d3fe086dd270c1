"""Conversion of a fit into the stage that simulates it."""

from collections.abc import Sequence

import numpy as np

from torchpi.diagnosis.hypothesis import EffectTerm, Fit
from torchpi.diagnosis.hysteresis_model import FIRM
from torchpi.stage import Stage
from torchpi.stage.effects.effect import DataRange
from torchpi.stage.effects.mechanics.modal import ModalEffect


def augmented_stage(now: Fit, recordings: int, seen: DataRange, noise_um: float) -> Stage:
    """Return the fitted chain as a stage at the sample rate of the data seen.

    A parameter with a value for each recording becomes their mean if all lie on one side of its identity, and
    the identity otherwise: the phase of the mains, for example, differs in the next recording.
    """
    nominal = now.hypothesis.nominal
    weights = nominal.of_stage(now.weights[: nominal.kept])
    outside, r = nominal.simulation, nominal.thresholds_v
    simulation = None
    if outside:
        simulation = {"reference": outside.reference, "gain": FIRM * float(weights[-1])}
        weights = weights[:-1]
        if not len(r):  # a stage has at least one play
            r, weights = np.zeros(1), np.zeros(1)
    hysteresis = {
        "thresholds_v": r.tolist(),
        "weights": np.append(weights, 0.0),
        "pieces": nominal.pieces,
        "range_v": list(nominal.range_v),
        "scale_v": nominal.scale_v,
        "bouc_wen": nominal.bouc_wen,
        "duhem": nominal.duhem,
        "shape": dict(nominal.shape),
        **({"simulation": simulation} if simulation else {}),
    }
    effects = [
        {
            "name": member.effect.name,
            "values": common_values(member),
            "aux": member.aux,
            "modal": issubclass(member.effect, ModalEffect),
        }
        for member in now.hypothesis.members
    ]
    stage = Stage(
        seen.fs_hz,
        hysteresis,
        effects,
        alignment=now.hypothesis.alignment,
        min_voltage_v=seen.low_v,
        max_voltage_v=seen.high_v,
        noise_um=noise_um,
        stepped=now.hypothesis.held,
        zero_um=float(np.mean(now.weights[-recordings:])),
    )
    return stage.with_simulation(outside.simulator) if outside and outside.simulator else stage


def common_values(member: EffectTerm) -> dict[str, float]:
    """Return the parameters for a future recording."""
    values = dict(member.shared)
    for name in {name for own in member.own for name in own}:
        each = [own.get(name, member.effect.identity[name]) for own in member.own]
        values[name] = agreed(each, member.effect.identity[name])
    return values


def agreed(each: Sequence[float], identity: float) -> float:
    """Return the mean if all values lie on one side of the identity, else the identity."""
    signs = {np.sign(value - identity) for value in each}
    return float(np.mean(each)) if len(signs) == 1 else identity
