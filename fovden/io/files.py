"""Files that are whole or not there."""

from __future__ import annotations

import os
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TypeAlias

__all__ = ["FilePath", "atomic_write"]

FilePath: TypeAlias = str | os.PathLike[str]
"""What names a file."""


@contextmanager
def atomic_write(path: FilePath) -> Iterator[Path]:
    """Gives the path of a temporary file in the same folder, which replaces ``path`` when the block ends well.

    If the block raises, the temporary file is removed and ``path`` stays as it was.

    Args:
        path: The file to write; its folder must exist.

    Yields:
        Where to write.

    Raises:
        FileNotFoundError: If the folder does not exist.
        IsADirectoryError: If ``path`` is a folder.

    Example:
        >>> import tempfile
        >>> folder = Path(tempfile.mkdtemp())
        >>> with atomic_write(folder / "note.txt") as temporary:
        ...     _ = temporary.write_text("done")
        >>> [file.name for file in folder.iterdir()]
        ['note.txt']
    """
    path = Path(path)
    if not path.parent.is_dir():
        raise FileNotFoundError(f"{path}: the folder {path.parent} does not exist")
    if path.is_dir():
        raise IsADirectoryError(f"{path}: expected the name of a file, but this is a folder")
    temporary = path.with_name(f".{path.name}.{uuid.uuid4().hex[:8]}.tmp")
    try:
        yield temporary
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)
