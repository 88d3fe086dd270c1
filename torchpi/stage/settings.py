"""Convert a stage's file to the arguments of `Stage`; the signature of a section's function is its schema.

A file has either the sections `amplifier`, `actuator`, `mechanics` and `sensor`, each with a few physical
numbers, or the arguments of `Stage` themselves, with any effects.
"""

import difflib
import inspect
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

from torchpi.errors import ConfigError, StageError
from torchpi.files import read_yaml_text, yaml_loader
from torchpi.operators.quantity import Quantity, check_order
from torchpi.operators.quantization import Converter
from torchpi.stage.effects.actuator.creep import Creep
from torchpi.stage.effects.actuator.input_nonlinearity import InputNonlinearity
from torchpi.stage.effects.amplifier.amplifier_lag import AmplifierLag
from torchpi.stage.effects.amplifier.delay import Delay
from torchpi.stage.effects.effect import Effect
from torchpi.stage.effects.mechanics.resonance import Resonance
from torchpi.stage.effects.sensor.sensor_lag import SensorLag

Built = TypeVar("Built")
Settings = dict[str, Any]
NOISE = Quantity("µm", at_least=0)


def of_sections(
    *,
    sample_rate_hz: float,
    amplifier: Mapping[str, Any] | None = None,
    actuator: Mapping[str, Any] | None = None,
    mechanics: Mapping[str, Any] | None = None,
    sensor: Mapping[str, Any] | None = None,
    seed: int = 0,
) -> Settings:
    """Return the arguments of `Stage` for these sections; a section that is None or empty is ideal.

    At tick k the controller reads y(k), then writes u(k), which is held until tick k+1. So y(k) depends on u
    up to k-1.

    Args:
        sample_rate_hz: Sample rate of commands and readings.
        amplifier: Arguments of `amplifier_of`.
        actuator: Arguments of `actuator_of`.
        mechanics: Arguments of `mechanics_of`.
        sensor: Arguments of `sensor_of`.
        seed: Seed of the noise.

    Raises:
        ConfigError: An unknown setting (the message names the nearest one), or a value of the wrong kind.
        StageError: An unphysical value.
    """
    parts = (
        build(amplifier_of, amplifier, "amplifier"),
        build(actuator_of, actuator, "actuator"),
        build(mechanics_of, mechanics, "mechanics"),
        build(sensor_of, sensor, "sensor"),
    )
    effects = [entry for part in parts for entry in part.pop("effects", [])]
    merged = {name: value for part in parts for name, value in part.items()}
    return {"sample_rate_hz": sample_rate_hz, "effects": effects, "alignment": 1, "seed": seed, **merged}


def amplifier_of(
    *,
    min_voltage_v: float | None = None,
    max_voltage_v: float | None = None,
    cutoff_hz: float | None = None,
    delay_s: float = 0.0,
    converter_bits: int | None = None,
    converter_min_v: float = -10.0,
    converter_max_v: float = 10.0,
) -> Settings:
    """Return the settings of an amplifier: D/A converter, saturation, hold, lag, delay; by default only hold.

    Voltages are those on the controller's side; the fixed gain of the amplifier is part of the actuator's.

    Args:
        min_voltage_v: Lower saturation; None is no limit.
        max_voltage_v: Upper saturation; None is no limit.
        cutoff_hz: Cutoff frequency of the first-order lag; None is no lag.
        delay_s: Delay of computation and converter together, in addition to the hold.
        converter_bits: Resolution of the converter; None is ideal.
        converter_min_v: Lower end of its range.
        converter_max_v: Upper end of its range.
    """
    low = -math.inf if min_voltage_v is None else min_voltage_v
    high = math.inf if max_voltage_v is None else max_voltage_v
    check_order("min_voltage_v", low, "max_voltage_v", high, "V")
    effects = []
    if cutoff_hz is not None:
        effects.append(_entry(AmplifierLag, cutoff_hz=cutoff_hz))
    if delay_s != 0.0:
        effects.append(_entry(Delay, delay_s=delay_s, after_lag=0.0 if cutoff_hz is None else 1.0))
    return {
        "effects": effects,
        "min_voltage_v": min_voltage_v,
        "max_voltage_v": max_voltage_v,
        "saturates": True,
        "command_converter": _converter(converter_bits, "v", converter_min_v, converter_max_v),
    }


