"""The names that a diagnosis may give, and which of them voltage and displacement cannot tell apart."""

NAMES = (
    "amplifier_lag", "slew_limit", "voltage_saturation", "delay", "input_nonlinearity",
    "hysteresis_asymmetry", "incongruent_loops", "hysteresis_operator", "rate_dependent_hysteresis",
    "creep", "leakage", "resonance", "second_mode", "load_change", "backlash", "stiction", "cross_coupling",
    "sensor_lag", "sensor_nonlinearity", "quantization", "hum", "thermal_drift", "ageing",
    "gain_modulation", "dropouts",
)  # fmt: skip
STATIC = frozenset(
    {
        "input_nonlinearity",
        "hysteresis_asymmetry",
        "incongruent_loops",
        "sensor_nonlinearity",
        "hysteresis_operator",
    }
)
# A name that is in no set is a group of its own.
GROUPS = (STATIC, frozenset({"amplifier_lag", "sensor_lag"}), frozenset({"resonance", "second_mode"}))


def group_of(name: str) -> frozenset[str]:
    """Return the names that count as the right group if `name` is true."""
    return next((group for group in GROUPS if name in group), frozenset({name}))
