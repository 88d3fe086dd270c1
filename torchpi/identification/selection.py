"""Select by cross-validation the form of the direct inverse that the records support, simple by default.

The start is a least-squares fit on play features: S(y) = y, rate-independent weights, an offset. Extensions
are tried one after another, and the best is accepted as long as it lowers the error on what each fit has left
out: the mean of log(error) over the folds by more than `LEAST` plus one standard error, and the pooled error
too. If no extension does, the start is kept.

Creep, the degree of S and the width of the plays can compensate for one another, so that each alone may lower
nothing: they are also tried in combination.

If the slowest of several records repeats itself, it has the weight of one repetition (`repetitions`), also
when it judges a look-ahead: its loops hardly distinguish a lag from the effect of creep and wider plays.

An extension that the records cannot judge is not tried. A single record has no other motion to be judged on:
creep and rate-dependent weights would fit the shape of its loops and fail on others. Its look-ahead is
determined at its reversals (`reversals`), because errors over its blocks do not reveal it. Nor do they reveal
how S bends: the loops of plays are point-symmetric, so one loop shows the even part of S, while plays with
other thresholds can imitate the odd part. The blocks do show whether S bends at all. If it does, the even
part alone would be wrong for every other loop, so S gets the highest degree and a ridge on all its bending
coefficients. The widest plays move only in the first loading, a small part of the record: the position of
their thresholds changes the error on other loops by half and more, in either direction, and no fold reveals
it. The last fit is therefore the mean over several grids, whose error is on the whole smaller than that of
one (model averaging; Breiman 1996). If the first loading is not among the counted samples, thresholds beyond
half of the range fit only the offset, and one grid without them is used.

The mean also covers the case in which it is not clear whether S bends. Without the slow or the fast samples,
plays that move only there are undetermined, and any smooth S bridges the gap; the blocks leave no gap, but
are much alike. If the blocks by themselves, at two standard errors, contradict the selection, half of the
mean is straight and half is bent.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain, product
from typing import Literal

import numpy as np
import torch

from torchpi.control.direct_inverse import DirectInverse
from torchpi.identification.folds import BLOCKS, Fold, make_folds
from torchpi.identification.grid_average import average_over_grids, shows_first_loading
from torchpi.identification.levenberg_marquardt import levenberg_marquardt
from torchpi.identification.monotone_problem import MonotoneProblem
from torchpi.identification.pair import InversePair
from torchpi.identification.projected_problem import Solved
from torchpi.identification.repetitions import weighted_by_repetitions
from torchpi.identification.reversals import lag_at_reversals

LEAST = 0.02  # least relative reduction of the error
# Widest threshold as a share of the range; at half of the range, it would only move in the first loading. The
# start has the first value.
SPREADS = (0.45, 0.3)
# Widest thresholds of the grids over which the last fit to a single record is averaged. On a grid that is too
# narrow, a polynomial bends in place of the wide plays.
GRIDS = {"straight": (0.3, 0.4, 0.5, 0.6, 0.7), "bent": (0.45, 0.6)}
MOST_STEPS = 8
ROWS, ROWS_AT_LAST = 4_000, 20_000  # rows of a fit to a fold, and of the last fit
EVALUATIONS = 30
TOLERANCE = 1e-3
# In a single record, coefficients that bend S by as much as it rises must explain a third of the error.
STIFFNESS = 0.3
BENT = 2  # lowest degree of a polynomial that bends
# Least contribution of the acceleration, as a share of the rms displacement: below it a single record does
# not reach the mode, and τ_2 would fit the curvature of its loops.
LEAST_INERTIA = 0.2
ALL = slice(None)
PREVIEW_RISING = 3  # samples beyond the best to try: the error has a single minimum over the look-ahead

Pairs = Callable[[int], Sequence[InversePair]]


@dataclass(frozen=True)
class Form:
    """A form of the inverse, as options of `DirectInverse`.

    Attributes:
        preview: Samples of look-ahead.
        spread: The largest threshold, as a share of the displacement between its 1 % and 99 % quantiles.
        degree: Degree of S.
        lead: Order of the lead.
        creep_time_constants_s: Time constants of the relaxations.
        rate: Whether the weights depend on the rate.
        offset: Whether a constant voltage is learned.
    """

    preview: int = 0
    spread: float = SPREADS[0]
    degree: int = 1
    lead: Literal[0, 1, 2] = 0
    creep_time_constants_s: tuple[float, ...] = ()
    rate: Literal["none", "linear"] = "none"
    offset: bool = True

    def __str__(self) -> str:
        creep = ", ".join(f"{tau:g}" for tau in self.creep_time_constants_s)
        return (
            f"preview {self.preview}, degree {self.degree}, lead {self.lead}, creep [{creep}] s, "
            f"rate {self.rate}, {'an' if self.offset else 'no'} offset, "
            f"thresholds to {100 * self.spread:g} % of the range"
        )


@dataclass(frozen=True)
class Richest:
    """Limits of the forms that may be selected.

    Attributes:
        previews: Samples of look-ahead, ascending.
        degree: Highest degree of S.
        lead: Highest order of the lead.
        creep_time_constants_s: Time constants; those longer than half of the longest record are left out.
        rate: Whether the weights may depend on the rate.
        spreads: Values of `Form.spread`; the start has the first.
    """

    previews: range
    degree: int
    lead: Literal[0, 1, 2]
    creep_time_constants_s: tuple[float, ...]
    rate: bool
    spreads: tuple[float, ...] = SPREADS


@dataclass(frozen=True)
class Step:
    """One form accepted on the way, with its cross-validated error, V rms."""

    form: Form
    rms_v: float


@dataclass(frozen=True)
class Selection:
    """The selected compensator, fitted to all records, and the steps of the selection, the start first.

    The form of the last step is that of the compensator.
    """

    compensator: DirectInverse
    steps: tuple[Step, ...]


@dataclass(frozen=True)
class _Trial:
    """A form fitted to each fold, with the mean square error on what the fold left out, V²."""

    form: Form
    fitted: list[DirectInverse]
    left: np.ndarray  # (folds,)

    def beats(self, other: "_Trial", judges: slice = ALL, standard_errors: float = 1.0) -> float | None:
        """Return the mean log(error ratio) over these folds if it is significantly negative, else None."""
        mine, theirs = self.left[judges], other.left[judges]
        if mine.mean() >= theirs.mean():
            return None
        ratios = 0.5 * np.log(mine / theirs)
        standard_error = float(ratios.std(ddof=1)) / np.sqrt(len(ratios))
        mean = float(ratios.mean())
        return mean if mean + standard_errors * standard_error < np.log1p(-LEAST) else None


def select_form(
    build: Callable[[Form, Sequence[InversePair]], DirectInverse],
    pairs_seen_ahead: Pairs,
    richest: Richest,
) -> Selection:
    """Select the form that generalises best over the records and fit it to all; it cannot run backwards.

    Args:
        build: Function that returns an unfitted compensator of a form.
        pairs_seen_ahead: Function that returns the records to fit for a number of samples of look-ahead.
        richest: Limits of the forms that may be selected.
    """
    search = _Search(build, pairs_seen_ahead, richest)
    start = search.tried(Form(richest.previews[0], richest.spreads[0]))
    # A bent loop shifts the apparent lag, so the look-ahead is sought with a polynomial that can bend.
    bent = replace(start.form, degree=min(richest.degree, BENT))
    current = search.tried(replace(start.form, preview=search.preview(bent)))
    steps = [start, current] if current.form != start.form else [start]
    for _ in range(MOST_STEPS):
        better = search.best_beyond(current)
        if better is None:
            break
        current = better
        steps.append(current)
    # The blocks of a single record cannot judge a look-ahead that was found at its reversals.
    if search.lag is None and current.left.mean() > start.left.mean():
        steps = [start]
    form, compensator = search.fitted(steps[-1].form)
    forms = [*(one.form for one in steps[:-1]), form]
    left = [float(one.left.mean() ** 0.5) for one in steps]
    return Selection(compensator, tuple(Step(*one) for one in zip(forms, left, strict=True)))


class _Search:
    def __init__(
        self,
        build: Callable[[Form, Sequence[InversePair]], DirectInverse],
        pairs_seen_ahead: Pairs,
        richest: Richest,
    ) -> None:
        self.build, self.richest = build, richest
        self.pairs_seen_ahead = pairs_seen_ahead
        self.records: dict[int, tuple[Sequence[InversePair], list[Fold]]] = {}
        pairs, _ = self.at(richest.previews[0])
        self.single = len(pairs) == 1
        self.stiffness = STIFFNESS if self.single else 0.0
        more = len(richest.previews) - 1  # samples, beyond the first
        self.lag = lag_at_reversals(pairs[0], more) if self.single and more else None
        longest_s = max(pair.u.shape[1] * pair.sample_period_s for pair in pairs)
        period_s = pairs[0].sample_period_s
        self.creep = tuple(
            tau for tau in richest.creep_time_constants_s if 5 * period_s < tau < 0.5 * longest_s
        )

    def at(self, preview: int) -> tuple[Sequence[InversePair], list[Fold]]:
        """Return the records with this look-ahead, and their folds."""
        if preview not in self.records:
            pairs = weighted_by_repetitions(self.pairs_seen_ahead(preview))
            self.records[preview] = pairs, make_folds(pairs)
        return self.records[preview]

    def tried(self, form: Form, start: "_Trial | None" = None) -> _Trial:
        """Fit the form on every fold, each time from the fit of `start` to the same fold."""
        pairs, folds = self.at(form.preview)
        fitted, left = [], []
        for i, fold in enumerate(folds):
            compensator = self.build(form, pairs)
            if start:
                _begin_from(compensator, start.fitted[i])
            _fit(compensator, pairs, fold.fitted, ROWS, self.stiffness)
            fitted.append(compensator)
            left.append(_mean_square(compensator, pairs, fold.judged))
        return _Trial(form, fitted, np.array(left))

    def preview(self, form: Form) -> int:
        """Return the look-ahead with which this form generalises best.

        The loops of a single record hardly reveal a lag, but its reversals do. Creep only adds to the lag
        there, and less in faster motion, so the result is the mean less its standard error, rounded down to
        samples. With too few reversals, it is the shortest look-ahead within one standard error of the best.
        The slow and the fast samples are no folds here, because a lag shows where both are together.
        """
        if self.lag is not None:
            whole = int(self.lag.mean - self.lag.standard_error)
            return self.richest.previews[max(0, min(whole, len(self.richest.previews) - 1))]
        judges = slice(BLOCKS if self.single else None)
        weights = self.weights(form.preview)[judges]
        found: dict[int, np.ndarray] = {}
        best = form.preview
        for preview in self.richest.previews:
            trial = self.tried(replace(form, preview=preview))
            found[preview] = 0.5 * np.log(trial.left[judges])
            if np.average(found[preview] - found[best], weights=weights) < 0:
                best = preview
            elif preview == best + PREVIEW_RISING:
                break
        if not self.single:
            return best
        for preview, errors in found.items():
            excess = errors - found[best]
            if excess.mean() <= excess.std(ddof=1) / np.sqrt(len(excess)):
                return preview
        return best

    def weights(self, preview: int) -> list[float]:
        """Return the weights of the folds: those of the records that they judge."""
        pairs, folds = self.at(preview)
        return [
            sum(pair.weight for pair, judged in zip(pairs, fold.judged, strict=True) if len(judged) > 0)
            for fold in folds
        ]

    def best_beyond(self, current: _Trial) -> _Trial | None:
        """Return the neighbouring form that beats the current one by most, or None."""
        best, gained = None, 0.0
        for form in chain(self.neighbours(current.form), self.together(current.form)):
            trial = self.tried(form, current)
            gain = trial.beats(current)
            if gain is not None and gain < gained and self.reaches_the_mode(trial):
                best, gained = trial, gain
        if best and self.single and best.form.degree >= BENT:
            best = self.tried(replace(best.form, degree=self.richest.degree), current)
        return best

    def neighbours(self, form: Form) -> Iterator[Form]:
        """Yield forms that differ in one respect and that these records can judge."""
        if not self.single or form.degree == 1:
            degrees = range(1, self.richest.degree + 1)
            yield from (replace(form, degree=d) for d in degrees if d != form.degree)
        # A lead takes over part of the look-ahead.
        ahead = {p for p in (0, 1, 2, form.preview) if p in self.richest.previews}
        if self.richest.lead == 2 and form.lead != 2:
            yield from (replace(form, lead=2, preview=p) for p in sorted(ahead))
        if self.single:
            return
        if self.richest.lead >= 1 and form.lead != 1:
            yield replace(form, lead=1)
        if form.lead != 0:
            yield replace(form, lead=0)
        for creep in dict.fromkeys(((), self.creep, self.creep[1:], self.creep[:-1])):
            if creep != form.creep_time_constants_s:
                yield replace(form, creep_time_constants_s=creep)
        if self.richest.rate:
            yield replace(form, rate="linear" if form.rate == "none" else "none")
        yield replace(form, offset=not form.offset)
        yield from (replace(form, spread=s) for s in self.richest.spreads if s != form.spread)

    def together(self, form: Form) -> Iterator[Form]:
        """Yield forms that differ in more than one respect: each change alone may show no effect."""
        if self.single:
            return
        degrees = dict.fromkeys((form.degree, self.richest.degree))
        creeps = dict.fromkeys((form.creep_time_constants_s, self.creep, self.creep[1:], self.creep[:-1]))
        for degree, creep, spread in product(degrees, creeps, self.richest.spreads):
            changes = degree != form.degree, creep != form.creep_time_constants_s, spread != form.spread
            if sum(changes) > 1:
                yield replace(form, degree=degree, creep_time_constants_s=creep, spread=spread)

    def reaches_the_mode(self, trial: _Trial) -> bool:
        """Whether a single record supports a lead of order 2; with several records, the folds decide."""
        if trial.form.lead < 2 or not self.single:
            return True
        pairs, _ = self.at(trial.form.preview)
        added = torch.cat([pair.motion.yd_ddot[0, pair.counted] for pair in pairs]).std()
        moved = torch.cat([pair.motion.yd[0, pair.counted] for pair in pairs]).std()
        return all(float((one.lead[1] * added / moved).detach()) > LEAST_INERTIA for one in trial.fitted)

    def fitted(self, form: Form) -> tuple[Form, DirectInverse]:
        """Fit a compensator of this form to all records; return the form that it has in the end, and it.

        For a single record that shows its first loading, it is the mean over `GRIDS`, with the thresholds of
        the widest grid; where it is not clear whether S bends, it is the mean over straight and bent fits.
        """
        pairs, _ = self.at(form.preview)
        given = len(self.richest.spreads) == 1
        if not self.single or given or not shows_first_loading(pairs[0], form.spread):
            compensator = self.build(form, pairs)
            _fit(compensator, pairs, None, ROWS_AT_LAST, self.stiffness)
            return form, compensator
        degrees = sorted({form.degree, self.degree_of_blocks(form)})
        grids = GRIDS["straight" if degrees == [1] else "bent"]
        forms = [replace(form, degree=degree, spread=spread) for degree in degrees for spread in grids]
        problems = [
            _problem(self.build(one, pairs), pairs, None, ROWS_AT_LAST, self.stiffness) for one in forms
        ]
        alphas = [_solved(problem)[0] for problem in problems]
        return forms[-1], average_over_grids(problems[-len(grids) :], alphas)

    def degree_of_blocks(self, form: Form) -> int:
        """Return the degree of S that the blocks of the single record favour by themselves."""
        straight, bent = (self.tried(replace(form, degree=degree)) for degree in (1, self.richest.degree))
        return 1 if bent.beats(straight, slice(BLOCKS), 2.0) is None else self.richest.degree


def _fit(
    compensator: DirectInverse,
    pairs: Sequence[InversePair],
    rows: Sequence[np.ndarray] | None,
    most: int,
    stiffness: float,
) -> None:
    problem = _problem(compensator, pairs, rows, most, stiffness)
    alpha, solved = _solved(problem)
    problem.put(alpha, solved.beta)


def _problem(
    compensator: DirectInverse,
    pairs: Sequence[InversePair],
    rows: Sequence[np.ndarray] | None,
    most: int,
    stiffness: float,
) -> MonotoneProblem:
    return MonotoneProblem(compensator, pairs, rows).thinned(most).stiffened(stiffness)


def _solved(problem: MonotoneProblem) -> tuple[np.ndarray, Solved]:
    return levenberg_marquardt(problem, problem.alpha, EVALUATIONS, TOLERANCE)


def _begin_from(compensator: DirectInverse, other: DirectInverse) -> None:
    """Copy lead, creep gains and polynomial from `other`, as far as both have them."""
    with torch.no_grad():
        for name in ("scaled_lead", "saturation.scaled"):
            mine, theirs = compensator.get_parameter(name), other.get_parameter(name)
            common = min(len(mine), len(theirs))
            mine[:common] = theirs[:common]
        times = [one.hyper_parameters["creep_time_constants_s"] for one in (compensator, other)]
        for i, tau in enumerate(times[0]):
            if tau in times[1]:
                compensator.creep_gains[i] = other.creep_gains[times[1].index(tau)]


def _mean_square(
    compensator: DirectInverse, pairs: Sequence[InversePair], judged: Sequence[np.ndarray]
) -> float:
    """Return the mean square error over these samples, V², before the output limits."""
    errors = []
    for pair, rows in zip(pairs, judged, strict=True):
        if len(rows) > 0:
            with torch.no_grad():
                u, _ = compensator.voltage(pair.motion)
            errors.append((u - pair.u)[0, torch.from_numpy(rows)])
    return max(float(torch.cat(errors).square().mean()), np.finfo(float).tiny)
