"""What the effect classes declare about themselves, for a search that knows none of them by name."""

from dataclasses import replace

import numpy as np
import pytest

from torchpi.diagnosis.screen import possible
from torchpi.stage.effects import EFFECTS
from torchpi.stage.effects.effect import DataRange

SEEN = DataRange(1e4, 20.0, 0, 100, 1e4, 0, 20, {"aux_v": 1.0}, peak_rate_v_s=1e5)
each = pytest.mark.parametrize("effect", EFFECTS, ids=lambda effect: effect.name)


@each
def test_every_start_has_a_declared_form_if_the_effect_has_forms(effect):
    forms = [effect.form(start) for start in effect.starts(SEEN)]
    assert set(forms) <= {*effect.forms, *([] if effect.forms else [""])}
    assert effect.form({}) == ""


@each
def test_every_form_is_tried(effect):
    if not effect.read_off:
        ringing, simulated = np.sin(2 * np.pi * 700 * np.arange(20_000) / 1e4), replace(SEEN, simulated=True)
        starts = [*effect.starts(SEEN), *effect.starts_from(simulated, ringing, ringing, 1e4)]
        tried = {effect.form(start) for start in starts}
        assert set(effect.forms) <= tried


@each
def test_effects_that_are_degenerate_with_each_other_both_declare_it(effect):
    by_name = {other.name: other for other in EFFECTS}
    for name in effect.degenerate_with:
        assert name != effect.name
        assert effect.name in by_name[name].degenerate_with


@each
def test_only_effects_that_are_read_off_have_no_starts(effect):
    assert bool(effect.starts(SEEN)) != effect.read_off


@each
@pytest.mark.parametrize(("fs_hz", "duration_s"), [(200.0, 3600.0), (1e4, 1.0), (5e4, 0.12)])
def test_every_slow_effect_has_a_possible_start_in_recordings_of_a_tenth_of_a_second_to_an_hour(
    effect, fs_hz, duration_s
):
    seen = DataRange(fs_hz, duration_s, 0, 100, 1e4, 0, 20, {})
    assert effect.time_scale != "slow" or any(possible(effect, one) for one in effect.starts(seen))


def test_only_fast_effects_can_be_mistaken_for_a_timing_convention():
    assert {effect.time_scale for effect in EFFECTS if effect.delays} == {"fast"}


@each
def test_starts_from_a_residual_are_within_bounds_and_at_its_lines(effect):
    t = np.arange(20_000) / 1e4
    output = 10 + 8 * np.sin(2 * np.pi * 5 * t)
    residual = 0.1 * output * np.cos(2 * np.pi * 2.3 * t) + 0.1 * np.sin(2 * np.pi * 700 * t)
    found = effect.starts_from(SEEN, residual, output, 1e4)
    for start in found:
        assert all(
            effect.quantities[n].at_least <= v <= effect.quantities[n].at_most for n, v in start.items()
        )
    lines = {"gain_modulation": 2.3, "resonance": 700.0, "second_mode": 700.0}
    assert bool(found) == (effect.name in lines)
    if found:
        assert found[0]["frequency_hz"] == pytest.approx(lines[effect.name], rel=0.02, abs=0.25 / 2)  # 1/4D
