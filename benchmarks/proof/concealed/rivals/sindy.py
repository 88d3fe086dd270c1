"""A sparse discrepancy model: the residual of forty plays, explained by as few library terms as possible.

    python -m concealed.rivals.sindy diagnose a.csv b.csv c.csv --output DIR
    python -m concealed.rivals.sindy predict DIR/stage.json heldout_input.csv --output prediction.csv

Kaheman, Kaiser, Strom, Kutz and Brunton, *Learning discrepancy models from experimental data*, 2019:
sequentially thresholded least squares (Brunton, Proctor and Kutz, *Discovering governing equations from
data by sparse identification*, PNAS 113, 2016), as in pysindy's STLSQ, but written here so that nothing has
to be installed. Each term stands for the effect that it approximates to first order. The threshold is the one
of twelve that predicts the held-out 30 % of each recording best; an effect is named if its terms lower that
error by 3 %.
"""

from pathlib import Path

import numpy as np
from concealed.rivals.baseline import HELD, errors_of, nominal, ridge
from concealed.rivals.contract import MOST, Run, command_line, named, write_diagnosis
from scipy.signal import lfilter

THRESHOLDS = np.geomspace(0.003, 0.5, 12)  # in units of the rms residual of the plays
GAIN = 0.97


def terms(run: Run, y: np.ndarray) -> list[tuple[str, np.ndarray]]:
    """Return the library: each term with the name of the effect that it approximates to first order."""
    dt, u, t = float(run["dt"]), run["input_v"], run["time_s"] - run["time_s"][0]
    rate = np.gradient(u) / dt
    smooth = lfilter([0.2], [1, -0.8], rate)
    loop = y - u * np.ptp(y) / max(np.ptp(u), 1e-12)
    slow = [
        (tau, lfilter([-np.expm1(-dt / tau)], [1, -np.exp(-dt / tau)], y)) for tau in (0.01, 0.1, 1.0, 10.0)
    ]
    out = [
        ("input_nonlinearity", u**2),
        ("input_nonlinearity", u**3),
        ("sensor_nonlinearity", y**2),
        ("sensor_nonlinearity", y**3),
        ("incongruent_loops", u * loop),
        ("rate_dependent_hysteresis", loop * np.log1p(np.abs(smooth))),
        ("amplifier_lag", np.gradient(y)),
        ("resonance", np.gradient(np.gradient(y))),
        ("slew_limit", smooth * np.abs(smooth)),
        ("backlash", np.sign(smooth)),
        ("thermal_drift", t),
        ("thermal_drift", np.sqrt(t)),
        ("ageing", t * y),
        *(("creep", state) for _, state in slow),
    ]
    for hz in (50.0, 60.0):
        out += [("hum", np.sin(2 * np.pi * hz * t)), ("hum", np.cos(2 * np.pi * hz * t))]
    return out + [("cross_coupling", run[name]) for name in run if name.startswith("aux")]


def diagnose(runs: list[Run], output: Path) -> None:
    """Write diagnosis.json and stage.json into `output`."""
    every = max(sum(run["time_s"].size for run in runs) // MOST, 1)
    span = max(float(np.max(np.abs(run["input_v"]))) for run in runs)
    plays = [nominal(run, span) for run in runs]
    train = np.concatenate([(np.arange(p.shape[0]) < HELD * p.shape[0])[::every] for p in plays])
    base, y = (
        np.concatenate([a[::every] for a in arrays]) for arrays in (plays, [run["output_um"] for run in runs])
    )
    weights = ridge(base[train], y[train])
    library = [terms(run, p @ weights) for run, p in zip(runs, plays, strict=True)]
    effects = [name for name, _ in library[0]]
    table = np.concatenate([np.column_stack([c for _, c in terms])[::every] for terms in library])
    scale = table[train].std(axis=0) + 1e-12
    left = y - base @ weights
    best = min((_sparse(table / scale, left, train, s) for s in THRESHOLDS), key=lambda found: found[0])
    coefficients = best[1] / scale
    plain = errors_of(base, y, train)
    whole = np.sqrt(np.mean((left - table @ coefficients)[~train] ** 2))
    names = []
    for name in dict.fromkeys(effects):
        without = np.where([e == name for e in effects], 0.0, coefficients)
        if GAIN * np.sqrt(np.mean((left - table @ without)[~train] ** 2)) > whole:
            names.append(name)
    error = (left - table @ coefficients)[~train]
    errors = [plain, (plain[0], float(whole), float(np.max(np.abs(error))))]
    stage = {"span": span, "plays": weights.tolist(), "terms": coefficients.tolist()}
    write_diagnosis(output, [named(name, len(names)) for name in names], errors, stage)


def _sparse(x: np.ndarray, y: np.ndarray, train: np.ndarray, share: float) -> tuple[float, np.ndarray]:
    """Held-out rms and coefficients of sequentially thresholded least squares."""
    keep, coefficients = np.ones(x.shape[1], dtype=bool), np.zeros(x.shape[1])
    for _ in range(20):
        coefficients = np.zeros(x.shape[1])
        if not keep.any():
            break
        coefficients[keep] = ridge(x[train][:, keep], y[train])
        large = np.abs(coefficients) > share * y[train].std()
        if np.array_equal(large, keep):
            break
        keep = large
    return float(np.sqrt(np.mean((y - x @ coefficients)[~train] ** 2))), coefficients


def predict(stage: dict, run: Run) -> np.ndarray:
    """Return the stage's response to an input, without hum, whose phase on another day is unknown."""
    y = nominal(run, stage["span"]) @ np.array(stage["plays"])
    library = [0 * column if name == "hum" else column for name, column in terms(run, y)]
    return y + np.column_stack(library) @ np.array(stage["terms"])


if __name__ == "__main__":
    command_line(__doc__, diagnose, predict)
