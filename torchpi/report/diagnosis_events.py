"""The diagnosis for TensorBoard: its numbers as scalars, its figures as images."""

from pathlib import Path

from matplotlib.figure import Figure

from torchpi.diagnosis.diagnosis import Diagnosis
from torchpi.report.diagnosis_figures import diagnosis_figures


def write_tensorboard(
    diagnosis: Diagnosis, output_dir: str | Path, figures: dict[str, Figure] | None = None
) -> Path:
    """Write events into `output_dir/tensorboard`; return that folder.

    Args:
        diagnosis: What was found.
        output_dir: The diagnosis's own folder.
        figures: Those of the page, where they are drawn already.
    """
    # It takes a second to import, and every page imports this package.
    from torch.utils.tensorboard import SummaryWriter

    folder = Path(output_dir) / "tensorboard"
    with SummaryWriter(str(folder)) as board:
        for name, value in _scalars(diagnosis).items():
            board.add_scalar(name, value, 0)
        for name, figure in (figures or diagnosis_figures(diagnosis)).items():
            board.add_figure(name, figure, 0, close=False)
        board.add_text("says", diagnosis.says, 0)
    return folder


def _scalars(diagnosis: Diagnosis) -> dict[str, float]:
    fits = {"nominal": diagnosis.nominal, "retuned": diagnosis.retuned, "augmented": diagnosis.augmented}
    found = {"noise_floor_um": diagnosis.noise_floor_um, "unexplained_share": diagnosis.unexplained_share}
    for name, errors in fits.items():
        found[f"train_rms_um/{name}"] = errors.train_rms_um
        found[f"heldout_rms_um/{name}"] = errors.heldout_rms_um
        found[f"heldout_max_um/{name}"] = errors.heldout_max_um
    for effect in diagnosis.effects:
        found[f"probability/{effect.name}"] = effect.probability
        found[f"share/{effect.name}"] = effect.share
        for parameter in effect.parameters:
            if not isinstance(parameter.value, str):
                found[f"parameter/{effect.name}.{parameter.name}"] = parameter.value
    return found
