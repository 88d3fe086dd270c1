"""jax-sysid: the same equations as a custom state and output function, in float64."""

import contextlib
import io
import time
from typing import Any

import numpy as np
from task import Fitted, Peer, Signal, Task
from with_lstsq import play_states

from torchpi.identification import InversePair


def fit_adam(task: Task) -> Fitted:
    return _fit(task, adam_epochs=1000)


def fit_lbfgs(task: Task) -> Fitted:
    return _fit(task, adam_epochs=0)


def _fit(task: Task, adam_epochs: int) -> Fitted:
    import jax
    import jax.numpy as jnp
    from jax_sysid.models import Model

    jax.config.update("jax_enable_x64", True)
    r = task.thresholds_um / task.scales[0]
    decay = np.exp(-task.sample_period_s / np.array(task.creep_time_constants_s))
    # Lead times in sample periods, so that they are of order one.
    periods = task.scales[1:] * task.sample_period_s ** np.array([1, 2]) / task.scales[0]
    relaxations, plays = len(decay), len(r)

    def next_states(state: Any, x: Any, params: Any) -> tuple[Any, Any]:
        c, _, _, tau, gains = params
        x0 = x[0] + jnp.sum(tau * periods * x[1:])
        x1 = x0 + jnp.sum(gains * state[:relaxations])
        s = 0.0
        for coefficient in c[::-1]:
            s = (s + coefficient) * x1
        h = jnp.maximum(s - r, jnp.minimum(s + r, state[relaxations:]))
        return decay * state[:relaxations] + (1 - decay) * x0, h

    @jax.jit
    def state_function(state: Any, x: Any, params: Any) -> Any:
        return jnp.concatenate(next_states(state, x, params))

    @jax.jit
    def output_function(state: Any, x: Any, params: Any) -> Any:
        _, b, k, _, _ = params
        _, h = next_states(state, x, params)
        return jnp.sum((b + k * x[1]) * h).reshape(1)

    x, u = task.inputs(task.train), task.train.u[0].numpy()[:, None] / task.high_v

    def fit(adam_epochs: int, lbfgs_epochs: int) -> Any:
        b, k = _least_squares_weights(x, u[:, 0], r)
        model = Model(relaxations + plays, 1, 3, state_fcn=state_function, output_fcn=output_function)
        model.init(params=[np.eye(task.degree)[0], b, k, np.zeros(2), np.zeros(relaxations)])
        model.loss(rho_x0=0.0, rho_th=0.0, train_x0=False)
        model.optimization(adam_epochs=adam_epochs, lbfgs_epochs=lbfgs_epochs, memory=300, iprint=-1)
        with contextlib.redirect_stdout(io.StringIO()):
            model.fit(u, x)
        return model

    # Every fit compiles again, so a fit that stops at once takes little more than the compilation.
    start = time.process_time()
    fit(min(adam_epochs, 1), 1)
    compiled = time.process_time()
    model = fit(adam_epochs, 5000)
    fit_s, compile_s = time.process_time() - compiled, compiled - start

    @jax.jit
    def both(state: Any, x: Any) -> tuple[Any, Any]:
        return state_function(state, x, model.params), output_function(state, x, model.params)

    zero = np.zeros(relaxations + plays)
    state: list[Any] = [zero]

    def step(y: float, rate: float, acceleration: float) -> float:
        state[0], voltage = both(state[0], np.array([y, rate, acceleration]) / task.scales)
        return task.high_v * float(voltage[0])

    def voltage(pair: InversePair) -> Signal:
        predicted, _ = model.predict(zero, task.inputs(pair))
        return task.high_v * np.asarray(predicted)[:, 0]

    return Fitted(voltage, fit_s, compile_s, step)


def _least_squares_weights(x: Signal, u: Signal, r: Signal) -> tuple[Signal, Signal]:
    """Return the starting weights: from b = 1/n, k = 0 the fit takes longer and ends at a larger error."""
    states = play_states(x[:, 0], r)
    w, *_ = np.linalg.lstsq(np.hstack([states, states * x[:, 1:2]]), u, rcond=1e-10)
    return w[: len(r)], w[len(r) :]


_SETTINGS = (
    "The same equations as torchpi, joint, as custom state and output function (13 states, 29 parameters), "
    "float64, no regularisation, x0 = 0, start from least squares on the plays, {}L-BFGS with memory 300 "
    "until it converges."
)
_PURPOSE = (
    "system identification of state-space models of any kind, with regularisation; it does not know plays."
)
LBFGS = Peer("jax-sysid, L-BFGS", "jax_sysid", _SETTINGS.format(""), _PURPOSE, fit_lbfgs, repeats=3)
ADAM = Peer(
    "jax-sysid, Adam and L-BFGS",
    "jax_sysid",
    _SETTINGS.format("1,000 steps of Adam, then "),
    _PURPOSE,
    fit_adam,
)
