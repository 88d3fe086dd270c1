"""The rival: forty plays by least squares and one linearised column per effect, in NumPy.

    python -m concealed.rivals.baseline diagnose a.csv b.csv c.csv --output DIR
    python -m concealed.rivals.baseline predict DIR/stage.json heldout_input.csv --output prediction.csv

The last 30 % of each recording is held out. An effect is named only if its column is the best in training and
held out, and lowers the held-out error by 3 %; it is then kept, and the search continues up to three effects.
"""

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from concealed.rivals.contract import MOST, Errors, Run, command_line, named, write_diagnosis
from scipy.signal import lfilter

HELD = 0.7  # of each recording is fitted, the rest held out
RECORDINGS = 5  # at most
THRESHOLDS = np.concatenate([[0.0], np.geomspace(2e-3, 0.9, 39)])
PARAMETERS = {
    "amplifier_lag": ("cutoff_hz", "Hz"),
    "slew_limit": ("limit_v_per_s", "V/s"),
    "delay": ("delay_s", "s"),
    "voltage_saturation": ("upper_v", "V"),
    "creep": ("tau_1_s", "s"),
    "resonance": ("frequency_hz", "Hz"),
    "hum": ("frequency_hz", "Hz"),
    "thermal_drift": ("tau_s", "s"),
    "backlash": ("width_um", "um"),
}


class Library(NamedTuple):
    """The data of the fit: thinned rows of all recordings, one after the other."""

    y: np.ndarray  # (rows,), µm
    input_v: np.ndarray  # (rows,)
    rate_v_s: np.ndarray  # (rows,)
    place: np.ndarray  # (rows,): position in its recording, 0 to 1
    plays: np.ndarray  # (rows, plays + 1)
    weights: np.ndarray
    """Weights of the plays, fitted to the first part of each recording."""
    span: float
    grid: list[tuple[str, float]]
    columns: list[np.ndarray]
    """The columns of each entry of the grid, (rows, columns)."""


def diagnose(runs: list[Run], output: Path) -> None:
    """Write diagnosis.json and stage.json into `output`."""
    library = library_of(runs)
    y, train, grid, columns = library.y, library.place < HELD, library.grid, library.columns
    base, found, starts = library.plays, [], []
    errors = [errors_of(base, y, train)]
    while len(found) < 3:
        trained = [fit_on_top(base, c, y, train) for c in columns]
        best_train, best_held = (min(range(len(grid)), key=lambda i, j=j: trained[i][j]) for j in (0, 1))
        if grid[best_train][0] != grid[best_held][0] or trained[best_train][1] > 0.97 * errors[-1][1]:
            break
        found.append(grid[best_train])
        starts.append(base.shape[1])
        base = np.column_stack([base, columns[best_train]])
        errors.append(errors_of(base, y, train))
        taken = [n for n, _ in found]
        keep = [i for i, (n, _) in enumerate(grid) if n not in taken]
        grid, columns = [grid[i] for i in keep], [columns[i] for i in keep]
    write_answer(output, library, found, starts, ridge(base[train], y[train]), errors)


