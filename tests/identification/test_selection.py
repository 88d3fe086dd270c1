"""The selected form generalises, and is no richer than the records support."""

from collections.abc import Sequence
from dataclasses import astuple
from typing import Any

import numpy as np
import pytest
import torch

from tests.identification.test_fits import PERIOD, THRESHOLDS, pairs, truth
from torchpi.control.direct_inverse import DirectInverse
from torchpi.diagnosis.locate import turning_points
from torchpi.identification import InversePair, selection
from torchpi.identification.folds import make_folds
from torchpi.identification.selection import Form, Richest, Selection, _Search, _Trial, select_form
from torchpi.operators.motion import Motion

RICHEST = Richest(range(4), degree=4, lead=2, creep_time_constants_s=(0.05,), rate=True)


def build(form: Form, _: Sequence[InversePair]) -> DirectInverse:
    options: dict[str, Any] = {name: value for name, value in vars(form).items() if name != "spread"}
    return DirectInverse(PERIOD, THRESHOLDS, range_um=4.0, rate_scale_um_s=100.0, **options)


def select(records: Sequence[InversePair], richest: Richest = RICHEST) -> Selection:
    def ahead(preview: int) -> list[InversePair]:
        return [
            record._replace(
                motion=Motion(*(part[:, preview:] for part in record.motion)),
                u=record.u[:, : record.u.shape[1] - preview],
            )
            for record in records
        ]

    return select_form(build, ahead, richest)


def made(**more: Any) -> DirectInverse:
    """Return plays of the displacement with only the given additions."""
    inverse = truth(**more)
    inverse.saturation.set_coefficients(torch.tensor([1.0, 0.0], dtype=torch.float64))
    return inverse


def heldout_rms_v(selection: Selection, record: InversePair) -> float:
    with torch.no_grad():
        error = (selection.compensator.voltage(record.motion)[0] - record.u)[:, record.counted]
    return float(error.square().mean().sqrt())


def test_the_initial_form_is_kept_if_no_other_generalises_better() -> None:
    records = pairs(made(rate="none"), (1500, 1200, 1800), noise_v=0.02)
    selection = select(records)
    assert selection.steps[-1].form == Form(offset=selection.steps[-1].form.offset)
    assert selection.steps[0].form == Form()


def test_a_nonlinear_polynomial_is_selected_and_halves_the_error() -> None:
    inverse = truth(rate="none")
    inverse.saturation.set_coefficients(torch.tensor([1.2, -0.06], dtype=torch.float64))
    *records, judge = pairs(inverse, (1500, 1200, 1800, 1500), noise_v=0.01)
    selection = select(records)
    assert selection.steps[-1].form.degree >= 2
    assert selection.steps[-1].rms_v < 0.5 * selection.steps[0].rms_v
    assert heldout_rms_v(selection, judge) < 0.03


def test_creep_is_selected_from_several_records_but_not_from_one() -> None:
    inverse = made(rate="none", creep_time_constants_s=[0.05])
    with torch.no_grad():
        inverse.creep_gains.fill_(0.15)
    records = pairs(inverse, (1500, 1200, 1800), noise_v=0.01)
    found = select(records).steps[-1].form
    assert found.creep_time_constants_s == (0.05,)
    alone = select(records[:1]).steps[-1].form
    assert (alone.creep_time_constants_s, alone.rate) == ((), "none") and alone.degree in (1, 4)


def test_extensions_are_tried_together_only_with_several_records() -> None:
    search = _Search(build, lambda _: pairs(made(rate="none"), (300, 300)), RICHEST)
    together = list(search.together(Form()))
    assert Form(degree=4, creep_time_constants_s=(0.05,), spread=0.3) in together
    changes = [
        sum(mine != plain for mine, plain in zip(astuple(form), astuple(Form()), strict=True))
        for form in together
    ]
    assert min(changes) == 2 and len(set(together)) == len(together)
    alone = _Search(build, lambda _: pairs(made(rate="none"), (300,)), RICHEST)
    assert not list(alone.together(Form()))


