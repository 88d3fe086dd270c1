"""The diagnosis for TensorBoard: its numbers as scalars, its figures as images."""

from pathlib import Path

from matplotlib.image import imread

from torchpi.diagnosis.diagnosis import Diagnosis


def write_tensorboard(diagnosis: Diagnosis, output_dir: str | Path) -> Path:
    """Write events into `output_dir/tensorboard`; return that folder.

    Args:
        diagnosis: The diagnosis to write.
        output_dir: The folder of the diagnosis, with the PNG figures that `write_diagnosis` wrote there.
    """
    # Imported here because it takes a second, and every page imports this package.
    from torch.utils.tensorboard import SummaryWriter

    folder = Path(output_dir) / "tensorboard"
    with SummaryWriter(str(folder)) as board:
        for name, value in _scalars(diagnosis).items():
            board.add_scalar(name, value, 0)
        for picture in sorted((Path(output_dir) / "figures").glob("*.png")):
            board.add_image(picture.stem, imread(picture)[..., :3], 0, dataformats="HWC")
        board.add_text("says", diagnosis.says, 0)
    return folder


def _scalars(diagnosis: Diagnosis) -> dict[str, float]:
    fits = {"nominal": diagnosis.nominal, "retuned": diagnosis.retuned, "augmented": diagnosis.augmented}
    found = {"unexplained_share": diagnosis.unexplained_share}
    if diagnosis.noise_floor_um is not None:
        found["noise_floor_um"] = diagnosis.noise_floor_um
    for name, errors in fits.items():
        found[f"train_rms_um/{name}"] = errors.train_rms_um
        found[f"heldout_rms_um/{name}"] = errors.heldout_rms_um
        found[f"heldout_max_um/{name}"] = errors.heldout_max_um
    for effect in diagnosis.effects:
        found[f"probability/{effect.name}"] = effect.probability
        found[f"share/{effect.name}"] = effect.share
        for rival in effect.rivals:
            found[f"rival_probability/{effect.name}.{rival.name}"] = rival.probability
        for parameter in effect.parameters:
            if not isinstance(parameter.value, str):
                found[f"parameter/{effect.name}.{parameter.name}"] = parameter.value
    return found
