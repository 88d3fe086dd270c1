"""Find where the plays fail and which term is missing there, and test it on samples not used for the choice.

    python -m concealed.rivals.lisdd diagnose a.csv b.csv c.csv --output DIR
    python -m concealed.rivals.lisdd predict DIR/stage.json heldout_input.csv --output prediction.csv

Wang, *Where Is My Physics Wrong? Localized and Identifiable Discovery of Model Discrepancy* (LISDD), arXiv
2606.23215, 2026: the known physics is fitted where it holds; regimes in which its residual has too much
energy are flagged; the missing term is the one of a library that predicts them best; an F-test on other
samples confirms it. Only the abstract and summaries of the paper were at hand; what they leave open is chosen
here: regimes are quarters of the voltage's range by quarters of the rate's distribution; the quarter of them
with the least energy is clean; the statistic is χ² against that energy, over every tenth row, because
neighbours correlate; false discoveries are limited as by Benjamini and Hochberg (1995); the library is the
baseline's. The first half of each recording is fitted, the next fifth selects, the rest tests. As with the
other rivals the error has to fall by 3 %, since with so many samples an F-test alone confirms anything.
"""

from pathlib import Path

import numpy as np
from concealed.rivals.baseline import HELD, errors_of, library_of, predict, ridge, write_answer
from concealed.rivals.contract import Run, command_line
from scipy.stats import chi2, f

FIT = 0.5
"""Share of each recording that is fitted; the samples from there to `HELD` select the term."""
QUARTERS = np.array([0.25, 0.5, 0.75])
CLEAN = 0.25
"""Share of the regimes taken as clean: those with the least energy."""
INDEPENDENT = 10
"""One row in this many is taken as independent of the others."""
DISCOVERIES = 0.05
"""Largest share of false discoveries among those made."""
GAIN = 0.97
TERMS = 3


def diagnose(runs: list[Run], output: Path) -> None:
    """Write diagnosis.json and stage.json into `output`."""
    library = library_of(runs)
    y, place, grid, columns = library.y, library.place, library.grid, library.columns
    fits, tests = place < FIT, place >= HELD
    chooses = ~fits & ~tests
    regime = regimes(library.input_v, np.abs(library.rate_v_s))
    base, found, starts = library.plays, [], []
    errors = [errors_of(base, y, place < HELD)]
    while len(found) < TERMS:
        flagged = discrepant(base, y, fits, regime)
        if not (flagged & chooses).any() or not (flagged & tests).any():
            break
        left = [held_out(np.column_stack([base, c]), y, fits, flagged & chooses) for c in columns]
        best = int(np.argmin(left))
        longer = np.column_stack([base, columns[best]])
        if not confirmed(base, longer, y, place < HELD, flagged & tests):
            break
        found.append(grid[best])
        starts.append(base.shape[1])
        base = longer
        errors.append(errors_of(base, y, place < HELD))
        keep = [i for i, (name, _) in enumerate(grid) if name != grid[best][0]]
        grid, columns = [grid[i] for i in keep], [columns[i] for i in keep]
    write_answer(output, library, found, starts, ridge(base[place < HELD], y[place < HELD]), errors)


def regimes(input_v: np.ndarray, speed: np.ndarray) -> np.ndarray:
    """Return the regime of each row, (rows,)."""
    level = np.searchsorted(np.min(input_v) + QUARTERS * np.ptp(input_v), input_v)
    return 4 * level + np.searchsorted(np.quantile(speed, QUARTERS), speed)


def discrepant(base: np.ndarray, y: np.ndarray, fits: np.ndarray, regime: np.ndarray) -> np.ndarray:
    """(rows,): whether a row lies in a regime in which the fit to the clean regimes fails."""
    clean = fits
    for _ in range(2):
        e = y - base @ ridge(base[clean], y[clean])
        energy = np.array([np.mean(e[fits & (regime == k)] ** 2) for k in np.unique(regime[fits])])
        least = np.unique(regime[fits])[np.argsort(energy)[: max(1, round(CLEAN * len(energy)))]]
        clean = fits & np.isin(regime, least)
    noise = np.mean(e[clean] ** 2)
    rest = np.setdiff1d(regime[fits], least)
    p = []
    for k in rest:
        e_there = e[fits & (regime == k)][::INDEPENDENT]
        p.append(chi2.sf(np.sum(e_there**2) / noise, len(e_there)))
    return np.isin(regime, rest[discoveries(np.array(p))])


def discoveries(p: np.ndarray) -> np.ndarray:
    """(tests,): which of them are discoveries, by Benjamini and Hochberg's step-up procedure."""
    order = np.argsort(p)
    below = np.flatnonzero(p[order] <= DISCOVERIES * np.arange(1, len(p) + 1) / max(len(p), 1))
    found = np.zeros(len(p), dtype=bool)
    found[order[: below[-1] + 1 if len(below) else 0]] = True
    return found


def held_out(x: np.ndarray, y: np.ndarray, fits: np.ndarray, there: np.ndarray) -> float:
    """Rms error in the rows `there` of a fit to the rows `fits`."""
    return float(np.sqrt(np.mean((y - x @ ridge(x[fits], y[fits]))[there] ** 2)))


def confirmed(
    base: np.ndarray, longer: np.ndarray, y: np.ndarray, fits: np.ndarray, tests: np.ndarray
) -> bool:
    """Whether an F-test on other samples, and the error in them, confirm the last columns."""
    if held_out(longer, y, fits, tests) > GAIN * held_out(base, y, fits, tests):
        return False
    # Test whether the columns explain a part of the residual that the fit without them leaves there.
    e = (y - base @ ridge(base[fits], y[fits]))[tests][::INDEPENDENT]
    added = longer[:, base.shape[1] :][tests][::INDEPENDENT]
    moves = added[:, added.any(axis=0)]
    k, n = moves.shape[1], len(e)
    if k == 0 or n <= k:
        return False
    after = float(np.sum((e - moves @ ridge(moves, e)) ** 2))
    statistic = (float(e @ e) - after) / k / (after / (n - k))
    return bool(f.sf(statistic, k, n - k) < DISCOVERIES)


if __name__ == "__main__":
    command_line(__doc__, diagnose, predict)
