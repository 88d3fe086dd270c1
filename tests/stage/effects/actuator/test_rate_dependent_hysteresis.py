"""Rate-dependent hysteresis: which recordings show that plays relax."""

from torchpi.stage.effects.actuator.rate_dependent_hysteresis import RateDependentHysteresis
from torchpi.stage.effects.effect import DataRange


def test_plays_that_relax_faster_than_the_voltage_moves_do_not_count() -> None:
    """They act as a lag, which has fewer assumptions."""
    sine, jumps = (DataRange(1e4, 10.0, 0, 10, 1, 0, 10, {}, quickest_s=one) for one in (0.16, 1e-3))
    quick, slow = ({"relaxation_s": tau} for tau in (0.035, 0.2))
    reached = RateDependentHysteresis.reached
    assert not reached(quick, sine) and reached(slow, sine) and reached(quick, jumps)
    assert reached({"weight_s_per_v": 1e-3}, sine)
    assert all(reached(start, sine) for start in RateDependentHysteresis.starts(sine))
    assert any("relaxation_s" in start for start in RateDependentHysteresis.starts(sine))
