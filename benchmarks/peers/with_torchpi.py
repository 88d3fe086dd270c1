"""torchpi: the two stages of the paper, and the joint fit."""

import time

from task import PREVIEW, Fitted, Peer, Signal, Task

from torchpi import DirectInverse
from torchpi.export.torchscript import script
from torchpi.identification import InversePair, fit_joint, fit_two_stage


def inverse(task: Task) -> DirectInverse:
    """The equations that all peers with plays fit, at the plain start: S(x) = x, no lead, no creep."""
    range_um, rate_um_s, _ = task.scales.tolist()
    return DirectInverse(
        task.sample_period_s,
        task.thresholds_um.tolist(),
        task.degree,
        rate="linear",
        preview=PREVIEW,
        lead=2,
        creep_time_constants_s=task.creep_time_constants_s,
        max_voltage_v=task.high_v,
        range_um=range_um,
        rate_scale_um_s=rate_um_s,
    )


def fit_stages(task: Task) -> Fitted:
    compensator = inverse(task)
    start = time.process_time()
    fit_two_stage(compensator, [task.train])
    return fitted(compensator, time.process_time() - start)


def fit_everything(task: Task) -> Fitted:
    compensator = inverse(task)
    start = time.process_time()
    fit_joint(compensator, [task.train])
    return fitted(compensator, time.process_time() - start)


def fitted(compensator: DirectInverse, fit_s: float) -> Fitted:
    def voltage(pair: InversePair) -> Signal:
        u: Signal = compensator.voltage(pair.motion)[0][0].detach().numpy()
        return u

    exported = script(compensator)
    return Fitted(voltage, fit_s, step=lambda y, rate, acceleration: exported.step(y))


TWO_STAGE = Peer(
    "torchpi, two stages",
    "torchpi",
    "`fit_two_stage`: the paper's identification, without lead and creep.",
    "the paper's method, and a start.",
    fit_stages,
    repeats=5,
)
JOINT = Peer(
    "torchpi, joint",
    "torchpi",
    "`fit_joint` from the plain start: all parameters together, the linear ones solved for.",
    "this task: direct inverses of piezo stages. The step is the exported TorchScript, which also forms "
    "rate and acceleration itself; the other steps are given them.",
    fit_everything,
    repeats=5,
    compiles=True,
)