def actuator_of(
    *,
    input_polynomial_v: Sequence[float] | None = None,
    thresholds_v: Sequence[float] = (0.0,),
    weights_um_per_v: Sequence[float] = (1.0,),
    creep_per_decade: float | None = None,
    creep_from_s: float = 0.1,
    creep_to_s: float = 100.0,
) -> Settings:
    """Return an actuator: input curvature, Prandtl–Ishlinskii hysteresis, log creep; by default 1 µm/V.

    Args:
        input_polynomial_v: Coefficients of v, v², v³ with v in V, the result in V; None is a straight line.
            Its curvature makes the loop asymmetric.
        thresholds_v: r of the plays, none negative.
        weights_um_per_v: w of the plays, one for each threshold. Their sum is the gain of a large swing.
        creep_per_decade: Share of a step added in each decade of time; None is no creep.
        creep_from_s: Time from which the logarithm holds.
        creep_to_s: Time up to which it holds.
    """
    check_plays(thresholds_v, weights_um_per_v)
    c = [1.0] if input_polynomial_v is None else list(input_polynomial_v)
    if not 1 <= len(c) <= 3 or not 0 < c[0] < math.inf:
        raise StageError(f"input_polynomial_v: found {c}, expected one to three numbers, the first positive")
    effects = []
    # A play of the scaled voltage is the scaled play of the voltage: c₁ goes into thresholds and weights.
    bent = dict(zip(("c2_per_v", "c3_per_v2"), (one / c[0] for one in c[1:]), strict=False))
    if any(bent.values()):
        effects.append(_entry(InputNonlinearity, **{name: value for name, value in bent.items() if value}))
    if creep_per_decade is not None:
        try:
            times = {"from_s": creep_from_s, "to_s": creep_to_s}
            effects.append(_entry(Creep, per_decade=creep_per_decade, **times))
            check_order("from_s", creep_from_s, "to_s", creep_to_s, "s")
        except StageError as error:
            raise StageError(f"creep_{error}") from error
    hysteresis = {
        "thresholds_v": [r / c[0] for r in thresholds_v],
        "weights": [*(w * c[0] for w in weights_um_per_v), 0.0],
    }
    return {"effects": effects, "hysteresis": hysteresis}


def mechanics_of(*, frequency_hz: float | None = None, damping_ratio: float | None = None) -> Settings:
    """Return the settings of one lightly damped mode of unit static gain; by default the stage is rigid.

    Args:
        frequency_hz: Undamped natural frequency of the mode; None is rigid.
        damping_ratio: Damping ratio of the mode; required together with `frequency_hz`.
    """
    if frequency_hz is None and damping_ratio is None:
        return {}
    if frequency_hz is None or damping_ratio is None:
        missing = "frequency_hz" if frequency_hz is None else "damping_ratio"
        raise StageError(f"{missing}: found none, expected a number: a mode needs both")
    return {"effects": [_entry(Resonance, frequency_hz=frequency_hz, damping_ratio=damping_ratio)]}


def sensor_of(
    *,
    cutoff_hz: float | None = None,
    noise_um: float = 0.0,
    converter_bits: int | None = None,
    converter_min_um: float = -50.0,
    converter_max_um: float = 50.0,
) -> Settings:
    """Return the settings of a sensor: lag, white noise, A/D converter; by default it is ideal.

    Args:
        cutoff_hz: Cutoff frequency of the first-order lag; None is no lag.
        noise_um: Standard deviation of the noise of one reading.
        converter_bits: Resolution of the converter; None is ideal.
        converter_min_um: Lower end of its range.
        converter_max_um: Upper end of its range.
    """
    return {
        "sensor": [] if cutoff_hz is None else [_entry(SensorLag, cutoff_hz=cutoff_hz)],
        "noise_um": NOISE.check("noise_um", noise_um),
        "reading_converter": _converter(converter_bits, "um", converter_min_um, converter_max_um),
    }


