"""Parameters: a frozen dataclass per estimator is the only home of its defaults, units and their origin.

ROS parameters, the YAML files, ``fbn params`` and the docs' table derive from it.  A nested dataclass gives
dotted names (``gate.compass``); a ``dict`` of dataclasses gives one group of names per key
(``arrays.left.fov``).
"""

from __future__ import annotations

import dataclasses
import difflib
import types
import typing
from collections.abc import Iterator, Mapping
from dataclasses import MISSING, dataclass
from pathlib import Path
from typing import Any, TypeVar

import yaml

T = TypeVar("T")
Value = bool | int | float | str | list[bool] | list[int] | list[float] | list[str]


class ParameterError(ValueError):
    """A parameter's name, type or value is wrong; the text says which and what to do."""


def param(default: Any, unit: str, about: str, origin: str) -> Any:
    """A parameter's field: default, unit (``-`` for none), what it is, and where the number comes from.

    A list or a dict as default is copied for each instance.
    """
    metadata = {"unit": unit, "about": about, "origin": origin}
    if isinstance(default, list | dict):
        return dataclasses.field(default_factory=lambda: type(default)(default), metadata=metadata)
    if default is MISSING:
        return dataclasses.field(metadata=metadata)
    return dataclasses.field(default=default, metadata=metadata)


def group(default: Any) -> Any:
    """A nested group of parameters: a dataclass, or a dict of them, given as a factory."""
    return dataclasses.field(default_factory=default)


@dataclass(frozen=True, slots=True)
class Description:
    """One parameter as the tables show it."""

    name: str
    default: Any
    unit: str
    about: str
    origin: str


def load(cls: type[T], values: Mapping[str, Any], prefix: str = "") -> T:
    """An instance of ``cls`` from dotted names; unknown names, wrong types and failed checks raise ParameterError.

    A class whose values come from elsewhere too (a file it names) has a static ``prepared`` that gives all of them.
    """
    values = getattr(cls, "prepared", dict)(values)
    hints = typing.get_type_hints(cls)
    fields = {f.name: f for f in dataclasses.fields(cls)}  # type: ignore[arg-type]
    arguments: dict[str, Any] = {}
    for name, sub in _split(values).items():
        if name not in fields:
            raise ParameterError(_unknown(prefix + name, [prefix + f for f in fields]))
        arguments[name] = _convert(hints[name], sub, f"{prefix}{name}", fields[name])
    try:
        return cls(**arguments)
    except ParameterError:
        raise
    except (TypeError, ValueError) as error:
        raise ParameterError(f"{prefix or cls.__name__}: {error}") from error


def flatten(parameters: Any, prefix: str = "") -> dict[str, Value]:
    """Dotted names and plain values of an instance: the effective configuration."""
    flat: dict[str, Value] = {}
    for f in dataclasses.fields(parameters):
        value, name = getattr(parameters, f.name), prefix + f.name
        if dataclasses.is_dataclass(value):
            flat |= flatten(value, name + ".")
        elif isinstance(value, dict):
            for key, item in value.items():
                flat |= flatten(item, f"{name}.{key}.")
        else:
            flat[name] = list(value) if isinstance(value, tuple) else value
    return flat


def describe(cls: type[Any], prefix: str = "") -> Iterator[Description]:
    """Every parameter of a class, groups unfolded; a dict of groups shows as ``<name>``."""
    hints = typing.get_type_hints(cls)
    for f in dataclasses.fields(cls):
        name, hint = prefix + f.name, hints[f.name]
        if dataclasses.is_dataclass(hint):
            yield from describe(typing.cast(type[Any], hint), name + ".")
        elif typing.get_origin(hint) is dict:
            yield from describe(typing.get_args(hint)[1], f"{name}.<name>.")
        else:
            default = f.default if f.default_factory is MISSING else f.default_factory()
            meta = f.metadata
            shown = "required" if default is MISSING else default
            yield Description(name, shown, meta["unit"], meta["about"], meta["origin"])


