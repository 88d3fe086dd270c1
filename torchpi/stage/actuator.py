"""Second block: voltage to the displacement of the ceramic, with hysteresis and creep."""

from collections.abc import Sequence

from torchpi.errors import StageError
from torchpi.operators.creep import Creep
from torchpi.operators.polynomial import Polynomial
from torchpi.operators.prandtl_ishlinskii import PrandtlIshlinskii
from torchpi.stage.chain import Chain


class Actuator(Chain):
    """Curvature of the input, Prandtl–Ishlinskii hysteresis, logarithmic creep. Given nothing, 1 µm/V.

    Args:
        sample_period_s: T.
        input_polynomial_v: Coefficients of v, v², … with v in V, the result in V; None is a straight line.
            Its curvature makes the loop asymmetric.
        thresholds_v: r of the plays, none negative.
        weights_um_per_v: w of the plays, one a threshold. Their sum is the gain of a large swing.
        creep_per_decade: Share of a step added in each decade of time; None is no creep.
        creep_from_s: Where the logarithm begins to hold.
        creep_to_s: Where it ends.

    Raises:
        StageError: An unphysical value.
    """

    curvature: Polynomial | None
    hysteresis: PrandtlIshlinskii
    creep: Creep | None

    def __init__(
        self,
        sample_period_s: float,
        *,
        input_polynomial_v: Sequence[float] | None = None,
        thresholds_v: Sequence[float] = (0.0,),
        weights_um_per_v: Sequence[float] = (1.0,),
        creep_per_decade: float | None = None,
        creep_from_s: float = 0.1,
        creep_to_s: float = 100.0,
    ) -> None:
        check_plays(thresholds_v, weights_um_per_v)
        if input_polynomial_v is not None and not (len(input_polynomial_v) and input_polynomial_v[0] > 0):
            found = list(input_polynomial_v)
            raise StageError(f"input_polynomial_v: found {found}, want a positive first number")
        creep = None
        try:
            if creep_per_decade is not None:
                creep = Creep(sample_period_s, creep_per_decade, creep_from_s, creep_to_s)
        except StageError as error:
            raise StageError(f"creep_{error}") from error
        super().__init__(
            curvature=None if input_polynomial_v is None else Polynomial(list(input_polynomial_v)),
            hysteresis=PrandtlIshlinskii(list(thresholds_v), list(weights_um_per_v)),
            creep=creep,
        )

    def settings(self) -> dict[str, object]:
        """What the constructor takes, with the present values."""
        settings: dict[str, object] = {
            "thresholds_v": self.hysteresis.plays.r.tolist(),
            "weights_um_per_v": self.hysteresis.w.tolist(),
        }
        if self.curvature is not None:
            settings["input_polynomial_v"] = self.curvature.c.tolist()
        if self.creep is not None:
            settings["creep_per_decade"] = self.creep.per_decade.item()
            settings["creep_from_s"] = self.creep.from_s
            settings["creep_to_s"] = self.creep.to_s
        return settings


def check_plays(thresholds_v: Sequence[float], weights_um_per_v: Sequence[float]) -> None:
    """Raise `StageError` unless these can be the plays of an actuator that moves the right way."""
    if len(thresholds_v) == 0 or not all(0 <= r < float("inf") for r in thresholds_v):
        raise StageError(
            f"thresholds_v: found {list(thresholds_v)} V, want one number or more, none negative"
        )
    if len(weights_um_per_v) != len(thresholds_v):
        raise StageError(
            f"weights_um_per_v: found {len(weights_um_per_v)} numbers, "
            f"want {len(thresholds_v)}, one a threshold"
        )
    gain = sum(weights_um_per_v)
    if not 0 < gain < float("inf"):
        raise StageError(f"weights_um_per_v: their sum is {gain:g} µm/V, want a positive gain in µm/V")
