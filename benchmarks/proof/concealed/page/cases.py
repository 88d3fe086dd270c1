"""Single cases, drawn again from their seeds: recordings, the tool's answer, and the residual of plays."""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from concealed.cases import Case
from concealed.page.figures import save
from concealed.rivals.baseline import nominal, ridge
from concealed.tracks import draw


def drawn(results: dict, name: str, data: Path) -> Case:
    """Draw the case `TRACK/case_0001` of a run again."""
    track, _, case = name.partition("/")
    return draw(track, results["seeds"][track], int(case.removeprefix("case_")) - 1, data)


def story(results: dict, name: str, case: Case, picture: str) -> str:
    """Describe what was recorded and concealed, what the tool said, and how its answer was graded."""
    graded = next(c for c in results["cases"] if f"{c['track']}/{c['case']}" == name)
    runs = case.recordings
    rates = {f"{1 / float(np.median(np.diff(run['time_s']))):.6g}" for run in runs}
    low, high = min(run["input_v"].min() for run in runs), max(run["input_v"].max() for run in runs)
    given = (
        f"**Given**: {len(runs)} recording{'s' * (len(runs) > 1)} of {_spoken(graded['family'])}, "
        f"{sum(run['time_s'].size for run in runs):,} samples at {' and '.join(sorted(rates))} Hz, "
        f"{low:.3g} to {high:.3g} V."
    )
    missing = [
        f"{_spoken(one)} ({_spoken(graded['forms'].get(one, 'one form'))}), {size:.2g} × the noise"
        for one, size in graded["severities"].items()
    ]
    right = ", ".join(graded["found"]) or "none"
    wrong = ", ".join(graded["wrong"]) or "none"
    said = graded["failed"] or results["said"].get(name) or "nothing in words"
    return "\n\n".join(
        [
            f"### {name}",
            given,
            f"**Concealed**: {'; '.join(missing) or 'nothing'}.",
            picture,
            f"**The answer**: “{said}”",
            f"**Right**: {_spoken(right)}; wrong: {_spoken(wrong)}; verdict: {_spoken(graded['verdict'])}.",
        ]
    )


def _spoken(name: str) -> str:
    return name.replace("_", " ")


def picture(case: Case, name: str, path: Path) -> None:
    """Draw the first recording as a loop, and the residual of forty plays."""
    run, noise_um = case.recordings[0], float(case.labels["noise_rms_um"])
    plays = nominal(run, float(np.max(np.abs(run["input_v"]))) or 1.0)
    left = run["output_um"] - plays @ ridge(plays, run["output_um"])
    some = slice(None, None, max(left.size // 1200, 1))
    figure, (loop, time) = plt.subplots(1, 2, figsize=(11, 3), width_ratios=(1, 2), layout="constrained")
    loop.plot(run["input_v"][some], run["output_um"][some], linewidth=0.6)
    loop.set(xlabel="V", ylabel="µm", title=name)
    time.plot(run["time_s"][some], left[some], linewidth=0.6)
    time.axhspan(-2 * noise_um, 2 * noise_um, color="0.8", zorder=0)
    time.set(xlabel="s", ylabel="µm", title="what forty plays leave, over twice the noise")
    save(figure, path)
