"""The ablation table: every variant is learned from the same recordings and judged by the same rule."""

from pathlib import Path

import pytest

from torchpi.control.direct_inverse import DirectInverse
from torchpi.paper.ablation import PAPER, PASSES, VARIANTS, ablation
from torchpi.paper.recipe import FORM, stage_recordings
from torchpi.stage import Stage

STAGE = Path(__file__).parents[2] / "configs" / "stage" / "qin2013.yaml"


@pytest.fixture(scope="module")
def stage() -> Stage:
    return Stage.from_yaml(STAGE).requires_grad_(False)


def test_variants_are_valid_forms_of_the_compensator_up_to_the_full_one() -> None:
    for settings in VARIANTS.values():
        DirectInverse(1e-4, [0.0, 1.0], **settings["form"])
    assert VARIANTS["+ own output functions: torchpi"] == {"form": FORM}
    assert 0 in PASSES


def test_errors_of_every_variant_have_a_spread_over_the_seeds(stage: Stage) -> None:
    variants = {
        "paper": {"form": PAPER, "evaluations": 0},
        "creep": {
            "form": {**PAPER, "preview": 2, "lead": 2, "creep_time_constants_s": [0.1]},
            "evaluations": 4,
        },
    }
    lines: list[str] = []
    found = ablation(stage, seeds=2, variants=variants, passes=(), log=lines.append)
    assert len(lines) == 4 and found.seeds == 2 and found.fig7 == {}
    for spreads in found.stage.values():
        for spread in spreads.values():
            assert 0 < spread.least <= spread.mean <= spread.most
    assert found.stage["creep"]["fast_rms"].mean < found.stage["paper"]["fast_rms"].mean


def test_another_seed_gives_different_recordings(stage: Stage) -> None:
    one, other = stage_recordings(stage, 0), stage_recordings(stage, 1)
    assert [recording.name for recording in one] == [recording.name for recording in other]
    for a, b in zip(one, other, strict=True):
        assert not (a.y == b.y).all()
