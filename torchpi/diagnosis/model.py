"""From a fit to the augmented stage that simulates it."""

from collections.abc import Sequence

import numpy as np
import torch

from torchpi.diagnosis.hypothesis import Fit, Member
from torchpi.stage.augmented import AugmentedStage
from torchpi.stage.effects.effect import Seen
from torchpi.stage.effects.mechanics.modal import ModalEffect


def augmented_stage(now: Fit, seen: Seen, noise_um: float) -> AugmentedStage:
    """The fitted chain at the highest sample rate of the recordings.

    A parameter that each recording has for itself becomes their mean where all agree in sign, and its
    identity where they do not: nobody can foretell the phase of the mains.
    """
    nominal = now.hypothesis.nominal
    rows = now.weights[:-1]
    weights = rows if nominal.mixing is None else nominal.mixing.T @ rows
    return AugmentedStage(
        1.0 / seen.fs_hz,
        {
            "thresholds_v": nominal.thresholds_v.tolist(),
            "weights": torch.from_numpy(np.append(weights, 0.0)),
            "degree": nominal.degree,
            "scale_v": nominal.scale_v,
            "bouc_wen": nominal.bouc_wen,
            "duhem": nominal.duhem,
            "shape": dict(nominal.shape),
        },
        [
            {
                "name": member.effect.name,
                "values": foretold(member),
                "aux": member.aux or None,
                "modal": issubclass(member.effect, ModalEffect),
            }
            for member in now.hypothesis.members
        ],
        now.hypothesis.alignment,
        noise_um,
        seen.low_v,
        seen.high_v,
        stepped=now.hypothesis.held,
        zero_um=float(now.weights[-1]),
    )


def foretold(member: Member) -> dict[str, float]:
    """The parameters for a recording that was not made yet."""
    values = dict(member.shared)
    for name in {name for own in member.own for name in own}:
        each = [own.get(name, member.effect.identity[name]) for own in member.own]
        values[name] = agreed(each, member.effect.identity[name])
    return values


def agreed(each: Sequence[float], identity: float) -> float:
    """Their mean if all lie on one side of the identity."""
    signs = {np.sign(value - identity) for value in each}
    return float(np.mean(each)) if len(signs) == 1 else identity
