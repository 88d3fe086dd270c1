"""sysidentpy: a polynomial NARX model, its terms chosen by FROLS."""

import contextlib
import io
import time
import warnings
from collections.abc import Iterator

import numpy as np
from task import Fitted, Peer, Signal, Task

from torchpi.identification import InversePair

# Long lags: at 10 kHz the last voltage predicts nearly all, and a model with lag 1 diverges in free run.
VOLTAGE_LAG, MOTION_LAGS, DEGREE, TERMS = 50, [1, 25, 50], 3, 50


def fit(task: Task) -> Fitted:
    from sysidentpy.basis_function import Polynomial
    from sysidentpy.model_structure_selection import FROLS
    from sysidentpy.parameter_estimation import LeastSquares

    x, u = _early(_inputs(task, task.train)), task.train.u[0].numpy()[:, None] / task.high_v
    start = time.process_time()
    model = FROLS(
        order_selection=False,
        n_terms=TERMS,
        ylag=[VOLTAGE_LAG],
        xlag=[MOTION_LAGS] * x.shape[1],
        basis_function=Polynomial(degree=DEGREE),
        estimator=LeastSquares(),
    )
    with _quiet():
        model.fit(X=x, y=u)
    fit_s = time.process_time() - start
    lag = model.max_lag

    def voltage(pair: InversePair) -> Signal:
        with _quiet():
            # Before the record the stage is de-energised and at rest.
            rest = np.zeros((lag, 1))
            padded = np.concatenate([np.zeros((lag, x.shape[1])), _inputs(task, pair)])
            return task.high_v * np.asarray(model.predict(X=_early(padded), y=rest))[lag:, 0]

    past_x, past_u = np.zeros((lag + 1, x.shape[1])), np.zeros((lag, 1))

    def step(y: float, rate: float, acceleration: float) -> float:
        past_x[:-1] = past_x[1:]
        past_x[-2] = past_x[-1] = _with_direction(np.array([[y, rate, acceleration]]) / task.scales)[0]
        u_now = np.asarray(model.predict(X=past_x, y=past_u))[-1]
        past_u[:-1], past_u[-1] = past_u[1:], u_now
        return task.high_v * float(u_now[0])

    return Fitted(voltage, fit_s, step=step)


def _inputs(task: Task, pair: InversePair) -> Signal:
    return _with_direction(task.inputs(pair))


def _with_direction(x: Signal) -> Signal:
    return np.hstack([x, np.sign(x[:, 1:2])])


def _early(x: Signal) -> Signal:
    """Advance the signals by one sample, because the library's smallest lag is one."""
    return np.concatenate([x[1:], x[-1:]])


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    with warnings.catch_warnings(), contextlib.redirect_stdout(io.StringIO()):
        warnings.simplefilter("ignore")
        yield


PEER = Peer(
    "sysidentpy",
    "sysidentpy",
    f"Polynomial NARX of degree {DEGREE} on displacement, rate, acceleration and direction (lags 1, 25, 50) "
    f"and on its own voltage (lag {VOLTAGE_LAG}); {TERMS} terms chosen by FROLS, least squares; run freely.",
    "short readable models of unknown systems, at a low sample rate; it has no memory of reversals.",
    fit,
    repeats=2,
)
