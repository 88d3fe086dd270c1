"""Display of a recording in a notebook: the figure of `torchpi check`, and properties that need no model."""

from markupsafe import Markup

from torchpi.recordings.recording import Recording
from torchpi.recordings.summary import summary_of
from torchpi.report.check_page import recording_figure
from torchpi.report.notebook import Plot
from torchpi.report.words import figure


def recording_plot(recording: Recording) -> Plot:
    """Plot voltage and displacement over time, and displacement over voltage."""
    drawn = recording_figure(summary_of(recording))
    return Plot(drawn, f"{recording.name}: input and output over time, and output over input")


def recording_html(recording: Recording) -> str:
    """Return rate, length, ranges and noise as a table, followed by the figure."""
    if not len(recording):
        return str(Markup("<b>{}</b>: empty").format(recording.name))
    found = summary_of(recording)
    u, y = recording.u, recording.y
    noise = f"noise {figure(found.input_noise_v)} V" if found.input_is_noisy else "without noise"
    rows = [
        ("samples", f"{len(recording):,} at {recording.fs_hz:g} Hz, {recording.duration_s:.4g} s"),
        ("input", f"{u.min():.4g} … {u.max():.4g} V, {noise}"),
        ("output", f"{y.min():.4g} … {y.max():.4g} µm, noise {figure(found.output_noise_um)} µm"),
        ("gain", f"{figure(found.gain_um_per_v)} µm/V"),
        ("single wrong readings", f"{len(found.dropouts)}"),
    ]
    if recording.aux:
        rows.append(("other signals", ", ".join(recording.aux)))
    table = Markup("").join(Markup("<tr><td>{}</td><td>{}</td></tr>").format(*row) for row in rows)
    head = Markup("<b>{}</b><table>{}</table>").format(recording.name, table)
    return str(head + Markup(recording_plot(recording)._repr_html_()))
