"""The fitted parameters of a named effect, with their intervals."""

from collections.abc import Sequence
from dataclasses import replace

from torchpi.diagnosis.diagnosis import Parameter
from torchpi.diagnosis.free_parameters import to_outer, value_at
from torchpi.diagnosis.hypothesis import Fit
from torchpi.diagnosis.model import common_values
from torchpi.diagnosis.search import Search
from torchpi.diagnosis.stick_slip import Jump
from torchpi.stage.effects.mechanics.backlash import Backlash
from torchpi.stage.effects.mechanics.stiction import Stiction


def parameters_of(
    search: Search, final: Fit, spans: Sequence[tuple[float, float]], name: str
) -> tuple[Parameter, ...]:
    """Return the fitted parameters of one effect, with intervals.

    If the effect occurs several times, as modes or for several other axes, each occurrence has its own,
    `name[axis 1]`: first the frequencies of all modes, then their other parameters.
    """
    if search.jump and name == Stiction.name:
        return stiction_parameters(search.jump, final, spans)
    places = [i for i, one in enumerate(final.hypothesis.names) if one == name]
    if len(places) == 1:
        return parameters_of_member(search, final, spans, places[0])
    found: dict[str, list[Parameter]] = {}
    for number, place in enumerate(places, 1):
        label = f"{final.hypothesis.members[place].aux} {number}".strip()
        for one in parameters_of_member(search, final, spans, place):
            found.setdefault(one.name, []).append(replace(one, name=f"{one.name}[{label}]"))
    return tuple(one for each in found.values() for one in each)


def stiction_parameters(
    jump: Jump, final: Fit, spans: Sequence[tuple[float, float]]
) -> tuple[Parameter, ...]:
    """Return J - d, and d if the data separate it from plays: half the lost motion not due to slips alone."""
    value_um, span = jump
    parameters = [Parameter("jump_um", value_um, "µm", span)]
    for slot, (low, high), inner in zip(final.slots, spans, final.theta, strict=True):
        if slot.member >= 0 and final.hypothesis.members[slot.member].effect is Backlash:
            d = to_outer(slot, float(inner)) / 2
            parameters += [
                Parameter("sliding_um", d, "µm", (low / 2, high / 2)),
                Parameter("breakaway_um", value_um + d, "µm", (span[0] + low / 2, span[1] + high / 2)),
            ]
    return tuple(parameters)


def parameters_of_member(
    search: Search, final: Fit, spans: Sequence[tuple[float, float]], index: int
) -> tuple[Parameter, ...]:
    """Return the parameters of one member. Those that differ between recordings are listed for each one, as
    `name[recording]`; the bare name then holds the value that the augmented stage uses."""
    found: list[tuple[int | None, Parameter]] = []
    own: list[tuple[int | None, Parameter]] = []
    member = final.hypothesis.members[index]
    names = [record.name for record in search.chain.records]
    for slot, span in zip(final.slots, spans, strict=True):
        if slot.member == index:
            one = Parameter(
                slot.name, value_at(final.hypothesis, slot), member.effect.quantities[slot.name].unit, span
            )
            (found if slot.record is None else own).append((slot.record, one))
    shared = [one for _, one in found]
    for name in dict.fromkeys(one.name for _, one in own):
        each = [one for _, one in own if one.name == name]
        alone = len(each) == 1
        shared.append(each[0] if alone else together(each, common_values(member)[name]))
    if len(own) > 1:
        shared += [replace(one, name=f"{one.name}[{names[r or 0]}]") for r, one in own]
    return tuple(shared)


def together(each: Sequence[Parameter], value: float) -> Parameter:
    """Return the parameter for a future recording; its interval covers those of all recordings."""
    spans = [one.interval_90 for one in each if one.interval_90]
    return Parameter(
        each[0].name, value, each[0].unit, (min(low for low, _ in spans), max(high for _, high in spans))
    )


def shape_parameters(final: Fit, spans: Sequence[tuple[float, float]]) -> list[Parameter]:
    """Return the shape parameters of the hysteresis operator."""
    units = {"sigma_v": "V"}
    return [
        Parameter(slot.name, value_at(final.hypothesis, slot), units.get(slot.name, ""), span)
        for slot, span in zip(final.slots, spans, strict=True)
        if slot.member < 0 and slot.record is None
    ]