def test_a_repeated_slow_loop_does_not_outweigh_motions_with_many_turning_points() -> None:
    """The form cannot represent this law; a loop of full weight would be fitted at the others' expense."""
    bent = made(rate="none")
    bent.saturation.set_coefficients(torch.tensor([1.2, -0.05], dtype=torch.float64))
    t = PERIOD * np.arange(6000)
    y, rate, bend = (
        2 - 2 * np.cos(2 * np.pi * t),
        4 * np.pi * np.sin(2 * np.pi * t),
        8 * np.pi**2 * np.cos(2 * np.pi * t),
    )
    loop = Motion(*(torch.from_numpy(part)[None] for part in (y, rate, bend)))
    with torch.no_grad():
        slow = InversePair("slow", loop, bent.voltage(loop)[0], slice(50, None), PERIOD)
    fast, judge = pairs(bent, (1500, 1500), noise_v=0.02)
    plain = Richest(range(1), degree=1, lead=0, creep_time_constants_s=(), rate=False)
    once = select([slow, fast], plain)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(selection, "weighted_by_repetitions", list)
        by_heart = select([slow, fast], plain)
    assert heldout_rms_v(by_heart, slow) < heldout_rms_v(once, slow)
    assert heldout_rms_v(once, judge) < 0.95 * heldout_rms_v(by_heart, judge)


def test_one_record_selects_only_between_degree_1_and_the_highest_degree() -> None:
    bent = truth(rate="none")
    bent.saturation.set_coefficients(torch.tensor([1.2, -0.06], dtype=torch.float64))
    found = {
        degree: select(pairs(inverse, (1500,), noise_v=0.01)).steps[-1].form.degree
        for degree, inverse in ((1, made(rate="none")), (4, bent))
    }
    assert found == {1: 1, 4: 4}


def test_the_first_loading_of_a_single_record_is_fitted_in_every_fold() -> None:
    [record] = pairs(made(), (1500,))
    first = int(turning_points(record.u[0].numpy(), 0.1 * float(np.ptp(record.u.numpy())))[1:][0])
    record = record._replace(counted=slice(first - 20, None))
    for fold in make_folds([record]):
        assert fold.judged[0].min() >= first
        assert np.isin(np.arange(first - 20, first), fold.fitted[0]).all()


def test_the_preview_for_a_delayed_stage_is_found() -> None:
    records = [
        record._replace(
            motion=Motion(*(torch.nn.functional.pad(part, (2, 0))[:, :-2] for part in record.motion))
        )
        for record in pairs(made(rate="none"), (1500, 1200, 1800), noise_v=0.005)
    ]
    assert select(records).steps[-1].form.preview == 2


@pytest.mark.parametrize("count", [1, 2, 3])
def test_no_fold_is_judged_on_samples_that_it_was_fitted_to(count: int) -> None:
    records = pairs(made(), (1500, 1200, 1800)[:count])
    folds = make_folds(records)
    assert len(folds) == {1: 7, 2: 6, 3: 9}[count]
    for fold in folds:
        for fitted, judged, record in zip(fold.fitted, fold.judged, records, strict=True):
            both = np.concatenate([fitted, judged])
            counted = np.arange(record.u.shape[1])[record.counted]
            assert len(np.unique(both)) == len(both) and np.isin(both, counted).all()
        assert sum(map(len, fold.judged)) > 0 < sum(map(len, fold.fitted))


def test_a_repeated_slow_loop_counts_once_in_the_choice_of_preview(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The loop is followed best without preview, the other record, by a smaller margin, with two samples."""
    records = pairs(made(rate="none"), (1500, 1500))
    looping = [records[0]._replace(weight=0.1), records[1]]

    def with_weights(those: Sequence[InversePair]) -> int:
        monkeypatch.setattr(selection, "weighted_by_repetitions", lambda _: those)
        search = _Search(build, lambda _: those, RICHEST)

        def tried(form: Form, start: _Trial | None = None) -> _Trial:
            _, folds = search.at(form.preview)
            looped = [len(fold.judged[0]) > 0 for fold in folds]
            late = np.where(looped, form.preview, 0.5 * abs(form.preview - 2))
            return _Trial(form, [], np.exp(late))

        monkeypatch.setattr(search, "tried", tried)
        return search.preview(Form())

    assert (with_weights(records), with_weights(looping)) == (0, 2)