def check_plays(thresholds_v: Sequence[float], weights_um_per_v: Sequence[float]) -> None:
    """Raise `StageError` unless thresholds and weights fit together and give a positive gain."""
    if len(thresholds_v) == 0 or not all(0 <= r < math.inf for r in thresholds_v):
        raise StageError(
            f"thresholds_v: found {list(thresholds_v)} V, expected one number or more, none negative"
        )
    if len(weights_um_per_v) != len(thresholds_v):
        raise StageError(
            f"weights_um_per_v: found {len(weights_um_per_v)} numbers, "
            f"expected {len(thresholds_v)}, one per threshold"
        )
    gain = sum(weights_um_per_v)
    if not 0 < gain < math.inf:
        raise StageError(f"weights_um_per_v: their sum is {gain:g} µm/V, expected a positive gain in µm/V")


def _entry(effect: type[Effect], **values: float) -> Settings:
    """Return an effect as `Stage` takes it; its values are checked here, where the section is known."""
    return {"name": effect.name, "values": effect.checked(values)}


def _converter(bits: int | None, unit: str, low: float, high: float) -> Settings | None:
    """Return a converter as `Stage` takes it; errors name the setting as in the file."""
    if bits is None:
        return None
    Converter.quantities["bits"].check("converter_bits", bits)
    check_order(f"converter_min_{unit}", low, f"converter_max_{unit}", high, {"v": "V", "um": "µm"}[unit])
    return {"bits": bits, "low": low, "high": high}


def read_yaml(path: str | Path) -> dict[str, Any]:
    """Return the settings in a YAML file.

    Raises:
        ConfigError: The file is missing, not YAML, or not a mapping of keys to values; names the file.
    """
    import yaml  # imported here, because nothing else of a stage needs it

    text = read_yaml_text(path)
    try:
        settings = yaml.load(text, yaml_loader())
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        line = f", line {min(mark.line, text.count(chr(10))) + 1}" if mark else ""  # the end is its last line
        raise ConfigError(f"{path}{line}: not valid YAML: {getattr(error, 'problem', error)}") from error
    if not isinstance(settings, dict):
        raise ConfigError(f"{path}: found {type(settings).__name__}, expected keys with values, one per line")
    return settings


def build(
    make: Callable[..., Built],
    settings: Mapping[str, Any] | None,  # None is an empty section: ideal
    section: str = "",  # "" is the top of the file
) -> Built:
    """Call `make` with a section's settings as its keyword arguments.

    Raises:
        ConfigError: An unknown key (with the nearest right one), a missing key, or a value of the wrong kind.
        StageError: A value that `make` finds unphysical. Both messages begin with the full key.
    """
    prefix = f"{section}." if section else ""
    if settings is not None and not isinstance(settings, Mapping):
        raise ConfigError(
            f"{section or 'settings'}: found {settings!r}, expected a section of keys with values"
        )
    parameters = inspect.signature(make).parameters
    arguments = {}
    for key, value in (settings or {}).items():
        if key not in parameters:
            nearest = difflib.get_close_matches(str(key), parameters, n=1, cutoff=0.0)[0]
            raise ConfigError(f"unknown key {prefix}{key}; the nearest one is {prefix}{nearest}")
        arguments[key] = _of_kind(value, str(parameters[key].annotation), f"{prefix}{key}")
    for key, parameter in parameters.items():
        if parameter.default is inspect.Parameter.empty and key not in arguments:
            raise ConfigError(f"{prefix}{key} is missing")
    try:
        return make(**arguments)
    except StageError as error:
        raise StageError(f"{prefix}{error}") from error


def _of_kind(value: Any, kind: str, where: str) -> Any:
    """Convert a value as its annotation requires. YAML 1.1 reads 1e-4 as text; here it is a number."""
    if "Mapping" in kind or (value is None and "None" in kind):
        return value
    if "bool" in kind:
        if not isinstance(value, bool):
            raise ConfigError(f"{where}: found {value!r}, expected true or false")
        return value
    try:
        if "Sequence" in kind:
            if not isinstance(value, list | tuple):
                raise ValueError
            return [_number(part) for part in value]
        number = _number(value)
        if "int" not in kind:
            return number
        if number != int(number):
            raise ValueError
        return int(number)
    except (ValueError, OverflowError):
        one = "a whole number" if "int" in kind else "a number"
        expected = "a list of numbers" if "Sequence" in kind else one
        raise ConfigError(f"{where}: found {value!r}, expected {expected}") from None


def _number(value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        raise ValueError
    return float(value)
