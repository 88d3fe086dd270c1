"""Reading and writing files: written whole or not at all, and read only if they are what was written."""

import atexit
import contextlib
import fcntl
import glob
import hashlib
import io
import os
import re
import shutil
import tempfile
import warnings
import zipfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import islice
from pathlib import Path
from typing import Any

from torchpi.errors import ArtifactError, ConfigError, kind_of

PACKAGE = Path(__file__).parent
# A wheel contains `configs/` inside the package; in a checkout it lies beside the package.
CONFIGS = next((path for path in (PACKAGE / "configs", PACKAGE.parent / "configs") if path.is_dir()), PACKAGE)
NAME = r"[\w-]+"  # name of a config in CONFIGS; anything else is a path
LARGEST_YAML_BYTES = 2**20  # a hundred times the size of the longest recipe
MOST_YAML_VALUES = 100_000


def config_file(given: str | Path, folder: str = "") -> Path:
    """Return the file of a config or a stage: one of torchpi's own by name (`default`), or any by path.

    Args:
        given: A single word is a name; anything else is a path, which is returned unchanged.
        folder: Subfolder of `configs/` in which names are looked up, such as `stage`.

    Raises:
        ConfigError: If a word is neither a name nor a file.
        ArtifactError: If `given` is not a path.
    """
    as_path(given)
    own = CONFIGS / folder / f"{given}.yaml"
    if is_own_config(given, folder):
        return own
    if re.fullmatch(NAME, str(given)) and not os.path.lexists(given):
        names = ", ".join(sorted(path.stem for path in own.parent.glob("*.yaml")))
        raise ConfigError(f"{given}: no such file or name, expected a path or one of {names}")
    return Path(given)


def as_path(path: object) -> Path:
    """Return an argument that names a file or a folder as a `Path`.

    Raises:
        ArtifactError: If it is anything else.
    """
    if not isinstance(path, str | os.PathLike):
        raise ArtifactError(f"path: found {kind_of(path)}, expected the path of a file or a folder")
    return Path(path)


def is_own_config(given: str | Path, folder: str = "") -> bool:
    """Whether this is the name of one of torchpi's own configs, as in `config_file`."""
    return bool(re.fullmatch(NAME, str(given))) and (CONFIGS / folder / f"{given}.yaml").is_file()


@contextlib.contextmanager
def write_atomically(path: str | Path) -> Iterator[Path]:
    """Yield a temporary path beside `path`; on success it replaces `path` in one step.

    If the block raises, or the process is killed, the previous file at `path` remains intact. A link is
    followed: the file it points to is replaced. The temporary name keeps the suffix, because some writers
    choose their format by it; temporary files left by processes that were killed are removed.

    Raises:
        ArtifactError: If `path` is a folder or a device, or the system does not allow writing there.
    """
    try:
        target = _regular(as_path(path))
        target.parent.mkdir(parents=True, exist_ok=True)
        handle, temporary = _temporary(target)
        try:
            yield temporary
            to_disk(temporary)
            temporary.chmod(0o644)
            os.replace(temporary, target)
        finally:
            temporary.unlink(missing_ok=True)
            os.close(handle)
    except OSError as error:
        raise ArtifactError(f"{path}: cannot be written ({reason(error)})") from error


def write_text(path: str | Path, text: str) -> None:
    """Write a text file with `write_atomically`.

    Raises:
        ArtifactError: As `write_atomically`.
    """
    with write_atomically(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def write_columns(path: str | Path, names: Sequence[str], columns: Iterable[Sequence[float]]) -> None:
    """Write columns of numbers as CSV with a header of names, every double exact, with `write_atomically`.

    Raises:
        ArtifactError: As `write_atomically`.
    """
    row = ",".join(["%r"] * len(names))  # repr gives the fewest digits that read back as the same double
    rows = map(row.__mod__, zip(*columns, strict=True))
    with write_atomically(path) as temporary, open(temporary, "w", encoding="utf-8", newline="\n") as file:
        file.write(",".join(names) + "\n")
        while chunk := list(islice(rows, 100_000)):
            file.write("\n".join(chunk) + "\n")


def to_disk(path: Path) -> None:
    """Wait until a file is on its disk: some file systems report a full disk only then."""
    with open(path, "rb") as written:
        os.fsync(written.fileno())


def read_yaml_text(path: str | os.PathLike[str], most_values: int = MOST_YAML_VALUES) -> str:
    """Return the text of a YAML file, which must be small enough to be settings.

    Raises:
        ConfigError: If it is too large or not a file; the message names the file.
    """
    try:
        if Path(path).exists() and not Path(path).is_file():
            raise ConfigError(f"{path}: found a folder, a device or a pipe, expected a YAML file")
        with open(path, "rb") as file:
            content = file.read(LARGEST_YAML_BYTES + 1)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from error
    if len(content) > LARGEST_YAML_BYTES:
        raise ConfigError(f"{path}: found more than {LARGEST_YAML_BYTES} bytes, expected a file of settings")
    try:
        text = content.decode("utf-8-sig")
        check_yaml(text, most_values)
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path}: not valid YAML: byte {error.start} is not UTF-8") from error
    except ConfigError as error:
        raise ConfigError(f"{path}, {error}") from error
    return text