def library_of(runs: list[Run]) -> Library:
    """Compute forty plays, and what each effect of the grid would add to them."""
    every = max(sum(run["time_s"].size for run in runs) // MOST, 1)

    def rows(of_run: Callable[[Run], np.ndarray]) -> np.ndarray:
        return np.concatenate([of_run(run)[::every] for run in runs])

    y, place = rows(lambda run: run["output_um"]), rows(lambda run: np.linspace(0, 1, run["time_s"].size))
    span = max(float(np.max(np.abs(run["input_v"]))) for run in runs)
    states = [nominal(run, span) for run in runs]
    plays = np.concatenate([s[::every] for s in states])
    weights = ridge(plays[place < HELD], y[place < HELD])
    steepest = max(float(np.max(np.abs(np.diff(run["input_v"])))) / run["dt"] for run in runs)
    grid = candidates(runs[0]["dt"], span, steepest, np.ptp(y), len(runs), "aux_v" in runs[0])
    columns = [
        np.concatenate(
            [
                column(n, p, r, s @ weights, i)[::every]
                for i, (r, s) in enumerate(zip(runs, states, strict=True))
            ]
        )
        for n, p in grid
    ]
    rate = rows(lambda run: np.gradient(run["input_v"], run["dt"]))
    return Library(y, rows(lambda run: run["input_v"]), rate, place, plays, weights, span, grid, columns)


def write_answer(
    output: Path,
    library: Library,
    found: Sequence[tuple[str, float]],
    starts: Sequence[int],
    final: np.ndarray,
    errors: Sequence[Errors],
) -> None:
    """Write the effects found; `starts` are the indices of their first weights in `final`."""
    stage = {
        "span": library.span,
        "smooth": library.weights.tolist(),
        "weights": final.tolist(),
        "named": found,
    }
    signed = [_signed(n, p, final[start]) for (n, p), start in zip(found, starts, strict=True)]
    write_diagnosis(output, [named(n, len(signed), _parameters(n, p)) for n, p in signed], errors, stage)


def _signed(name: str, parameter: float, weight: float) -> tuple[str, float]:
    """Rename creep to leakage if its weight is negative."""
    return ("leakage", parameter) if name == "creep" and weight < 0 else (name, parameter)


def _parameters(name: str, value: float) -> dict:
    if name not in PARAMETERS:
        return {}
    key, unit = PARAMETERS[name]
    return {key: {"value": float(value), "unit": unit}}


def predict(stage: dict, run: Run) -> np.ndarray:
    """Return the stage's response to an input."""
    plays = nominal(run, stage["span"])
    smooth = plays @ np.array(stage["smooth"])
    columns = [column(name, p, run, smooth, -1) for name, p in stage["named"]]
    return np.column_stack([plays, *columns]) @ np.array(stage["weights"])


def nominal(run: dict, span: float) -> np.ndarray:
    """The states of forty plays, and an offset."""
    r, h = THRESHOLDS * span, np.zeros(THRESHOLDS.size)
    out = np.ones((run["input_v"].size, THRESHOLDS.size + 1))
    for t, u in enumerate(run["input_v"]):
        h = np.minimum(np.maximum(h, u - r), u + r)
        out[t, :-1] = h
    return out


def candidates(dt: float, span: float, steepest: float, reach_um: float, runs: int, aux: bool) -> list:
    """(name, parameter) on a small grid."""
    grid = [("delay", n * dt) for n in range(1, 9)]
    grid += [("amplifier_lag", f / dt) for f in np.geomspace(0.003, 0.5, 10)]
    grid += [("slew_limit", steepest * s) for s in (0.03, 0.1, 0.3, 0.6)]
    grid += [("voltage_saturation", span * s) for s in (0.7, 0.75, 0.8, 0.85, 0.9, 0.94, 0.97, 0.985)]
    grid += [("hysteresis_operator", kind) for kind in (1, 2, 3)]
    grid += [("rate_dependent_hysteresis", span * s) for s in (0.3, 3.0, 30.0)]
    grid += [("creep", tau) for tau in (0.01, 0.1, 1.0, 10.0)]
    grid += [("resonance", f / dt) for f in np.geomspace(0.03, 0.4, 24)]
    grid += [("load_change", i) for i in range(runs)]
    grid += [("backlash", reach_um * s) for s in (0.002, 0.006, 0.02)]
    grid += [("hum", f) for f in (50.0, 60.0)] + [("ageing", 0), ("ageing", 1)]
    grid += [("thermal_drift", tau) for tau in (0.3, 3.0, 30.0)]
    return grid + ([("cross_coupling", 0)] if aux else [])


def column(name: str, p: float, run: dict, y: np.ndarray, index: int) -> np.ndarray:
    """What the effect would add to the smooth output `y` of the nominal stage: one column or several."""
    dt, u, t, n = run["dt"], run["input_v"], run["time_s"] - run["time_s"][0], y.size
    loop = y - u * np.ptp(y) / max(np.ptp(u), 1e-12)
    if name == "delay":
        shift = round(p / dt)
        return (np.concatenate([np.zeros(shift), y[:-shift]]) - y)[:, None]
    if name in ("amplifier_lag", "creep"):
        a = 1 - math.exp(-dt * 2 * math.pi * p) if name == "amplifier_lag" else 1 - math.exp(-dt / p)
        return (lfilter([a], [1, a - 1], y) - (y if name == "amplifier_lag" else 0))[:, None]
    if name == "slew_limit":
        out, v, most = np.empty(n), 0.0, p * dt
        for k, goal in enumerate(u.tolist()):
            v += min(max(goal - v, -most), most)
            out[k] = v
        return (out - u)[:, None]
    if name == "backlash":
        out, x = np.empty(n), 0.0
        for k, goal in enumerate(y.tolist()):
            x = min(max(x, goal - p / 2), goal + p / 2)
            out[k] = x
        return (out - y)[:, None]
    if name == "resonance":
        w, zeta = 2 * math.pi * p, 0.02
        pole = np.exp(dt * w * complex(-zeta, math.sqrt(1 - zeta**2)))
        denominator = [1, -2 * pole.real, abs(pole) ** 2]
        return (lfilter([sum(denominator)], denominator, y) - y)[:, None]
    if name == "hum":
        return _own(index, np.column_stack([np.sin(2 * math.pi * p * t), np.cos(2 * math.pi * p * t)]))
    if name == "thermal_drift":
        return _own(index, (1 - np.exp(-t / p))[:, None])
    rate = np.abs(lfilter([0.2], [1, -0.8], np.gradient(u, dt)))
    return {
        "voltage_saturation": lambda: np.minimum(u, p) - u,
        "hysteresis_operator": lambda: (u**2, u * loop, y**3)[int(p) - 1],
        "rate_dependent_hysteresis": lambda: loop * np.log1p(rate / p),
        "load_change": lambda: y * (index == p),
        "ageing": lambda: y * (t if p == 0 else np.cumsum(np.abs(np.gradient(y)))),
        "cross_coupling": lambda: run["aux_v"],
    }[name]()[:, None]


def _own(index: int, columns: np.ndarray) -> np.ndarray:
    """Give each recording columns of its own, zero in all others; a new recording (-1) has none."""
    out = np.zeros((len(columns), RECORDINGS * columns.shape[1]))
    if 0 <= index < RECORDINGS:
        out[:, index * columns.shape[1] : (index + 1) * columns.shape[1]] = columns
    return out


def ridge(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Least squares with slight damping, since neighbouring plays are nearly collinear."""
    gram = x.T @ x
    scale = np.sqrt(np.diag(gram)) + 1e-12
    damped = gram / np.outer(scale, scale) + 1e-8 * np.eye(len(gram))
    right = (x.T @ y) / (scale if y.ndim == 1 else scale[:, None])
    return (np.linalg.solve(damped, right).T / scale).T


def errors_of(x: np.ndarray, y: np.ndarray, train: np.ndarray) -> tuple[float, float, float]:
    """Train rms, held-out rms and held-out largest error."""
    e = y - x @ ridge(x[train], y[train])
    return float(e[train].std()), float(np.sqrt(np.mean(e[~train] ** 2))), float(np.max(np.abs(e[~train])))


def fit_on_top(base: np.ndarray, c: np.ndarray, y: np.ndarray, train: np.ndarray) -> tuple[float, float]:
    """Train and held-out rms with the column added and everything refitted."""
    return errors_of(np.column_stack([base, c]), y, train)[:2]


if __name__ == "__main__":
    command_line(__doc__, diagnose, predict)
