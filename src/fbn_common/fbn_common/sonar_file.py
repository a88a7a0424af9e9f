"""Sonar files: one YAML per sonar, named alike by vehicles' parameter files and the simulator's scenarios.

A file tells what does not depend on the vehicle: arrays relative to the head, fields of view, ranges, noise.  The
vehicle or the scenario tells by ``head.*`` which sonar it carries and where; single ``arrays.*`` go over the file's.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import resources
from importlib.resources.abc import Traversable
from math import pi
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from fbn_common.lie import matrix_from_rpy, rpy_from_matrix
from fbn_common.named_file import file_names, read_named
from fbn_common.parameters import ParameterError, dotted, flatten, group, load, param
from fbn_common.sonar import SonarArray

SOUND_SPEED = 1500.0  # m/s; sea and fresh water lie between 1,420 and 1,540
_MOUNT = ("mount_xyz", "mount_rpy")  # may be left out: the head itself
_FRAME = re.compile(r"[A-Za-z_]\w*")


@dataclass(frozen=True, slots=True)
class SonarHead:
    """Which sonar a vehicle carries, and where; its arrays move and turn with the head."""

    sonar: str = param("", "-", "sonar file: a name that comes along, or a path; empty: arrays.* tell all", "vehicle")
    mount_xyz: tuple[float, float, float] = param(
        (0.0, 0.0, 0.0), "m", "position of the head in base_link", "drawings of the vehicle"
    )
    mount_rpy: tuple[float, float, float] = param(
        (0.0, 0.0, 0.0), "rad", "turn of the head from forward: roll, pitch (down positive), yaw", "level, ahead"
    )


@dataclass(frozen=True, slots=True)
class SonarModel:
    """What a sonar file holds.  ``array`` in the file gives values that all of ``arrays`` share."""

    name: str = param("", "-", "what the sonar is called", "file")
    about: str = param("", "-", "what it is, in a line", "file")
    frequency: float = param(0.0, "Hz", "of the sound", "data sheet")
    aperture: float = param(0.0, "m", "length of one array along its axis", "wavelength over beam width")
    ping_rate: float = param(0.0, "Hz", "most pings a second", "data sheet, or what the detector manages")
    arrays: dict[str, SonarArray] = group(dict)
    simulation: dict[str, Any] = field(default_factory=dict)  # over the defaults of a scenario's sensors.sonar

    def __post_init__(self) -> None:
        if min(self.frequency, self.aperture, self.ping_rate) <= 0.0:
            raise ParameterError("frequency [Hz], aperture [m] and ping_rate [Hz] must be stated, and positive")
        if not self.arrays:
            raise ParameterError("arrays: a sonar has at least one, named as the frame_id of its detections")
        for name, array in self.arrays.items():
            self._check(name, array)

    def _check(self, name: str, array: SonarArray) -> None:
        if not _FRAME.fullmatch(name):
            raise ParameterError(f"arrays.{name}: a frame's name is letters, digits and _, and begins with no digit")
        if max(map(abs, array.mount_rpy)) > pi or array.lobe_width >= pi:
            raise ParameterError(f"arrays.{name}: mount_rpy and lobe_width are in radians, not degrees")
        if array.bearing_sigma >= array.bearing_max - array.bearing_min:
            raise ParameterError(f"arrays.{name}: bearing_sigma [rad] is wider than the field of view")
        if array.range_max > SOUND_SPEED / (2.0 * self.ping_rate):
            reach = SOUND_SPEED / (2.0 * self.ping_rate)
            raise ParameterError(
                f"arrays.{name}: at ping_rate {self.ping_rate:g} Hz sound comes back from {reach:.1f} m at most, "
                f"range_max is {array.range_max:g} m; lower one of them"
            )

    @property
    def wavelength(self) -> float:
        """Of the sound in water [m]."""
        return SOUND_SPEED / self.frequency


def sonar_names() -> tuple[str, ...]:
    """The sonars that come along."""
    return file_names(_library())


def load_sonar(name_or_path: str | Path) -> SonarModel:
    """The sonar of this name or in this file, arrays relative to its head.

    Raises ParameterError, with file and remedy, for an unknown sonar, an unreadable file, what is missing or wrong.
    """
    text = read_named(name_or_path, _library(), "sonar")
    try:
        document = yaml.safe_load(text)
    except yaml.YAMLError as error:
        raise ParameterError(f"{name_or_path}: not readable as YAML: {error}") from error
    if not isinstance(document, Mapping):
        raise ParameterError(f"{name_or_path}: a sonar file is a mapping, got {type(document).__name__}")
    try:
        return _model(document)
    except ParameterError as error:
        raise ParameterError(f"{name_or_path}: {error}") from error


def with_sonar_file(values: Mapping[str, Any]) -> Mapping[str, Any]:
    """Dotted parameters in which ``head.sonar`` has become ``arrays.*``; values that were given stay.

    For classes with ``head: SonarHead`` and ``arrays: dict[str, SonarArray]``.
    """
    head = load(SonarHead, {k.removeprefix("head."): v for k, v in values.items() if k.startswith("head.")}, "head.")
    if not head.sonar:
        return values
    arrays = {name: mounted(array, head) for name, array in load_sonar(head.sonar).arrays.items()}
    return {f"arrays.{n}.{k}": v for n, array in arrays.items() for k, v in flatten(array).items()} | dict(values)


def beside(values: Mapping[str, Any], file: Path) -> dict[str, Any]:
    """Dotted parameters of a file, a sonar file that lies beside it named by its whole path."""
    found = dict(values)
    for name, value in values.items():
        if name.split(".")[-2:] == ["head", "sonar"] and value and (file.parent / str(value)).is_file():
            found[name] = str((file.parent / str(value)).resolve())
    return found


def mounted(array: SonarArray, head: SonarHead) -> SonarArray:
    """An array whose mount is told relative to the head, relative to base_link."""
    R = matrix_from_rpy(np.array(head.mount_rpy))
    x, y, z = (np.array(head.mount_xyz) + R @ np.array(array.mount_xyz)).tolist()
    roll, pitch, yaw = array.mount_rpy
    if any(head.mount_rpy):
        turned = np.ascontiguousarray(R @ matrix_from_rpy(np.array(array.mount_rpy)))
        roll, pitch, yaw = rpy_from_matrix(turned).tolist()
    return dataclasses.replace(array, mount_xyz=(x, y, z), mount_rpy=(roll, pitch, yaw))


def _model(document: Mapping[str, Any]) -> SonarModel:
    rest = {k: v for k, v in document.items() if k not in ("array", "arrays", "simulation")}
    shared, own = (_mapping(document.get(key), key) for key in ("array", "arrays"))
    arrays = {name: shared | _mapping(values, f"arrays.{name}") for name, values in own.items()}
    for name, array in arrays.items():
        _complete(str(name), array)
    model = load(SonarModel, dotted(rest | {"arrays": {str(k): v for k, v in arrays.items()}}))
    return dataclasses.replace(model, simulation=dotted(_mapping(document.get("simulation"), "simulation")))


def _complete(name: str, array: dict[str, Any]) -> None:
    """Fill in the mount; all else must be stated: another sonar's number would be a guess."""
    for f in dataclasses.fields(SonarArray):
        if f.name in _MOUNT:
            array.setdefault(f.name, [0.0, 0.0, 0.0])
        elif f.name not in array:
            what = f"{f.name} [{f.metadata['unit']}] is missing ({f.metadata['about']})"
            raise ParameterError(f"arrays.{name}: {what}; state it there, or under 'array:' for all")


def _mapping(value: Any, name: str) -> dict[str, Any]:
    if value is None:
        return {}
    if not isinstance(value, Mapping):
        raise ParameterError(f"{name}: is a group of parameters, got the value {value!r}")
    return dict(value)


def _library() -> Traversable:
    return resources.files("fbn_common").joinpath("data", "sonars")
