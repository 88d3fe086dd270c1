"""The fitted parameters of a hypothesis: where each is stored, its bounds, and the scale it is fitted on."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from torchpi.diagnosis.hypothesis import EffectTerm, FreeParameter, Hypothesis
from torchpi.operators.quantity import Quantity


def free_parameters_of(hypothesis: Hypothesis) -> tuple[FreeParameter, ...]:
    slots = []
    for name in hypothesis.shape:
        slots.append(shape_slot(name, hypothesis.nominal.scale_v))
    if hypothesis.remanent:
        for record in range(len(hypothesis.starts)):
            slots.append(FreeParameter(-1, START, record, False, 0.2, -2.0, 2.0))
    for k, member in enumerate(hypothesis.members):
        quantities = member.effect.quantities
        for name, value in member.shared.items():
            if name in member.effect.kinds:
                continue
            slots.append(slot(k, name, None, value, quantities[name], difference(member, name)))
        for record, own in enumerate(member.own):
            for name, value in own.items():
                slots.append(slot(k, name, record, value, quantities[name], difference(member, name)))
    return tuple(slots)


START = "start"
SHAPE_BOUNDS = {
    "sigma_v": (1e-3, 1e2, 1),
    "beta": (0.0, 3.0, 0),
    "exponent": (0.5, 6.0, 0),
    "alpha_per_v": (1e-2, 1e4, -1),
}
"""Bounds of each shape parameter for a reach of 1 V, and the power of the reach that they grow with."""


def shape_slot(name: str, reach_v: float) -> FreeParameter:
    low, high, power = SHAPE_BOUNDS[name]
    log = low > 0
    unit = reach_v**power
    return FreeParameter(-1, name, None, log, 0.2 if not log else 1.0, low * unit, high * unit)


def difference(member: EffectTerm, name: str) -> float:
    """Return the step of the finite difference in a parameter.

    The weights adapt to the samples that a limit already clips, so only a step large enough to reach further
    samples shows whether the limit lies there.
    """
    if name in member.effect.jumps:
        return 0.04
    return 3e-3 if name in member.effect.kinks else 1e-4


def slot(
    member: int, name: str, record: int | None, value: float, quantity: Quantity, step: float
) -> FreeParameter:
    log = quantity.at_least >= 0
    low, high = quantity.at_least, quantity.at_most
    if log:
        low, high = max(low, abs(value) * 1e-4, 1e-300), min(high, abs(value) * 1e4)
        return FreeParameter(member, name, record, True, 1.0, low, high, step)
    return FreeParameter(member, name, record, False, abs(value) or 1.0, low, high, step)


def to_inner(slot: FreeParameter, value: float) -> float:
    return math.log(value) if slot.log else value / slot.scale


def to_outer(slot: FreeParameter, inner: float) -> float:
    value = math.exp(min(inner, 700.0)) if slot.log else inner * slot.scale
    return min(max(value, slot.low), slot.high)


def at_bound(slot: FreeParameter, inner: float) -> bool:
    value = to_outer(slot, inner)
    span = 1e-6 * max(abs(slot.low), abs(slot.high)) if math.isfinite(slot.low + slot.high) else 0.0
    if slot.log:
        return value <= slot.low * 1.001 or value >= slot.high * 0.999
    return value <= slot.low + span or value >= slot.high - span


def value_at(hypothesis: Hypothesis, slot: FreeParameter) -> float:
    """Return the present value of a slot."""
    if slot.member < 0:
        return hypothesis.nominal.shape[slot.name] if slot.record is None else hypothesis.starts[slot.record]
    member = hypothesis.members[slot.member]
    return (member.shared if slot.record is None else member.own[slot.record])[slot.name]


def with_theta(hypothesis: Hypothesis, slots: Sequence[FreeParameter], theta: np.ndarray) -> Hypothesis:
    members, starts = list(hypothesis.members), list(hypothesis.starts)
    shape = {}
    for s, inner in zip(slots, theta, strict=True):
        value = to_outer(s, float(inner))
        if s.member < 0:
            if s.record is None:
                shape[s.name] = value
            else:
                starts[s.record] = value
            continue
        m = members[s.member]
        if s.record is None:
            members[s.member] = replace(m, shared={**m.shared, s.name: value})
        else:
            own = list(m.own)
            own[s.record] = {**own[s.record], s.name: value}
            members[s.member] = replace(m, own=tuple(own))
    nominal = hypothesis.nominal.with_shape(shape) if shape else hypothesis.nominal
    return replace(hypothesis, nominal=nominal, members=tuple(members), starts=tuple(starts))
