"""The reference filter, Qin et al. (2013), eq. 14: every trajectory starts from rest.

    ÿ_d + 2ζω ẏ_d + ω² y_d = ÿ_r + 2ζω ẏ_r + ω² y_r,   y_d(0) = ẏ_d(0) = 0

Both sides share one polynomial, so e = y_d - y_r obeys ë + 2ζω ė + ω² e = 0 from e(0) = -y_r(0),
ė(0) = -ẏ_r(0): a free decay, which the matrix exponential gives exactly at any sample rate.
"""

import math

import torch
from torch import Tensor, nn

from torchpi.errors import ConfigError, check_positive, is_number
from torchpi.operators.base import check_records
from torchpi.operators.motion import BackwardMotionStream, Motion


class ReferenceFilter:
    """The paper's second-order filter of the reference trajectory, exact in discrete time.

    It is eq. 14.

    Args:
        sample_period_s: T.
        natural_frequency_rad_s: ω; the paper's 200π rad/s by default.
        damping_ratio: ζ; the paper's 1, aperiodic, by default.

    Raises:
        ConfigError: A period or frequency that is not positive, or negative damping.

    Example:
        >>> import torch
        >>> from torchpi import ReferenceFilter
        >>> step = torch.ones(1, 200, dtype=torch.float64)  # of 1 µm, at 10 kHz
        >>> motion = ReferenceFilter(sample_period_s=1e-4)(step)
        >>> [round(motion.yd[0, k].item(), 2) for k in (0, 20, 100, 199)]
        [0.0, 0.36, 0.99, 1.0]
    """

    def __init__(
        self,
        sample_period_s: float,
        natural_frequency_rad_s: float = 200 * math.pi,
        damping_ratio: float = 1.0,
    ) -> None:
        for name, value, unit in (
            ("sample_period_s", sample_period_s, "s"),
            ("natural_frequency_rad_s", natural_frequency_rad_s, "rad/s"),
        ):
            check_positive(name, value, unit)
        if not (is_number(damping_ratio) and 0 <= damping_ratio < math.inf):
            raise ConfigError(
                f"damping_ratio: found {damping_ratio!r}, expected a number that is not negative"
            )
        self.sample_period_s = sample_period_s
        self.natural_frequency_rad_s = natural_frequency_rad_s
        self.damping_ratio = damping_ratio

    def __call__(
        self,
        yr: Tensor,  # (batch, time), µm
        yr_dot: Tensor | None = None,  # (batch, time), µm/s
        yr_ddot: Tensor | None = None,  # (batch, time), µm/s²
    ) -> Motion:
        """Filter a reference; derivatives that are not given are formed from its samples.

        In that case the initial rate comes from the first two samples.

        Raises:
            ConfigError: `yr` is not a tensor (batch, time) of floating-point numbers.
        """
        check_records(yr, "yr")
        if yr_dot is None or yr_ddot is None:
            stream = self.stream()
            rows = []
            for row in yr.tolist():
                stream.reset()
                rows.append([stream.step(sample) for sample in row])
            yd, yd_dot, yd_ddot = torch.tensor(rows, dtype=yr.dtype).unbind(-1)
            return Motion(yd, yd_dot, yd_ddot)
        t = self.sample_period_s * torch.arange(yr.shape[1], dtype=yr.dtype)
        start = -torch.stack([yr[:, 0], yr_dot[:, 0]], -1)
        decay = torch.linalg.matrix_exp(self._dynamics() * t[:, None, None])  # (time, 2, 2)
        e, e_dot = torch.einsum("tij,bj->bit", decay, start).unbind(1)
        return Motion(yr + e, yr_dot + e_dot, yr_ddot + self._e_ddot(e, e_dot))

    def stream(self) -> "ReferenceFilterStream":
        """Return a scriptable stream whose `step(y_r)` returns (y_d, its rate, its acceleration)."""
        decay = torch.linalg.matrix_exp(self._dynamics() * self.sample_period_s)
        return ReferenceFilterStream(
            self.sample_period_s, decay.flatten().tolist(), self.natural_frequency_rad_s, self.damping_ratio
        )

    def _dynamics(self) -> Tensor:
        omega, zeta = self.natural_frequency_rad_s, self.damping_ratio
        return torch.tensor([[0.0, 1.0], [-omega * omega, -2.0 * zeta * omega]], dtype=torch.float64)

    def _e_ddot(self, e: Tensor, e_dot: Tensor) -> Tensor:
        return decay_acceleration(e, e_dot, self.natural_frequency_rad_s, self.damping_ratio)  # type: ignore


def decay_acceleration(e: float, e_dot: float, omega: float, zeta: float) -> float:
    """Return ë = -ω² e - 2ζω ė. Also for tensors."""
    return -(omega * omega) * e - (2.0 * zeta * omega) * e_dot


class ReferenceFilterStream(nn.Module):
    """The filter, one sample at a time."""

    decay: list[float]

    def __init__(self, sample_period_s: float, decay: list[float], omega: float, zeta: float) -> None:
        super().__init__()
        self.reference = BackwardMotionStream(sample_period_s)
        self.sample_period_s = sample_period_s  # s
        self.decay = decay  # exp(A T), row by row
        self.omega = omega  # rad/s, eq. 14
        self.zeta = zeta  # 1, eq. 14
        self.samples_seen = 0
        self.e = 0.0
        self.e_dot = 0.0

    @torch.jit.export
    def reset(self) -> None:
        self.reference.reset()
        self.samples_seen = 0

    @torch.jit.export
    def reset_at(self, yr: float) -> None:
        """Start from a reference that has rested at `yr` until y_d reached it."""
        self.reference.reset_at(yr)
        self.samples_seen = 2
        self.e = 0.0
        self.e_dot = 0.0

    @torch.jit.export
    def step(self, yr: float) -> tuple[float, float, float]:
        previous = self.reference.y1
        _, rate, acceleration = self.reference.step(yr)
        if self.samples_seen == 0:
            self.samples_seen = 1
            self.e = -yr
            # At rest whatever the rate of y_r, which the second sample will tell.
            return 0.0, 0.0, 0.0
        if self.samples_seen == 1:
            self.samples_seen = 2
            rate = (yr - previous) / self.sample_period_s
            acceleration = 0.0
            self.e_dot = -rate
        e = self.decay[0] * self.e + self.decay[1] * self.e_dot
        self.e_dot = self.decay[2] * self.e + self.decay[3] * self.e_dot
        self.e = e
        return (
            yr + e,
            rate + self.e_dot,
            acceleration + decay_acceleration(e, self.e_dot, self.omega, self.zeta),
        )


def motion_stream(
    sample_period_s: float, reference_filter: ReferenceFilter | None
) -> "BackwardMotionStream | ReferenceFilterStream":
    """Return a stream of (y_d, its rate, its acceleration), from the filter, else from past samples alone."""
    return BackwardMotionStream(sample_period_s) if reference_filter is None else reference_filter.stream()
