"""Plain NumPy: least squares on play states, their products with the rate, and a cubic."""

import time

import numpy as np
from task import Fitted, Peer, Signal, Task

from torchpi.identification import InversePair


def fit(task: Task) -> Fitted:
    r = task.thresholds_um / task.scales[0]
    x, u = task.inputs(task.train), task.train.u[0].numpy()
    start = time.process_time()
    w, *_ = np.linalg.lstsq(_columns(play_states(x[:, 0], r), x), u, rcond=1e-10)
    fit_s = time.process_time() - start

    h = np.zeros(len(r))

    def step(y: float, rate: float, acceleration: float) -> float:
        x = np.array([y, rate, acceleration]) / task.scales
        h[:] = np.maximum(x[0] - r, np.minimum(x[0] + r, h))
        return float(_columns(h[None], x[None])[0] @ w)

    def voltage(pair: InversePair) -> Signal:
        x = task.inputs(pair)
        return _columns(play_states(x[:, 0], r), x) @ w

    return Fitted(voltage, fit_s, step=step)


def play_states(y: Signal, r: Signal) -> Signal:
    h, states = np.zeros(len(r)), np.empty((len(y), len(r)))
    for t in range(len(y)):
        h = np.maximum(y[t] - r, np.minimum(y[t] + r, h))
        states[t] = h
    return states


def _columns(h: Signal, x: Signal) -> Signal:
    y = x[:, :1]
    return np.hstack([h, h * x[:, 1:2], y**2, y**3, x[:, 1:]])


PEER = Peer(
    "lstsq on play states",
    "numpy",
    "10 plays on y, each constant and times the rate, y², y³, rate and acceleration; one "
    "`numpy.linalg.lstsq`.",
    "a baseline in twenty lines that any training must beat.",
    fit,
    repeats=5,
)
