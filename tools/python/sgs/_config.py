"""Settings of a training."""

from __future__ import annotations

import json
import numbers
from typing import Any, Mapping, Optional

from . import _sgs
from ._errors import usage


class Config:
    """Settings that differ from the defaults (docs/reference/settings.md).

        Config(preset="draft", geometry={"steps": 300})
        Config({"geometry.losses.normal": 0.1}, geometry_steps=300)

    Args:
        settings: Settings as nested groups or by dotted names.
        preset: ``draft``, ``fast``, ``default``, ``paper`` or ``parity``.
        accuracy: ``exact``, ``compact``, ``balanced`` or ``fast``.
        keywords: Groups of settings, or settings by their names with underscores for dots.

    Raises:
        sgs.Error: If a name, a setting or a value is wrong.
    """

    def __init__(
        self,
        settings: Optional[Mapping[str, Any]] = None,
        *,
        preset: Optional[str] = None,
        accuracy: Optional[str] = None,
        **keywords: Any,
    ) -> None:
        table: dict[str, Any] = {}
        for name, value in (settings or {}).items():
            _set(table, str(name).split("."), value)
        known = json.loads(_sgs.check_settings((None, None, None))) if keywords else {}
        for name, value in keywords.items():
            _set(table, _path(known, name) or [name], value)
        self.preset = preset
        self.accuracy = accuracy
        self.overrides = table
        self._values: dict[str, Any] = json.loads(_sgs.check_settings(self._native()))

    @property
    def values(self) -> dict[str, Any]:
        """All settings, as nested groups."""
        return json.loads(json.dumps(self._values))

    def __getitem__(self, name: str) -> Any:
        """Returns a setting or a group by its dotted name."""
        value: Any = self._values
        for part in name.split("."):
            if not isinstance(value, dict) or part not in value:
                raise KeyError(name)
            value = value[part]
        return value

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Config) and self._values == other._values

    def __repr__(self) -> str:
        return f"Config({self.overrides!r}, preset={self.preset!r}, accuracy={self.accuracy!r})"

    def _native(self) -> _sgs.ConfigTuple:
        text = json.dumps(self.overrides, default=_plain, allow_nan=True) if self.overrides else None
        return (self.preset, self.accuracy, text)


def _native(config: Optional[Config]) -> _sgs.ConfigTuple:
    return (None, None, None) if config is None else config._native()


def _set(table: dict[str, Any], path: list[str], value: Any) -> None:
    for part in path[:-1]:
        table = table.setdefault(part, {})
        if not isinstance(table, dict):
            raise usage(f'"{".".join(path)}" is not a setting: "{part}" is a value.')
    last = path[-1]
    if isinstance(value, Mapping):
        for name, inner in value.items():
            _set(table, [last, *str(name).split(".")], inner)
    else:
        table[last] = value


def _path(known: Mapping[str, Any], name: str) -> Optional[list[str]]:
    """Returns the path of a name that has underscores for dots."""
    for key, inner in known.items():
        if name == key:
            return [key]
        if isinstance(inner, dict) and name.startswith(f"{key}_"):
            rest = _path(inner, name[len(key) + 1 :])
            if rest:
                return [key, *rest]
    return None


def _plain(value: Any) -> Any:
    if hasattr(value, "tolist"):
        return value.tolist()
    if isinstance(value, numbers.Real):
        return float(value)
    return str(value)
