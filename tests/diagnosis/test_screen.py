"""The screen: how much a start could explain to first order, and at what size."""

import numpy as np
import pytest

from tests.diagnosis.plants import NOISE_UM, creep, lag, multisine, pair, record, stairs, triangles
from tests.diagnosis.prepared import prepared
from torchpi.diagnosis.chain import Chain
from torchpi.diagnosis.fit import fit, start_weights
from torchpi.diagnosis.hypothesis import EffectTerm, Hypothesis
from torchpi.diagnosis.hysteresis_model import many_plays, plain
from torchpi.diagnosis.records import seen
from torchpi.diagnosis.score import Weighting
from torchpi.diagnosis.screen import Screen, candidates_of, sizes_of
from torchpi.stage.effects import EFFECTS
from torchpi.stage.effects.actuator.creep import Creep
from torchpi.stage.effects.amplifier.amplifier_lag import AmplifierLag
from torchpi.stage.effects.amplifier.slew_limit import SlewLimit
from torchpi.stage.effects.effect import Effect
from torchpi.stage.effects.inside import InsideEffect
from torchpi.stage.effects.sensor.sensor_nonlinearity import SensorNonlinearity


@pytest.mark.parametrize("effect", [effect for effect in EFFECTS if not effect.read_off])
def test_every_start_of_an_effect_changes_the_output(effect: type[Effect] | type[InsideEffect]) -> None:
    """A form that a stage has, and the rows of the search have not, would be tried and never found."""
    other = {"other_v": multisine(4000, seed=5)}
    rig = [
        record(np.concatenate([stairs(2000), triangles(2000)]), name="a", aux=other),
        record(multisine(4000), name="b", seed=3, aux=other),
    ]
    chain = Chain(prepared(rig))
    what, h = seen(chain.records), Hypothesis(plain(seen(chain.records)))
    weights, _ = start_weights(chain, h)
    starts = candidates_of(effect, chain.records, effect.starts(what), list(what.aux))
    assert starts
    for member in starts:
        moved = [chain.output(h.plus(member), weights, i) - chain.output(h, weights, i) for i in range(2)]
        assert max(np.abs(one).max() for one in moved) > NOISE_UM / 2, member


@pytest.mark.parametrize("per_decade", [0.001, 0.01, 0.02])
def test_a_start_gets_the_size_that_explains_most(per_decade: float) -> None:
    """A fit from a start twenty times too large would stop far from the solution."""
    rig = pair(4000, after=lambda x, fs_hz: creep(x, fs_hz, per_decade), noise_um=0.0005)
    chain = Chain(prepared(rig))
    now = fit(chain, Hypothesis(many_plays(seen(chain.records))))
    chain.weighting = Weighting.of(chain.records, now.residuals, None)
    (found,) = Screen(chain, now).candidates([EffectTerm(Creep, {"per_decade": 0.02})])
    assert found.gain > 0
    assert found.member.shared["per_decade"] == pytest.approx(per_decade, rel=0.5)


def test_a_start_gains_at_once_only_near_the_solution() -> None:
    """To first order, a thirtieth of a far slower lag explains as much, but its fit ends far away."""
    chain = Chain(prepared(pair(4000, before=lambda v, fs_hz: lag(v, fs_hz, 300.0))))
    now = fit(chain, Hypothesis(many_plays(seen(chain.records))))
    chain.weighting = Weighting.of(chain.records, now.residuals, None)
    far, near = Screen(chain, now).candidates(
        [EffectTerm(AmplifierLag, {"cutoff_hz": cutoff_hz}) for cutoff_hz in (10.0, 250.0)]
    )
    assert far.gain > 0 > far.at_once
    assert 0 < near.at_once <= near.gain


def test_only_unsigned_parameters_that_vanish_smoothly_at_zero_count_as_sizes() -> None:
    assert sizes_of(EffectTerm(Creep, {"power_per_decade": 0.01, "exponent": 0.2})) == ["power_per_decade"]
    assert sizes_of(EffectTerm(AmplifierLag, {"cutoff_hz": 100.0})) == []
    assert sizes_of(EffectTerm(SlewLimit, {"rate_v_per_s": 100.0})) == []
    assert sizes_of(EffectTerm(SensorNonlinearity, {"a2_per_um": 0.01})) == []
