"""What the page of the paper says in words: titles, claims, and how what the paper leaves open is settled."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Text:
    """Of one section."""

    title: str
    says: str = ""  # the paper, in short
    explains: tuple[str, ...] = ()
    settled: tuple[str, ...] = ()


TEXTS: dict[str, Text] = {
    "fig3": Text(
        "Fig. 3 · Plays with negative weights make an inverse",
        says=(
            "with r = [0 .1 .3 .6 1] and w = [10 −5 −5/3 −5/6 −.5] the sum of plays forms the basic loop "
            "of the ideal inversion."
        ),
        explains=(
            (
                "It is exactly the conventional inverse of a Prandtl–Ishlinskii operator with r = [0 1 2 "
                "3 4] and all weights 0.1, so that one after the other gives the input back."
            ),
        ),
        settled=("The input's range is not given: ±2 here.",),
    ),
    "fig4": Text(
        "Fig. 4 · Polynomial against one-sided dead zones",
        says=(
            "a cubic needs three coefficients where six one-sided dead zones need eleven, and it is smooth."
        ),
        settled=(
            (
                "No coefficients are given: the cubic is one that a stage of 8.1 µm needs, the dead zones"
                " are fitted to it with evenly spaced thresholds."
            ),
        ),
    ),
    "polynomial": Text(
        "Polynomial against dead zones, identified on the stage",
    ),
    "fig5": Text(
        "Fig. 5 · What the polynomial does to the loop",
        says=(
            "S = 10⁻⁴ x⁵ + 2·10⁻³ x³ + 0.5 x (eq. 5) before the plays brings saturation into the loop of "
            "the inverse."
        ),
        settled=("The input's range is not given: ±10 here, which the near-vertical ends need.",),
    ),
    "fig7": Text(
        "Fig. 7 · A rate-dependent plant",
        says=("ten plays with weights k u̇ + b: the loop becomes larger as the frequency increases."),
        settled=(
            "Eq. 7 lists k₀ … kₙ but ten values: n = 10 operators, the first threshold 0.",
            "The rate is signed: only that makes the loops of the figure.",
            "“An amplitude of ten” is 0 … 10 V.",
            (
                "The paper prints no areas: those of the table were recomputed from its numbers, apart "
                "from torchpi."
            ),
        ),
    ),
    "fig8": Text(
        "Fig. 8 · The indirect approach on that plant, and the direct one",
        says=(
            "putting rate-dependent terms into the conventional inversion is negligibly wrong below 10 Hz"
            " and considerably above."
        ),
        explains=(
            (
                "The paper never runs the direct approach on this plant. It answers with its input's own "
                "rate and is not minimum-phase: an exact causal inverse is unstable, and any that does "
                "not look ahead stays at several per cent. torchpi's is one compensator for all four "
                "sines, learned from noisy multisine recordings of the plant, none at these frequencies; "
                "it looks ahead."
            ),
        ),
        settled=(
            "The plant's rate is that of its voltage, the inverse's that of y_d.",
            (
                "The last of five cycles is the steady state; the start is reported apart. y_d begins with a "
                "step from rest to 1 µm, and who looks ahead is first called that far into the sine, without "
                "its past: torchpi's start is the worse one."
            ),
            (
                "The paper prints no errors: the indirect ones were recomputed from its numbers, apart "
                "from torchpi."
            ),
            ("The plant takes any voltage: an inverse needs a little less than 0 V to come down to 1 µm."),
        ),
    ),
    "calibration": Text(
        "The stage · as hard as the paper's rig",
        says=(
            "modelling error within 0.21 µm past the initial loading, tracking errors within 0.22 µm "
            "(slow) and 0.23 µm (fast)."
        ),
        explains=(
            (
                "The simulated stage has what such a rig has: delay of computation and converter, the "
                "amplifier's lag, a lightly damped mode, hysteresis with curvature, creep, noise, "
                "quantisation. It is set so that the paper's own two stages, fitted to recordings of it, "
                "come out as they did on the rig."
            ),
        ),
        settled=(
            "The rig's mode is not given: comparable stages have 400 … 800 Hz with ζ = 0.01 … 0.03.",
            (
                "The 0.21 µm are an error of a voltage: here it is that error through the local slope of "
                "the loop."
            ),
        ),
    ),
    "jointly": Text(
        "All parameters at once against two stages",
    ),
    "two_sets": Text(
        "Two recordings against one",
    ),
    "multisine": Text(
        "A multisine against one 60 Hz sine",
    ),
    "table1": Text(
        "Table I · k and b",
        says=("lists the identified slope and offset vectors."),
        explains=(
            (
                "Neighbouring plays are nearly collinear, so that single weights are not determined "
                "though the loop is: another recording gives other numbers and the same voltage."
            ),
        ),
        settled=(
            "The paper's values are lost in the text at hand: they cannot be compared.",
            (
                "ẏ of a recording comes from a zero-phase differentiator: a backward difference is half a"
                " sample late."
            ),
        ),
    ),
    "fig10": Text(
        "Fig. 10 · Ideal inversion and identified model",
        says=(
            "the model fits the ideal inversion well but for the initial loading curve; beyond it the "
            "largest modelling error lies within 0.21 µm."
        ),
        settled=(
            "Error of a voltage, quoted in µm: both are given, with and without the initial loading.",
            "The initial loading ends where the voltage first is at its largest.",
            (
                "The coefficients of S are unique but for a scale, which only the thresholds fix: a ratio"
                " is compared."
            ),
        ),
    ),
    "learning": Text(
        "How torchpi learns the stage",
        explains=(
            (
                "From recordings of the sensor alone: the paper's two, multisines of several ranges, "
                "triangles with minor loops. Weights are solved for, everything else is searched by "
                "backpropagation through time. Look-ahead, a lead for lag and mode, relaxations for creep"
                " and output functions of the plays go beyond the paper."
            ),
        ),
    ),
    "ablation": Text(
        "What each part buys",
        explains=(
            (
                "Every line is learned from the same recordings as the others. Creep is worth most, and "
                "joint training is what makes the parts work. With the lead, weights that follow the rate "
                "add nothing on this stage; they stay for stages without one. A neural rate head is better "
                "in rms for some recordings and worse at most for others: it is not the default."
            ),
        ),
    ),
    "fig12": Text(
        "Fig. 12 · Tracking the slow and the fast trajectory",
        says=(
            "errors within −0.22 µm (slow, eq. 15) and −0.23 µm (fast, eq. 16), the largest within the "
            "initial loading; a little negative drift on the slow one."
        ),
        settled=(
            "Both trajectories pass the reference filter (eq. 14) from rest, on a de-energised stage.",
            (
                "The error is that of the true displacement at the tick at which it was wanted: every "
                "delay counts."
            ),
            "Beyond the record's end the motion is taken to rest, for compensators that look ahead.",
            "The initial loading ends where y_d first comes within 0.1 % of its largest.",
            (
                "Per cent are of the reference's peak to peak, 6 and 6.83 µm, and not of the rise from "
                "rest: the paper's 0.22 and 0.23 µm are 3.7 and 3.4 %."
            ),
        ),
    ),
    "methods": Text(
        "Every method in one table",
        says=(
            "the conventional inversion, rate-dependent terms put into it, thresholds that follow the "
            "rate, cascades and generalised plays are what others do."
        ),
        explains=(
            (
                "Each is fitted to the same two recordings, 5 Hz sine and eq. 13, of the plant or of the "
                "stage, and sees nothing else; torchpi's learns from more recordings. In the last pair of"
                " columns every method is fitted and run with torchpi's look-ahead, so that it is seen "
                "what that alone is worth."
            ),
        ),
        settled=(
            ("Forward models on the stage have dead zones for the saturation, as Kuhnen's and Ang's do."),
            "Fig. 8's indirect inverse is told the plant's own numbers; here its numbers are fitted.",
        ),
    ),
    "unseen": Text(
        "Trajectories that nothing was tuned for",
        explains=(
            (
                "Ten random ones over the band of eq. 15 and 16, 1 … 50 Hz, over 1 … 7 µm, through the "
                "reference filter."
            ),
        ),
    ),
    "fig13": Text(
        "Fig. 13 · Hysteresis before and after, as numbers",
        says=("the inverse model significantly reduces the hysteresis and improves the linearity."),
        explains=(
            (
                "Width is the widest distance of the branches up and down, nonlinearity the largest "
                "deviation of their middle from a straight line."
            ),
        ),
        settled=(
            ("Before is y_d over the gain of the stage's slow loop, a straight line through the origin."),
        ),
    ),
    "above_80hz": Text(
        "Beyond 80 Hz",
    ),
}