def read_yaml(path: Path, node: str) -> dict[str, Any]:
    """The parameters of one node in a ROS parameter file (``/**`` first, then the node's own), as dotted names.

    Raises ParameterError for a file that cannot be read or is not of that form.
    """
    try:
        document = yaml.safe_load(path.read_text()) or {}
    except (OSError, yaml.YAMLError) as error:
        raise ParameterError(f"{path}: not a readable parameter file: {error}") from error
    flat: dict[str, Any] = {}
    for section in ("/**", node):
        body = document.get(section, {}) if isinstance(document, dict) else None
        if not isinstance(body, dict) or (body and set(body) != {"ros__parameters"}):
            raise ParameterError(f"{path}: section {section!r} must hold 'ros__parameters:' and nothing else")
        flat |= dotted(body.get("ros__parameters") or {})
    return flat


def dotted(tree: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """A tree of mappings as one mapping of dotted names."""
    flat: dict[str, Any] = {}
    for key, value in tree.items():
        if isinstance(value, dict):
            flat |= dotted(value, f"{prefix}{key}.")
        else:
            flat[f"{prefix}{key}"] = value
    return flat


def _split(values: Mapping[str, Any]) -> dict[str, Any]:
    """First part of the dotted names -> value, or the mapping of the rest."""
    tree: dict[str, Any] = {}
    for name, value in values.items():
        head, dot, rest = name.partition(".")
        if dot:
            tree.setdefault(head, {})[rest] = value
        else:
            tree[head] = value
    return tree


def _convert(hint: Any, value: Any, name: str, f: dataclasses.Field[Any]) -> Any:
    if dataclasses.is_dataclass(hint):
        return load(typing.cast(type[Any], hint), _mapping(value, name), name + ".")
    if typing.get_origin(hint) is dict:
        item = typing.get_args(hint)[1]
        return {k: load(item, _mapping(v, name), f"{name}.{k}.") for k, v in _split(_mapping(value, name)).items()}
    return _plain(hint, value, name, f)


def _mapping(value: Any, name: str) -> Mapping[str, Any]:
    if not isinstance(value, Mapping):
        raise ParameterError(f"{name}: is a group of parameters, got the value {value!r}")
    return value


def _plain(hint: Any, value: Any, name: str, f: dataclasses.Field[Any]) -> Any:
    unit = f.metadata.get("unit", "-")
    if typing.get_origin(hint) in (typing.Union, types.UnionType):
        hint = next(a for a in typing.get_args(hint) if a is not type(None))
        if value is None or value == "":
            return None
    if typing.get_origin(hint) in (list, tuple):
        item, *others = typing.get_args(hint)
        if isinstance(value, str) or not hasattr(value, "__iter__"):
            raise ParameterError(f"{name} [{unit}]: expected a list of {item.__name__}, got {value!r}")
        items = [_plain(item, v, f"{name}[{i}]", f) for i, v in enumerate(value)]
        if others and others[0] is not Ellipsis and len(items) != 1 + len(others):
            raise ParameterError(f"{name} [{unit}]: expected {1 + len(others)} values, got {len(items)}")
        return typing.get_origin(hint)(items)
    if hint is float and isinstance(value, int) and not isinstance(value, bool):
        value = float(value)
    if not isinstance(value, hint) or (hint is not bool and isinstance(value, bool)):
        raise ParameterError(f"{name} [{unit}]: expected {hint.__name__}, got {value!r}")
    if hint is float and value != value:
        raise ParameterError(f"{name} [{unit}]: is not a number")
    return value


def _unknown(name: str, known: list[str]) -> str:
    near = difflib.get_close_matches(name, known, 1)
    hint = f"did you mean {near[0]!r}?" if near else f"known are: {', '.join(sorted(known))}"
    return f"unknown parameter {name!r}; {hint}  (fbn params lists all)"
