"""The results as Markdown."""

ROWS = (
    ("cases", "cases"),
    ("failed", "no answer"),
    ("precision", "precision when it names"),
    ("cases_with_a_wrong_name", "cases with a wrong name (false alarms in nulls)"),
    ("group_at_2", "right group, ≥ 2×"),
    ("group_at_1", "right group, 0.7–2×"),
    ("exact_where_separable", "exact name where separable, ≥ 2×"),
    ("exact_sets", "exact sets"),
    ("f1", "F1"),
    ("unknown_without_a_wrong_name", "unknown: no wrong name"),
    ("unknown_recognised", "unknown: recognised"),
    ("unknown_heldout_improves", "unknown: held-out fit improves"),
    ("parameter_error_median", "parameters, median relative error, ≥ 2×"),
    ("parameters_compared", "parameters that could be compared"),
    ("interval_coverage", "90 % intervals cover"),
    ("heldout_over_noise_median_explained", "held-out residual over noise, explained"),
    ("heldout_over_noise_median", "held-out residual over noise, all"),
    ("closed_beyond_twice_the_noise", "explained or nothing missing, yet held-out over 2 × noise"),
    ("diagnose_s_median", "seconds, median"),
)


def table(summary: dict) -> str:
    """One column a track, one row a figure; counts stand beside shares."""
    tracks = summary["tracks"]
    lines = ["| | " + " | ".join(tracks) + " |", "|---|" + "---|" * len(tracks)]
    for key, words in ROWS:
        cells = [_cell(figures.get(key)) for figures in tracks.values()]
        if any(cell != "–" for cell in cells):
            lines.append(f"| {words} | " + " | ".join(cells) + " |")
    precision, alarms = (summary["together"][key] for key in ("precision", "false_alarms"))
    if precision["of"]:
        bound = f"at least {100 * precision['at_least']:.1f} %"
        lines += ["", f"Precision over all tracks: {_cell(precision)}, {bound} with 95 % confidence."]
    if alarms["of"]:
        bound = f"at most {100 * alarms['at_most']:.1f} %"
        lines += [
            "",
            f"False alarms where nothing is missing: {_cell(alarms)}, {bound} with 95 % confidence.",
        ]
    lines += ["", "| severity | cases | right group | wrong |", "|---|---|---|---|"]
    for row in summary["detection"]:
        if row["cases"]:
            name = "" if row["measure"] == "severity" else " beyond the plays"
            to = "and above" if row["to"] is None else f"– {row['to']:g}×"
            lines.append(
                f"| {row['from']:g} {to}{name} | {row['cases']} | {row['right_group']} | {row['wrong']} |"
            )
    return "\n".join(lines) + "\n"


def _cell(value: object) -> str:
    if value is None:
        return "–"
    if isinstance(value, dict):
        return (
            "–"
            if value["share"] is None
            else f"{100 * value['share']:.0f} % ({value['count']}/{value['of']})"
        )
    return f"{value:.3g}" if isinstance(value, float) else str(value)
