"""The worst cases, drawn again from their seeds: what the tool was given, and what plays leave of it."""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from concealed.page.figures import save
from concealed.rivals.baseline import nominal, ridge
from concealed.tracks import draw


def picture(results: dict, name: str, data: Path, path: Path) -> None:
    """The case `TRACK/case_0001`: the first recording as a loop, and what forty plays leave of it."""
    track, _, case = name.partition("/")
    drawn = draw(track, results["seeds"][track], int(case.removeprefix("case_")) - 1, data)
    run, noise_um = drawn.recordings[0], float(drawn.labels["noise_rms_um"])
    plays = nominal(run, float(np.max(np.abs(run["input_v"]))) or 1.0)
    left = run["output_um"] - plays @ ridge(plays, run["output_um"])
    some = slice(None, None, max(left.size // 4000, 1))
    figure, (loop, time) = plt.subplots(1, 2, figsize=(11, 3), width_ratios=(1, 2), layout="constrained")
    loop.plot(run["input_v"][some], run["output_um"][some], linewidth=0.6)
    loop.set(xlabel="V", ylabel="µm", title=name)
    time.plot(run["time_s"][some], left[some], linewidth=0.6)
    time.axhspan(-2 * noise_um, 2 * noise_um, color="0.8", zorder=0)
    time.set(xlabel="s", ylabel="µm", title="what forty plays leave, over twice the noise")
    save(figure, path)
