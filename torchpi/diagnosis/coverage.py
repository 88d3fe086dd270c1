"""What recordings cannot show, whatever is fitted: said before anything is decided."""

from collections.abc import Sequence

import numpy as np

from torchpi.diagnosis.records import Record
from torchpi.stage.effects.effect import Effect, Seen
from torchpi.stage.effects.inside import InsideEffect


def reason_to_leave_out(
    effect: type[Effect] | type[InsideEffect], records: Sequence[Record], seen: Seen, starts: int
) -> str | None:
    """Why an effect is no candidate on these recordings; None if it is one.

    Args:
        effect: What is asked for.
        records: The recordings.
        seen: What they span.
        starts: How many starts it has there, within its bounds.
    """
    needs = effect.needs
    if effect.takes_aux and not seen.aux:
        return "no other signal was recorded"
    if seen.duration_s < needs.duration_s:
        return f"{seen.duration_s:.2g} s is too short for it"
    if needs.reversals and not any(turns(record) for record in records):
        return "the voltage never turns round"
    if len(records) < needs.recordings:
        return f"it takes {needs.recordings} recordings"
    return effect.unseen if starts == 0 else None


def cannot_be_decided(records: Sequence[Record]) -> tuple[str, ...]:
    """A sentence for each question that these recordings leave open."""
    notes = []
    if len(records) == 1:
        notes.append(
            "One recording only: what another load, range or day would change cannot be said, and what was "
            "held out is of the same run."
        )
    if not any(turns(record) for record in records):
        notes.append(
            "The voltage never turns round: hysteresis cannot be seen, a curved characteristic fits as well."
        )
    still = [record.name for record in records if np.ptp(record.u) == 0]
    if still:
        notes.append(
            f"The voltage rests in {', '.join(still)}: noise, hum and drift show there, and no more."
        )
    constant = [name for name in records[0].aux if all(np.ptp(record.aux[name]) == 0 for record in records)]
    if constant:
        notes.append(f"Nothing moves in {', '.join(constant)}: whether it couples cannot be seen.")
    return tuple(notes)


def turns(record: Record) -> bool:
    """Whether the voltage goes up and down."""
    moved = np.diff(record.u)
    return bool((moved > 0).any() and (moved < 0).any())