def check_yaml(text: str, most_values: int = MOST_YAML_VALUES) -> None:
    """Check that settings stay small once their aliases are expanded, as any code that walks them does. Nine
    lists of nine aliases, each to the previous list, stand for 10⁹ values.

    Text that is not YAML passes here; loading it raises.

    Raises:
        ConfigError: If they do not; the message begins with the line.
    """
    import yaml

    sizes: dict[str, int] = {}  # number of values that each anchor stands for
    opened: list[tuple[str | None, int]] = [(None, 0)]  # open collections: anchor, values so far
    try:
        for event in yaml.parse(text, Loader=yaml_loader()):
            match event:
                case yaml.CollectionStartEvent():
                    opened.append((event.anchor, 1))
                    continue
                case yaml.CollectionEndEvent():
                    anchor, size = opened.pop()
                case yaml.AliasEvent(anchor=str() as alias):
                    # An alias inside the collection that it stands for never ends.
                    anchor, size = None, sizes.get(alias, most_values)
                case yaml.ScalarEvent():
                    anchor, size = event.anchor, 1
                case _:
                    continue
            if anchor is not None:
                sizes[anchor] = size
            outer, before = opened[-1]
            opened[-1] = outer, before + size
            if before + size > most_values:
                raise ConfigError(
                    f"line {_line(event)}: found more than {most_values} values, "
                    "with aliases expanded, expected at most that many"
                )
    except yaml.YAMLError:
        return


def _line(event: Any) -> int:
    return int(event.start_mark.line) + 1


def yaml_loader() -> Any:
    """Return the YAML loader of plain values, compiled if available: pure Python is ten times slower."""
    import yaml

    return getattr(yaml, "CSafeLoader", yaml.SafeLoader)


def check_output_folder(path: Path) -> None:
    """Check, before results are computed, that they can be written into this folder; it need not exist yet.

    Raises:
        ArtifactError: If they cannot.
    """
    try:
        existing = next(one for one in (path, *path.absolute().parents) if one.exists() or one.is_symlink())
        if not existing.is_dir():
            raise ArtifactError(f"{path}: {existing} is a file, expected a folder")
        if not os.access(existing, os.W_OK | os.X_OK):
            raise ArtifactError(f"{path}: cannot be written (no permission to write into {existing})")
    except OSError as error:
        raise ArtifactError(f"{path}: cannot be written ({reason(error)})") from error


def provide_cache_folders() -> None:
    """Let Numba and Matplotlib cache in a temporary folder if neither the package nor the home is writable.
    Numba refuses to compile without a cache folder. Processes started from here share it."""
    home = Path(os.path.expanduser("~"))
    caches = Path(os.environ.get("XDG_CACHE_HOME", home / ".cache"))
    configs = Path(os.environ.get("XDG_CONFIG_HOME", home / ".config"))
    beside = Path(__file__).parent / "__pycache__"
    missing = []
    if "NUMBA_CACHE_DIR" not in os.environ and not (_holds_files(beside) or _holds_files(caches / "numba")):
        missing.append("NUMBA_CACHE_DIR")
    if "MPLCONFIGDIR" not in os.environ and not _holds_files(configs / "matplotlib"):
        missing.append("MPLCONFIGDIR")
    if missing:
        # The folder is new and belongs to this user alone, because Numba executes what it reads from it.
        folder = tempfile.mkdtemp(prefix="torchpi-")
        os.environ.update(dict.fromkeys(missing, folder))
        owner = os.getpid()

        def remove() -> None:
            if os.getpid() == owner:  # not in a forked child
                shutil.rmtree(folder, ignore_errors=True)

        atexit.register(remove)


