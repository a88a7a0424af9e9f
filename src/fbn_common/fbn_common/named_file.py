"""Files that come along with a package, or lie anywhere: one argument for a name or a path."""

from __future__ import annotations

from importlib.resources.abc import Traversable
from pathlib import Path

from fbn_common.parameters import ParameterError


def file_names(directory: Traversable) -> tuple[str, ...]:
    """The names of the YAML files there."""
    return tuple(sorted(f.name.removesuffix(".yaml") for f in directory.iterdir() if f.name.endswith(".yaml")))


def read_named(name_or_path: str | Path, directory: Traversable, kind: str) -> str:
    """The text of a file by path, or of the one of this name in ``directory``.

    Raises ParameterError where it cannot be read, or with the names there are; ``kind`` says of what.
    """
    path = Path(name_or_path)
    if path.suffix == ".yaml" or path.exists():
        try:
            return path.read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError) as error:
            raise ParameterError(f"{path}: not a readable {kind} file: {error}") from error
    names = file_names(directory)
    if str(name_or_path) not in names:
        raise ParameterError(f"no {kind} {str(name_or_path)!r}; there are {', '.join(names)} (or give a .yaml file)")
    return directory.joinpath(f"{name_or_path}.yaml").read_text(encoding="utf-8")
