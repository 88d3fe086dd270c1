"""Rate and acceleration of a measured displacement, without phase shift.

Identification needs ẏ at exactly the sample to which it belongs (eq. 7, 11). A backward difference lags by
half a sample and multiplies the sensor's noise by the sample rate. Here, everything up to a stated bandwidth
counts as motion.
"""

import numpy as np

from torchpi.errors import ConfigError, RecordingError

ROLL_OFF = 1.5  # the gain falls from one at the bandwidth to zero at 1.5 times the bandwidth
EDGE_PERIODS = 0.6  # window, in periods of the bandwidth, on which the curvature at either end is fitted
LEAST_SAMPLES = 8


def zero_phase_motion(
    y: np.ndarray, fs_hz: float, bandwidth_hz: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the smoothed displacement, rate and acceleration of a record, all in phase with it.

    The filter acts in the frequency domain: gain one up to `bandwidth_hz`, zero above 1.5 times that, and a
    raised cosine between. White noise of σ causes less than 2π·B·σ·√(2B / 3fs) in the rate, where B is 1.5
    times the bandwidth. Both ends are extended by point reflection, after a cubic has removed their value and
    curvature, so a record may begin and end anywhere, at rest or in motion. Within one period of the
    bandwidth of either end, the acceleration is only approximate.

    Args:
        y: (…, time), µm.
        fs_hz: sample rate.
        bandwidth_hz: bandwidth of the motion; see `motion_bandwidth`.

    Returns:
        y_smooth, y_dot, y_ddot: (…, time), µm, µm/s, µm/s².

    Raises:
        ConfigError: the bandwidth is not between 0 and half the sample rate.
        RecordingError: fewer than 8 samples.
    """
    if not 0 < bandwidth_hz < fs_hz / 2:
        raise ConfigError(
            f"bandwidth_hz is {bandwidth_hz:g}, expected above 0 and below half of the sample rate, "
            f"{fs_hz / 2:g} Hz"
        )
    y = np.asarray(y, dtype=np.float64)
    samples = y.shape[-1]
    _check_samples(samples)
    t = np.arange(samples) / fs_hz
    cubic, cubic_dot, cubic_ddot = _edge_cubic(y, t, fs_hz, bandwidth_hz)
    rest = y - cubic
    spectrum = np.fft.rfft(np.concatenate((rest, -rest[..., -2:0:-1]), axis=-1))
    frequency = np.fft.rfftfreq(2 * samples - 2, 1 / fs_hz)
    spectrum *= _gain(frequency, fs_hz, bandwidth_hz)
    omega = 2j * np.pi * frequency

    def back(derivative: np.ndarray) -> np.ndarray:
        return np.fft.irfft(derivative, n=2 * samples - 2)[..., :samples]

    return (
        cubic + back(spectrum),
        cubic_dot + back(spectrum * omega),
        cubic_ddot + back(spectrum * omega**2),
    )


def motion_bandwidth(y: np.ndarray, fs_hz: float) -> float:
    """Return the bandwidth that makes the rate of this record most accurate, Hz.

    The noise floor N is the median of the spectrum's upper half, where a stage does not move. A bandwidth B
    passes the noise ω²N below it and loses the motion ω²(P − N) above it; their sum is least where the
    running sum of ω²(P − 2N) is greatest. A weak line far above the rest therefore counts only if it
    outweighs the noise below it. The result lies a fifth above the last line counted, so that this line
    passes unattenuated, and is at most a quarter of the sample rate.

    Args:
        y: (time,), µm.
        fs_hz: sample rate.

    Raises:
        RecordingError: fewer than 8 samples.
    """
    from scipy.signal import welch

    y = np.asarray(y, dtype=np.float64)
    samples = len(y)
    _check_samples(samples)
    # Segments of a quarter of the record leak little from a line, and seven of them are averaged.
    frequency, power = welch(y, fs_hz, nperseg=min(samples, max(256, samples // 4)))
    floor = np.median(power[frequency >= fs_hz / 4])
    gained = np.cumsum(frequency**2 * (power - 2 * floor))
    last = max(1, int(np.argmax(gained)))
    return float(min(1.2 * frequency[last], fs_hz / 4))


def _gain(frequency: np.ndarray, fs_hz: float, bandwidth_hz: float) -> np.ndarray:
    end = min(ROLL_OFF * bandwidth_hz, fs_hz / 2)
    s = np.clip((frequency - bandwidth_hz) / (end - bandwidth_hz), 0, 1)
    return np.asarray(0.5 * (1 + np.cos(np.pi * s)))


def _edge_cubic(
    y: np.ndarray, t: np.ndarray, fs_hz: float, bandwidth_hz: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the cubic with the value and curvature of y at its two ends, and its two derivatives.

    The remainder of y has neither at the ends, so its point reflection is smooth to the third derivative.
    """
    samples = y.shape[-1]
    window = min(samples, max(6, round(EDGE_PERIODS * fs_hz / bandwidth_hz)))
    # Local cubic over the window in s = 0…1, least squares: value and second derivative at s = 0.
    fit = np.linalg.pinv(np.vander(np.linspace(0, 1, window), 4, increasing=True))
    span = (window - 1) / fs_hz
    first, last = y[..., :window], y[..., : -window - 1 : -1]
    y0, y1 = first @ fit[0], last @ fit[0]
    curve0, curve1 = 2 * (first @ fit[2]) / span**2, 2 * (last @ fit[2]) / span**2
    y0, y1, curve0, curve1 = (value[..., None] for value in (y0, y1, curve0, curve1))
    length = t[-1]
    slope = (y1 - y0) / length - length * (2 * curve0 + curve1) / 6
    bend = (curve1 - curve0) / length
    return (
        y0 + t * (slope + t * (curve0 / 2 + t * bend / 6)),
        slope + t * (curve0 + t * bend / 2),
        curve0 + t * bend,
    )


def _check_samples(samples: int) -> None:
    if samples < LEAST_SAMPLES:
        raise RecordingError(
            f"a rate of {samples} samples is needed, expected at least {LEAST_SAMPLES}; "
            "take a longer recording"
        )
