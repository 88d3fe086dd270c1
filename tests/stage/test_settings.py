"""A stage file: errors in it are reported with file, key, value, unit and remedy."""

import copy
from pathlib import Path
from typing import Any

import pytest
import yaml

from torchpi.errors import ConfigError, StageError
from torchpi.stage import Stage

DEFAULT = Path(__file__).parents[2] / "configs/stage/default.yaml"


def written(tmp_path: Path, settings: dict[str, Any]) -> Path:
    path = tmp_path / "rig.yaml"
    path.write_text(yaml.safe_dump(settings))
    return path


def changed(key: str, value: Any) -> dict[str, Any]:
    """Return the default settings with the value of one dotted key replaced."""
    settings = copy.deepcopy(yaml.safe_load(DEFAULT.read_text()))
    *sections, last = key.split(".")
    place = settings
    for section in sections:
        place = place[section]
    place[last] = value
    return settings


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("mechanics.freq", 600, "unknown key mechanics.freq; the nearest one is mechanics.frequency_hz"),
        ("amplifier.cutof_hz", 600, "unknown key amplifier.cutof_hz; the nearest one is amplifier.cutoff_hz"),
        ("sample_rate", 600, "unknown key sample_rate; the nearest one is sample_rate_hz"),
        ("mecanics", {}, "unknown key mecanics; the nearest one is mechanics"),
        ("mechanics.frequency_hz", "fast", "mechanics.frequency_hz: found 'fast', expected a number"),
        ("mechanics.frequency_hz", True, "mechanics.frequency_hz: found True, expected a number"),
        ("mechanics", [1], "mechanics: found [1], expected a section of keys with values"),
        ("sensor.converter_bits", 12.5, "sensor.converter_bits: found 12.5, expected a whole number"),
        ("actuator.thresholds_v", 3, "actuator.thresholds_v: found 3, expected a list of numbers"),
        ("sample_rate_hz", None, "sample_rate_hz: found None, expected a number"),
    ],
)
def test_a_wrong_key_or_type_of_value_is_a_one_line_config_error(tmp_path, key, value, message):
    path = written(tmp_path, changed(key, value))
    with pytest.raises(ConfigError) as caught:
        Stage.from_yaml(path)
    assert str(caught.value) == f"{path}: {message}"


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("sample_rate_hz", 0, "found 0 Hz, expected more than 0 and at most 1e+08 Hz"),
        ("seed", -1, "found -1, expected 0 to 9.22337e+18"),
        ("mechanics.damping_ratio", -0.01, "found -0.01, expected at least 0"),
        ("mechanics.damping_ratio", None, "found none, expected a number"),
        ("mechanics.frequency_hz", 0, "found 0 Hz, expected a positive number of Hz"),
        ("amplifier.cutoff_hz", -5, "found -5 Hz, expected a positive number of Hz"),
        ("amplifier.delay_s", -1e-4, "found -0.0001 s, expected at least 0 s"),
        ("amplifier.max_voltage_v", 0, "found 0 V, expected more than min_voltage_v = 0 V"),
        ("amplifier.converter_bits", 0, "found 0 bits, expected 1 to 32 bits"),
        ("sensor.converter_max_um", -60, "found -60 µm, expected more than converter_min_um"),
        ("sensor.noise_um", -0.003, "found -0.003 µm, expected at least 0 µm"),
        ("sensor.noise_um", float("nan"), "found nan µm, expected at least 0 µm"),
        ("actuator.weights_um_per_v", [0.0] * 20, "their sum is 0 µm/V, expected a positive"),
        ("actuator.weights_um_per_v", [1.0], "found 1 numbers, expected 20, one per threshold"),
        ("actuator.thresholds_v", [-1.0] * 20, "found [-1.0, "),
        ("actuator.input_polynomial_v", [], "found [], expected one to three numbers, the first positive"),
        ("actuator.creep_per_decade", 3, "found 3, expected -0.5 to 0.5"),
        ("actuator.creep_to_s", 0.001, "found 0.001 s, expected more than from_s = 0.01 s"),
    ],
)
def test_an_unphysical_value_is_a_one_line_stage_error(tmp_path, key, value, message):
    path = written(tmp_path, changed(key, value))
    with pytest.raises(StageError) as caught:
        Stage.from_yaml(path)
    assert str(caught.value).startswith(f"{path}: {key}: {message}")
    assert "\n" not in str(caught.value)


def test_a_missing_sample_rate_is_reported(tmp_path):
    path = written(tmp_path, {"mechanics": {"frequency_hz": 620, "damping_ratio": 0.02}})
    with pytest.raises(ConfigError, match="sample_rate_hz is missing"):
        Stage.from_yaml(path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a: [1", "line 1: not valid YAML"),
        ("- 1\n", "found list, expected keys with values"),
        ("", "found NoneType"),
    ],
)
def test_a_file_that_is_not_a_yaml_mapping_is_refused(tmp_path, text, message):
    path = tmp_path / "rig.yaml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=message):
        Stage.from_yaml(path)


def test_a_missing_file_is_named_in_the_error(tmp_path):
    with pytest.raises(ConfigError, match=r"none\.yaml: cannot be read: No such file"):
        Stage.from_yaml(tmp_path / "none.yaml")


def test_numbers_that_yaml_reads_as_text_are_accepted(tmp_path):
    path = tmp_path / "rig.yaml"
    path.write_text("sample_rate_hz: 1e4\namplifier: {delay_s: 5e-5}\n")
    (delay,) = Stage.from_yaml(path).effects
    assert delay.values["delay_s"] == 5e-5
