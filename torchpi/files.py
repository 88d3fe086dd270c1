"""Files appear whole or not at all, and are read only if they are what was written."""

import contextlib
import hashlib
import os
import tempfile
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from torchpi.errors import ArtifactError


@contextlib.contextmanager
def write_atomically(path: str | Path) -> Iterator[Path]:
    """Yield a temporary path beside `path`; on success it replaces `path` in one step.

    If the block raises, or the process is killed, whatever stood at `path` before is still there, whole.
    The temporary name keeps the suffix, because some writers choose their format by it.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(prefix=f".{path.stem}-", suffix=path.suffix, dir=path.parent)
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        with open(temporary, "rb") as written:
            os.fsync(written.fileno())
        temporary.chmod(0o644)
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def content_sha256(content: Any) -> str:
    """Hash of plain values and tensors, in whatever mappings and sequences: what a saved model carries.

    Raises:
        ArtifactError: A value of another type.
    """
    digest = hashlib.sha256()
    _digest(digest, content)
    return digest.hexdigest()


def _digest(digest: Any, content: Any) -> None:
    import torch  # slow to import, and files that hold no tensor do not need it
    from torch import Tensor

    match content:
        case Tensor():
            values = content.detach().cpu().contiguous()
            digest.update(f"tensor {values.dtype} {tuple(values.shape)}:".encode())
            digest.update(values.reshape(-1).view(torch.uint8).numpy().tobytes())
        case Mapping():
            digest.update(f"mapping {len(content)}:".encode())
            for name in sorted(content, key=str):
                digest.update(f"{name!r}=".encode())
                _digest(digest, content[name])
        case str() | bool() | int() | float() | None:
            digest.update(f"{content!r};".encode())
        case Sequence():
            digest.update(f"sequence {len(content)}:".encode())
            for value in content:
                _digest(digest, value)
        case _:
            raise ArtifactError(f"found a {type(content).__name__}, expected plain values and tensors")


def check_archive(path: Path, largest_bytes: int) -> None:
    """Whether a file is a zip archive whose parts are whole, and no larger in all than `largest_bytes`.

    torch does not look at the checksums of the archives that it reads.

    Raises:
        ArtifactError: It is not.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            size = sum(entry.file_size for entry in archive.infolist())
            if size > largest_bytes:
                raise ArtifactError(
                    f"{path}: found {size} bytes of content, expected at most {largest_bytes}"
                )
            damaged = archive.testzip()
    except ArtifactError:
        raise
    except Exception as error:  # bytes of anything make the readers of archives raise anything
        raise ArtifactError(
            f"{path}: not an archive, or a damaged one; expected one as torch saves"
        ) from error
    if damaged is not None:
        raise ArtifactError(f"{path}: damaged in '{damaged}'; expected the file as it was written")
