"""Output files that appear whole or not at all."""

import contextlib
import os
import secrets
import stat
from collections.abc import Iterator
from pathlib import Path


def check_output(path: str | os.PathLike[str], *, force: bool = False) -> Path:
    """Whether a file may be written at `path`; to be asked before the long work.

    Raises:
        FileNotFoundError: the folder does not exist.
        IsADirectoryError: `path` is a folder.
        FileExistsError: the file exists and `force` is false.
    """
    path = Path(path)
    if path.is_dir():
        raise IsADirectoryError(f"{path} is a folder, expected the name of a file")
    if not path.parent.is_dir():
        raise FileNotFoundError(f"{path}: the folder {path.parent} does not exist")
    if path.is_file() and not force:
        raise FileExistsError(f"{path} exists; --force overwrites it")
    return path


@contextlib.contextmanager
def atomic_output(path: str | os.PathLike[str], *, force: bool = False) -> Iterator[Path]:
    """Context that yields a temporary path to write to and moves it to `path` at the end.

    The temporary file lies in the same folder and keeps the suffix, so that writers that choose a format by name do the
    right thing; nobody else may read it before it is whole. After an exception (Ctrl-C too) it is removed and `path` is
    as it was; after a kill at worst a file named `.<name>.<random>.part<suffix>` remains, never half a file at `path`.
    A link is followed; a device such as /dev/null is written directly.

    Raises:
        OSError: as `check_output`, at the start and again at the end.
    """
    check_output(path, force=force)
    final = Path(path).resolve()
    if final.exists() and not final.is_file():
        yield final
        return
    temporary = final.with_name(f".{final.stem}.{secrets.token_hex(4)}.part{final.suffix}")
    try:
        temporary.open("xb").close()
        # What any new file may do here (the umask decides), or what the file that is replaced may.
        mode = stat.S_IMODE((final if final.exists() else temporary).stat().st_mode)
        temporary.chmod(0o600)
        yield temporary
        with temporary.open("rb+") as file:
            os.fsync(file.fileno())
        check_output(final, force=force)
        temporary.chmod(mode)
        os.replace(temporary, final)
    finally:
        temporary.unlink(missing_ok=True)
