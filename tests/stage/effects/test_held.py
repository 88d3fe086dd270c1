"""A held command: what the input of each block of a chain does between samples."""

import pytest

from torchpi.stage.effects.actuator.creep import Creep
from torchpi.stage.effects.amplifier.amplifier_lag import AmplifierLag
from torchpi.stage.effects.amplifier.slew_limit import SlewLimit
from torchpi.stage.effects.effect import Effect
from torchpi.stage.effects.held import hold_first_block
from torchpi.stage.effects.mechanics.resonance import Resonance
from torchpi.stage.effects.sensor.sensor_lag import SensorLag


@pytest.mark.parametrize(
    ("before", "held", "resonance", "sensor_lag"),
    [
        ([], True, "end", "first"),
        ([Creep], True, "end", "first"),
        ([], False, "first", "first"),
        ([AmplifierLag], True, "first", "first"),
        ([SlewLimit], True, "first", "first"),
    ],
)
@pytest.mark.parametrize("left", ["first", "end"])
def test_only_the_first_block_takes_a_held_command_whatever_hold_was_set_before(
    before: list[type[Effect]], held: bool, resonance: str, sensor_lag: str, left: str
) -> None:
    mode, lag = Resonance(1e-4), SensorLag(1e-4)
    mode.hold = lag.hold = left
    hold_first_block([*(kind(1e-4) for kind in before), mode, lag], held)
    assert (mode.hold, lag.hold) == (resonance, sensor_lag)