def _holds_files(folder: Path) -> bool:
    """Whether a file can be created there, creating missing folders if necessary."""
    if not folder.is_absolute():
        return False
    existing = next(one for one in (folder, *folder.parents) if os.path.lexists(one))
    return existing.is_dir() and os.access(existing, os.W_OK | os.X_OK)


def reason(error: OSError) -> str:
    """Return the operating system's text for an error, such as "no space left on device"."""
    return (error.strerror or str(error) or type(error).__name__).lower()


def _regular(path: Path) -> Path:
    """Return the path with links resolved, after checking that a file may be written or replaced there."""
    target = Path(os.path.realpath(path))
    if target.is_symlink():
        raise ArtifactError(f"{path}: found a link that leads to itself, expected a file or a new name")
    if target.is_dir():
        raise ArtifactError(f"{path}: found a folder, expected a file or a new name")
    if target.exists() and not target.is_file():
        raise ArtifactError(f"{path}: found a device or a pipe, expected a file or a new name")
    return target


def _temporary(target: Path) -> tuple[int, Path]:
    """Create a file beside `target`; it is locked as long as its handle is open."""
    # File names are limited in bytes; the first part of a long name is enough.
    prefix = f".{target.stem[:40]}-"
    for stale in target.parent.glob(f"{glob.escape(prefix)}????????{glob.escape(target.suffix)}"):
        with contextlib.suppress(OSError):
            handle = os.open(stale, os.O_RDWR | os.O_NOFOLLOW)
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
                stale.unlink()  # unlocked, so the process that wrote it was killed
            finally:
                os.close(handle)
    while True:
        handle, name = tempfile.mkstemp(prefix=prefix, suffix=target.suffix, dir=target.parent)
        with contextlib.suppress(OSError):  # the file system may not support locks
            fcntl.flock(handle, fcntl.LOCK_EX)
        if os.fstat(handle).st_nlink:  # else another process removed it as stale before it was locked
            return handle, Path(name)
        os.close(handle)


def save_tensors(content: Any, path: Path) -> None:
    """Save with `torch.save`, giving equal bytes for equal content. Given a path, torch would store the file
    name inside, and report a full disk with an error type of its own."""
    import torch

    buffer = io.BytesIO()
    torch.save(content, buffer)
    path.write_bytes(buffer.getvalue())


def load_tensors(path: Path, largest_bytes: int, wrong: str) -> Any:
    """Load what `save_tensors` or torch wrote: only plain values and tensors, nothing executable.

    Raises:
        ArtifactError: If the file is anything else (the message is `wrong`) or a broken archive.
    """
    import torch

    try:
        with warnings.catch_warnings():
            # torch warns before it refuses a TorchScript file; the error raised below says enough.
            warnings.filterwarnings("ignore", message=".*TorchScript archive.*")
            content = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # arbitrary bytes can make the unpickler raise any exception
        raise ArtifactError(f"{path}: {wrong}") from error
    check_archive(path, largest_bytes)
    return content


def file_sha256(path: str | Path) -> str:
    """Return the SHA-256 hash of a file's bytes."""
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def content_sha256(content: Any) -> str:
    """Return the SHA-256 hash of plain values and tensors in nested mappings and sequences (a saved model).

    Raises:
        ArtifactError: If a value is of another type.
    """
    digest = hashlib.sha256()
    _digest(digest, content)
    return digest.hexdigest()


def _digest(digest: Any, content: Any) -> None:
    import torch  # slow to import, and not needed for files without tensors
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
    """Check that a file is an undamaged zip archive with at most `largest_bytes` of content in total.

    torch does not verify the checksums of the archives that it reads.

    Raises:
        ArtifactError: If it is not.
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
    except Exception as error:  # arbitrary bytes can make the archive reader raise any exception
        raise ArtifactError(
            f"{path}: not an archive, or a damaged one; expected one saved by torch"
        ) from error
    if damaged is not None:
        raise ArtifactError(f"{path}: damaged in '{damaged}'; expected the file as it was written")
