"""Configuration files that come along: vehicles, and mappings of other systems' logs, by path or by name."""

from __future__ import annotations

from pathlib import Path

from fbn_common.parameters import ParameterError


def config_file(name: str | Path, folder: str = "") -> Path:
    """The file of this path, or the one of this name in ``config/`` (or a folder of it).

    Raises ParameterError with the names there are.
    """
    places = [place / folder for place in (_source(), _installed())]
    for path in (Path(name), *(place / f"{name}.yaml" for place in places)):
        if path.is_file():
            return path
    raise ParameterError(f"{name}: no such file; those that come along, by name: {', '.join(names(folder)) or 'none'}")


def names(folder: str = "") -> list[str]:
    """The names of the files there are in ``config/``, or a folder of it."""
    return sorted({p.stem for place in (_source(), _installed()) for p in (place / folder).glob("*.yaml")})


def _source() -> Path:
    return Path(__file__).resolve().parents[1] / "config"


def _installed() -> Path:
    """Where the package is installed; the source where it is not, or where there is no ROS environment."""
    try:
        from ament_index_python.packages import get_package_share_directory

        return Path(get_package_share_directory("fbn_bringup")) / "config"
    except (ImportError, LookupError, OSError):
        return _source()
