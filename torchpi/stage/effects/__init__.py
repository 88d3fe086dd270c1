"""All effects that torchpi knows, in the order of the chain; a new effect needs a class and a row here."""

from torchpi.stage.effects.actuator.ageing import Ageing
from torchpi.stage.effects.actuator.creep import Creep
from torchpi.stage.effects.actuator.hysteresis_asymmetry import HysteresisAsymmetry
from torchpi.stage.effects.actuator.incongruent_loops import IncongruentLoops
from torchpi.stage.effects.actuator.input_nonlinearity import InputNonlinearity
from torchpi.stage.effects.actuator.leakage import Leakage
from torchpi.stage.effects.actuator.rate_dependent_hysteresis import RateDependentHysteresis
from torchpi.stage.effects.amplifier.amplifier_lag import AmplifierLag
from torchpi.stage.effects.amplifier.delay import Delay
from torchpi.stage.effects.amplifier.slew_limit import SlewLimit
from torchpi.stage.effects.amplifier.voltage_saturation import VoltageSaturation
from torchpi.stage.effects.effect import Effect
from torchpi.stage.effects.inside import InsideEffect
from torchpi.stage.effects.mechanics.backlash import Backlash
from torchpi.stage.effects.mechanics.cross_coupling import CrossCoupling
from torchpi.stage.effects.mechanics.load_change import LoadChange
from torchpi.stage.effects.mechanics.resonance import Resonance
from torchpi.stage.effects.mechanics.second_mode import SecondMode
from torchpi.stage.effects.mechanics.stiction import Stiction
from torchpi.stage.effects.sensor.dropouts import Dropouts
from torchpi.stage.effects.sensor.gain_modulation import GainModulation
from torchpi.stage.effects.sensor.hum import Hum
from torchpi.stage.effects.sensor.quantization import Quantization
from torchpi.stage.effects.sensor.sensor_lag import SensorLag
from torchpi.stage.effects.sensor.sensor_nonlinearity import SensorNonlinearity
from torchpi.stage.effects.sensor.thermal_drift import ThermalDrift

EFFECTS: tuple[type[Effect] | type[InsideEffect], ...] = (
    VoltageSaturation,
    SlewLimit,
    AmplifierLag,
    Delay,
    InputNonlinearity,
    HysteresisAsymmetry,
    IncongruentLoops,
    RateDependentHysteresis,
    Creep,
    Leakage,
    Ageing,
    CrossCoupling,
    LoadChange,
    Resonance,
    SecondMode,
    Backlash,
    Stiction,
    ThermalDrift,
    SensorNonlinearity,
    SensorLag,
    GainModulation,
    Hum,
    Quantization,
    Dropouts,
)
