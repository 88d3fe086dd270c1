"""The direct inverse compensator, Qin et al. (2013), Fig. 6 and eq. 6–8: desired trajectory in, voltage out.

    x_0 = y_d + τ_1 ẏ_d + τ_2 ÿ_d            undoes delay, lag and mode (extension; τ = 0 is the paper)
    x = x_0 + Σ_j g_j ξ_j,  T_j ξ̇_j = x_0 - ξ_j    undoes creep (extension; g = 0 is the paper)
    u = Σ_i w_i(ẏ_d, h_i) h_i + u_0,  h_i = H_ri[S(x)]    eq. 8; own output functions of the plays, and
                                                  an offset, on request (extensions)

It is identified from recordings of displacement and voltage, and never inverted.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import torch
from torch import Tensor, nn

from torchpi.control.reach import Reach, reach
from torchpi.control.step import CompensatorStream
from torchpi.control.step_guard import GuardedStep, StepLimits, step_limits
from torchpi.control.trained_motions import TrainedMotions
from torchpi.errors import ArtifactError, ConfigError, check_positive, is_number, is_whole
from torchpi.operators.compiled import HAS_COMPILER
from torchpi.operators.motion import Motion, check_motion
from torchpi.operators.play import PlayBank, play
from torchpi.operators.polynomial import Polynomial
from torchpi.operators.rate_weights import RateHead, RateWeights, squash
from torchpi.operators.reference_filter import ReferenceFilter, motion_stream
from torchpi.operators.relaxations import relaxations
from torchpi.operators.weighted_plays import weighted_plays
from torchpi.operators.weighted_sum import weighted_sum
from torchpi.recordings.identity import is_sha256

MOST_PLAYS = 200  # ten times the usual; the step is written out play by play
MOST_RELAXATIONS = 30
MOST_HIDDEN = 200
LARGEST_THRESHOLD = 1e12  # as for the values of a recording
HIGHEST_DEGREE = 30  # far above what any loop needs; files could ask for more


class DirectInverse(nn.Module):
    """Maps a desired motion to the voltage that produces it.

    Args:
        sample_period_s: T of the control loop and of the recordings.
        thresholds: r of the plays, in the unit of S(y), about µm; the first one 0 as in the paper.
        degree: m, degree of the saturation polynomial (eq. 4).
        rate: How the weights depend on the rate: `none` (eq. 6), `linear` (eq. 7) or `neural`.
        output_degree: Degree of the plays' own output functions; 1 is the paper's weighted sum, 2 or 3 fit
            loops that are asymmetric or differ with the bias.
        preview: How many samples ahead the desired trajectory is seen; 0 is the paper's case.
        lead: Order of the lead that undoes the stage's linear dynamics, 0 (the paper), 1 or 2.
        creep_time_constants_s: T_j of the relaxations that undo creep; none is the paper.
        offset: Whether a constant voltage u_0 is learned, for recordings with an arbitrary zero.
        min_voltage_v: Lower output limit.
        max_voltage_v: Upper output limit.
        range_um: A typical displacement, which scales the trained numbers to similar size.
        rate_scale_um_s: A typical rate, likewise.
        hidden: Size of the neural rate head.
        train_thresholds: Whether gradients reach the thresholds.
        trained: Ranges of what it was trained on, `TrainedMotions.plain()`; None if that is not known.
        max_slew_v_s: Largest rate of the deployed step's voltage, V/s; None for any.
        recordings_sha256: `recordings_sha256` of what it was trained on; None if that is not known.

    Raises:
        ConfigError: A value out of its range; the text names it.
    """

    def __init__(
        self,
        sample_period_s: float,
        thresholds: Sequence[float],
        degree: int = 4,
        rate: RateHead = "linear",
        output_degree: int = 1,
        preview: int = 0,
        lead: int = 0,
        creep_time_constants_s: Sequence[float] = (),
        offset: bool = False,
        min_voltage_v: float = 0.0,
        max_voltage_v: float = 10.0,
        range_um: float = 1.0,
        rate_scale_um_s: float = 1.0,
        hidden: int = 4,
        train_thresholds: bool = False,
        trained: Mapping[str, Sequence[float] | None] | None = None,
        max_slew_v_s: float | None = None,
        recordings_sha256: str | None = None,
    ) -> None:
        super().__init__()
        self.hyper_parameters: dict[str, Any] = {
            name: list(value) if isinstance(value, Sequence) and not isinstance(value, str) else value
            for name, value in locals().items()
            if name not in ("self", "__class__", "trained")
        }
        self.trained = None if trained is None else TrainedMotions.from_plain(trained)
        self.hyper_parameters["trained"] = None if self.trained is None else self.trained.plain()
        check_positive("sample_period_s", sample_period_s, "s")
        for name, power in (("degree", degree), ("output_degree", output_degree)):
            if not (is_whole(power) and 1 <= power <= HIGHEST_DEGREE):
                raise ConfigError(f"{name}: found {power}, expected 1 to {HIGHEST_DEGREE}")
        plays = PlayBank(thresholds, train_thresholds)
        counts = (
            ("thresholds", len(thresholds), MOST_PLAYS),
            ("thresholds", max(thresholds), LARGEST_THRESHOLD),
            ("creep_time_constants_s", len(creep_time_constants_s), MOST_RELAXATIONS),
            ("hidden", hidden, MOST_HIDDEN),
        )
        for name, count, most in counts:
            if count > most:
                raise ConfigError(f"{name}: found {count:g}, expected at most {most:g}")
        if not (is_whole(preview) and preview >= 0):
            raise ConfigError(f"preview: found {preview}, expected a number of samples that is not negative")
        if lead not in (0, 1, 2):
            raise ConfigError(f"lead: found {lead}, expected 0, 1 or 2")
        for value in creep_time_constants_s:
            check_positive("creep_time_constants_s", value, "s")
        for name, limit in (("min_voltage_v", min_voltage_v), ("max_voltage_v", max_voltage_v)):
            if not (is_number(limit) and math.isfinite(limit)):
                raise ConfigError(f"{name}: found {limit!r}, expected a voltage in V")
        if not min_voltage_v < max_voltage_v:
            found = f"found {min_voltage_v} V, expected a number below max_voltage_v, {max_voltage_v}"
            raise ConfigError(f"min_voltage_v: {found}")
        if max_slew_v_s is not None:
            check_positive("max_slew_v_s", max_slew_v_s, "V/s")
        if recordings_sha256 is not None and not is_sha256(recordings_sha256):
            found = f"found {recordings_sha256!r}, expected 64 hexadecimal digits"
            raise ConfigError(f"recordings_sha256: {found}")
        self.recordings_sha256 = recordings_sha256
        self.sample_period_s = sample_period_s
        self.preview = preview
        self.min_voltage_v = min_voltage_v
        self.max_voltage_v = max_voltage_v
        self.max_slew_v_s = max_slew_v_s
        self.scaled_lead = nn.Parameter(torch.zeros(lead, dtype=torch.float64))
        self.creep_gains = nn.Parameter(torch.zeros(len(creep_time_constants_s), dtype=torch.float64))
        self.creep_decay: Tensor
        periods = sample_period_s / torch.tensor(list(creep_time_constants_s), dtype=torch.float64)
        self.register_buffer("creep_decay", torch.exp(-periods), persistent=False)
        self.saturation = Polynomial([1.0] + [0.0] * (degree - 1), scale=range_um)
        self.plays = plays
        self.weights = RateWeights([0.0] * len(thresholds), rate, rate_scale_um_s, hidden)
        self.psi = nn.Parameter(torch.zeros(len(thresholds), output_degree - 1, dtype=torch.float64))
        self.range_um = range_um
        self.offset = nn.Parameter(torch.zeros((), dtype=torch.float64), requires_grad=offset)

    def forward(self, motion: Motion) -> Tensor:
        """Return the voltage for a desired motion from the de-energised state, within the output limits.

        Shapes: (batch, time) in µm, µm/s, µm/s² to (batch, time) in V. Sample t of the motion is the
        one `preview` periods ahead of sample t of the voltage.
        """
        check_motion(motion)
        return self.voltage(motion)[0].clamp(self.min_voltage_v, self.max_voltage_v)

    def voltage(
        self,
        motion: Motion,
        state: Tensor | None = None,  # (batch, relaxations + plays), in the units of y_d and of S(y)
    ) -> tuple[Tensor, Tensor]:
        """Return eq. 8 without the limits, which identification and training fit, and the state after it."""
        if motion.yd.device.type != "cpu" or not HAS_COMPILER:
            h, state = self.play_states(motion, state)
            return self.weighted(h, self.weights.basis(motion.yd_dot)), state
        x, creep, plays = self._compensated(motion, state)
        weights, dtype = self.weights, x.dtype
        knots = torch.stack([weights.slope, weights.shift], 1)
        # The same bits as above, and no tensor of (batch, time, plays).
        u, plays = weighted_plays(
            x,
            motion.yd_dot,
            plays.to(dtype),
            self.saturation.c.to(dtype),
            self.plays.r.to(dtype),
            weights.theta.to(dtype),
            knots.to(dtype),
            self.psi.to(dtype),
            self.offset.to(dtype),
            weights.rate_scale_um_s,
            self.range_um,
        )
        # In a pass of some milliseconds, concatenation has a noticeable cost even if one part is empty.
        return u, torch.cat([creep, plays], 1) if len(self.creep_gains) > 0 else plays.to(creep.dtype)

    def weighted(
        self,
        h: Tensor,  # (batch, time, plays), in the unit of S(y)
        basis: Tensor,  # (batch, time, functions of the rate), without unit
    ) -> Tensor:  # (batch, time), V
        """Return what is linear in the weights: Σ_i w_i h_i + u_0."""
        theta, psi, offset = (part.to(h.dtype) for part in (self.weights.theta, self.psi, self.offset))
        return weighted_sum(h, basis, theta, psi, self.range_um) + offset

    def play_states(self, motion: Motion, state: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """Return H_r[S(x)], (batch, time, plays), and the state after it, in the units of `voltage`."""
        x, creep, plays = self._compensated(motion, state)
        s, _ = self.saturation(x)
        h, plays = self.plays(s, plays)
        return h, torch.cat([creep, plays], 1)

    def _compensated(self, motion: Motion, state: Tensor | None) -> tuple[Tensor, Tensor, Tensor]:
        """Return x, which undoes delay and creep, the relaxations' state after it and the plays' before."""
        if state is None:
            state = self.initial_state(len(motion.yd))
        creep, plays = state.split([len(self.creep_gains), len(self.psi)], 1)
        x = motion.yd
        if len(self.scaled_lead) > 0:
            for tau, derivative in zip(self.lead.to(x.dtype), motion[1:], strict=False):
                x = x + tau * derivative
        if len(self.creep_gains) > 0:
            one = torch.ones((), dtype=torch.float64)
            x, creep = relaxations(x, self.creep_decay, 1.0 - self.creep_decay, self.creep_gains, one, creep)
        return x, creep, plays

    def initial_state(self, batch: int) -> Tensor:
        """Return the de-energised state. Shape: (batch, relaxations + plays)."""
        return self.offset.detach().new_zeros(batch, len(self.creep_gains) + len(self.psi))

    @property
    def lead(self) -> Tensor:
        """τ_1 in s, τ_2 in s², as many as the order of the lead."""
        # Trained in units of the sample period, in which it is of order one.
        powers = torch.arange(1, len(self.scaled_lead) + 1, dtype=torch.float64)
        return self.scaled_lead * self.sample_period_s**powers

    def at_rate(
        self,
        x: Tensor,  # (time,), µm
        rate_um_s: float = 0.0,
    ) -> Tensor:  # (time,), V
        """Return eq. 8 along x from the de-energised state at a constant rate; no lead, creep or limits."""
        h, _ = self.plays(self.saturation(x[None])[0])
        return self.weighted(h, self.weights.basis(torch.full_like(x, rate_um_s)[None]))[0]

    def reach(self, rate_um_s: float = 0.0) -> Reach:
        """Return the displacements at which the voltage of a motion at this rate meets the output limits."""
        with torch.no_grad():
            return reach(lambda x: self.at_rate(x, rate_um_s), self.min_voltage_v, self.max_voltage_v)

    def step_limits(self) -> StepLimits:
        """Return what the deployed step accepts, from the training and the reach of the output limits."""
        at_rest = self.reach()
        rates = (0.0, *self.trained.rates_um_s) if self.trained else (0.0,)
        found = [self.reach(rate) for rate in rates]
        # Creep carries the stage further than the immediate response to the voltage.
        further = 1 + float(self.creep_gains.detach().abs().sum())
        reached = Reach(
            further * min(one.low_um for one in found),
            further * max(one.high_um for one in found),
            at_rest.remanence_um,
        )
        return step_limits(
            self.sample_period_s,
            (self.min_voltage_v, self.max_voltage_v),
            reached,
            self.range_um,
            self.trained,
            self.max_slew_v_s,
        )

    def stream(self, reference_filter: ReferenceFilter | None = None) -> CompensatorStream:
        """Return the compensator as a scriptable stream: `u = step(y_d at t + preview)`.

        With a reference filter inside, `step` takes the reference y_r and uses the exact rate.
        """
        return DirectInverseStream(self, reference_filter)


class DirectInverseStream(GuardedStep):
    """The direct inverse of eq. 8, one sample at a time.

    Attributes:
        scratch: Lists that a step fills before it reads them.

    Raises:
        ArtifactError: A parameter is not finite.
    """

    scratch: ClassVar[tuple[str, ...]] = ("phi",)

    slope: list[float]
    shift: list[float]
    phi: list[float]
    k: list[float]
    theta: list[float]
    psi: list[float]
    g: list[float]
    kept: list[float]
    taken: list[float]
    xi: list[float]

    def __init__(self, compensator: DirectInverse, reference_filter: ReferenceFilter | None) -> None:
        for name, values in compensator.state_dict().items():
            if not bool(torch.isfinite(values).all()):
                raise ArtifactError(
                    f"{name}: found {values.tolist()}, expected finite numbers: the training diverged"
                )
        limits, trained = compensator.step_limits(), compensator.trained
        low, high = limits.accepted_um
        lead = [*compensator.lead.tolist(), 0.0, 0.0]
        weights, decay = compensator.weights, compensator.creep_decay.tolist()
        lead_um = trained.lead_limits(compensator.lead.tolist()) if trained else None
        sharpest = trained.accelerations_um_s2 if trained else None
        super().__init__(limits)
        self.motion: Any = motion_stream(compensator.sample_period_s, reference_filter)
        self.has_reference_filter = reference_filter is not None
        self.sample_period_s = compensator.sample_period_s
        self.preview = compensator.preview
        self.leads = len(compensator.scaled_lead) > 0
        self.leads_acceleration = len(compensator.scaled_lead) > 1
        self.limits_lead = self.leads and lead_um is not None
        self.limits_x = self.has_reference_filter or (self.leads and not self.limits_lead)
        self.creeps = len(decay) > 0
        self.follows_rate = weights.kind != "none"
        self.is_neural = len(weights.slope) > 0
        self.powers = compensator.psi.shape[1]
        self.has_output_functions = self.powers > 0
        self.has_offset = compensator.offset.item() != 0.0
        # Plain ASCII, because the comments go into C as well.
        self.least_lead_um, self.largest_lead_um = lead_um or (0.0, 0.0)  # um, at the trained motions
        self.least_trained_um_s2, self.largest_trained_um_s2 = sharpest or (0.0, 0.0)  # um/s^2
        self.tau_1 = lead[0]  # s, lead on the rate
        self.tau_2 = lead[1]  # s^2, lead on the acceleration
        self.least_x_um = 2 * low - high  # um, what leads and filter make of a jump
        self.largest_x_um = 2 * high - low  # um
        self.g = compensator.creep_gains.tolist()  # 1, share of relaxation i in creep
        self.kept = decay  # 1, what relaxation i keeps in one period
        self.taken = [1.0 - a for a in decay]  # 1, what relaxation i takes up in one period
        self.c = compensator.saturation.c.tolist()[::-1]  # um^(1-m) ... 1, polynomial, eq. 4
        self.rate_scale_um_s = weights.rate_scale_um_s  # um/s, unit of the rates
        self.slope = weights.slope.tolist()  # 1, function j of the rate
        self.shift = weights.shift.tolist()  # 1, function j of the rate
        self.range_um = compensator.range_um  # um, unit of the plays' own output functions
        self.r = compensator.plays.r.tolist()  # um, threshold of play i, eq. 1
        self.b = weights.theta[:, 0].tolist()  # V/um, weight of play i at rest, eq. 7
        self.k = weights.theta[:, 1:2].flatten().tolist()  # V/um, weight of play i times z, eq. 7
        self.theta = weights.theta[:, 2:].T.flatten().tolist()  # V/um, weights of the plays times function j
        self.psi = compensator.psi.flip(1).T.flatten().tolist()  # V/um, output functions, by falling power
        self.u_0 = compensator.offset.item()  # V, offset
        self.phi = [0.0] * len(self.slope)
        self.xi = [0.0] * len(decay)
        self.h = [0.0] * len(self.r)
        self.last_x = self.start_um
        self.lowest_x_um = self.start_um  # um, least x so far of motions no sharper than trained
        self.highest_x_um = self.start_um  # um, largest

    @torch.jit.export
    def reset(self) -> None:
        self.reset_guard()
        self.motion.reset()
        self.last_x = self.start_um
        self.lowest_x_um = self.start_um
        self.highest_x_um = self.start_um
        if self.creeps:
            for i in range(len(self.xi)):
                self.xi[i] = 0.0
        for i in range(len(self.h)):
            self.h[i] = 0.0

    @torch.jit.export
    def step(self, yd: float) -> float:
        self.accept(yd)
        y, rate, acceleration = self.motion.step(self.last_input)
        x = y
        if self.limits_lead:
            if self.smooth >= 4:
                x = self.led(y, rate, acceleration)
            else:
                # Without a lead, x might pass turning points of the motion, which wide plays never forget.
                x = self.last_x
            x = min(max(x, y + self.least_lead_um), y + self.largest_lead_um)
            if acceleration >= self.least_trained_um_s2 and acceleration <= self.largest_trained_um_s2:
                self.lowest_x_um = x if x < self.lowest_x_um else self.lowest_x_um
                self.highest_x_um = x if x > self.highest_x_um else self.highest_x_um
            else:
                x = self.within_turning_points(x, y)
            self.last_x = x
        elif self.leads:
            if self.smooth >= 4:
                x = self.led(y, rate, acceleration)
        if self.limits_x:
            x = min(max(x, self.least_x_um), self.largest_x_um)
        if self.creeps:
            crept = 0.0
            for i in range(len(self.xi)):
                crept = crept + self.g[i] * self.xi[i]
                self.xi[i] = self.kept[i] * self.xi[i] + self.taken[i] * x
            x = crept + x
        self.emit(self.law(x, rate))
        return self.last_voltage

    def within_turning_points(self, x: float, y: float) -> float:
        # What turns more sharply than trained may be a stray sample: its lead sets no turning point.
        least_x_um = y if y < self.lowest_x_um else self.lowest_x_um
        largest_x_um = y if y > self.highest_x_um else self.highest_x_um
        return min(max(x, least_x_um), largest_x_um)

    def led(self, x: float, rate: float, acceleration: float) -> float:
        x = x + self.tau_1 * rate
        if self.leads_acceleration:
            x = x + self.tau_2 * acceleration
        return x

    def at_rest(self, yd: float) -> float:
        # The states of a stage that has come from rest to yd and stood there, and the voltage.
        self.motion.reset_at(yd)
        self.last_x = yd
        self.lowest_x_um = yd if yd < self.start_um else self.start_um
        self.highest_x_um = yd if yd > self.start_um else self.start_um
        for i in range(len(self.h)):
            self.h[i] = 0.0
        x = yd
        if self.creeps:
            crept = 0.0
            for i in range(len(self.xi)):
                self.xi[i] = yd
                crept = crept + self.g[i] * self.xi[i]
            x = crept + x
        return self.law(x, 0.0)

    def law(self, x: float, rate: float) -> float:
        s = 0.0
        for i in range(len(self.c)):
            s = (s + self.c[i]) * x  # eq. 4
        z = rate / self.rate_scale_um_s
        if self.is_neural:
            for j in range(len(self.slope)):
                self.phi[j] = squash(self.slope[j] * z + self.shift[j])
        u = 0.0
        for i in range(len(self.r)):
            h = play(s, self.r[i], self.h[i])  # eq. 1
            self.h[i] = h
            w = self.b[i]
            if self.follows_rate:
                w = w + self.k[i] * z
            if self.is_neural:
                for j in range(len(self.slope)):
                    w = w + self.theta[j * len(self.r) + i] * self.phi[j]
            if self.has_output_functions:
                v = h / self.range_um
                own = 0.0
                for q in range(self.powers):
                    own = (own + self.psi[q * len(self.r) + i]) * v
                w = w + own
            u = u + w * h  # eq. 7, 8
        if self.has_offset:
            u = u + self.u_0
        return u
