"""Settings: values for a scene's tunables (clvol/accuracy/tunables.py).

Settings are mappings from key ("integration.step") to value. No function changes the settings that it is given.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

from clvol.accuracy.tunables import TABLES, TUNABLES, Tunable
from clvol.errors import ClvolError
from clvol.integrators.registry import check_scene
from clvol.render.renderer import check_memory
from clvol.scene.classification import with_classification
from clvol.scene.resolve import ResolvedScene
from clvol.scene.table import Table

Settings = Mapping[str, Any]


@dataclass(frozen=True, eq=False)
class SceneTunable:
    """A tunable of one scene. ``key``: "TABLE.KEY"; ``values``: in the tunable's order, including the scene's own
    value, ``scene_value``; ``about``: the description of the key."""

    key: str
    tunable: Tunable
    values: tuple
    scene_value: Any
    about: str

    def next_to(self, value: Any, notches: int) -> Any | None:
        """The value ``notches`` steps more accurate (cheaper if negative); None beyond the ends."""
        at, between = self._position(value)
        at += notches + (between and notches < 0)
        return self.values[at] if 0 <= at < len(self.values) else None

    def more(self, value: Any, notches: int) -> Any:
        """The value ``notches`` steps more accurate, at most the last one."""
        return self.values[min(self._position(value)[0] + notches, len(self.values) - 1)]

    def near(self, value: Any) -> int:
        """The index of ``value``, or of the next cheaper value of the ladder."""
        return max(self._position(value)[0], 0)

    def _position(self, value: Any) -> tuple[int, bool]:
        """The index of ``value`` and False, or that of the next cheaper value and True."""
        if value in self.values:
            return self.values.index(value), False
        order = self.tunable.order
        rising = order(self.values[0]) < order(self.values[-1])
        cheaper = sum((order(other) < order(value)) == rising for other in self.values)
        return cheaper - 1, True


def scene_tunables(resolved: ResolvedScene, area: bool = False) -> dict[str, SceneTunable]:
    """The tunables that leave a choice for this scene, by key. ``area``: of pictures whose truth is the integral over
    each pixel."""
    found = {}
    for key, tunable in TUNABLES.items():
        if tunable.of_area and not area:
            continue
        table, name = key.split(".")
        own = value_of(resolved, key)
        values = _with(own, tunable.values_for(resolved), tunable)
        if len(values) > 1:
            about = TABLES[table].model_fields[name].description or ""
            found[key] = SceneTunable(key, tunable, values, own, about)
    return found


def scene_settings(resolved: ResolvedScene, tunables: Mapping[str, SceneTunable]) -> dict[str, Any]:
    """The values of all ``tunables`` in ``resolved``."""
    return {key: value_of(resolved, key) for key in tunables}


def apply(resolved: ResolvedScene, settings: Settings) -> ResolvedScene:
    """``resolved`` with ``settings``. Raises SceneError for an impossible value."""
    differing = {key: value for key, value in settings.items() if value_of(resolved, key) != value}
    tables: dict[str, Any] = tables_with(resolved, differing)  # each name has a table of its own type
    found = replace(resolved, **tables)
    # "auto" may stand for another classification of another method.
    return found if "integration.classification" in settings or not tables else with_classification(found)


def tables_with(scene: Any, settings: Settings) -> dict[str, Table]:
    """The tables of ``scene`` (resolved or not) that ``settings`` belong to, with their values replaced."""
    updates: dict[str, dict[str, Any]] = {}
    for key, value in settings.items():
        table, name = key.split(".")
        updates.setdefault(table, {})[name] = value
    return {
        table: getattr(scene, table).model_copy(update=update) for table, update in updates.items()
    }


def value_of(scene: Any, key: str) -> Any:
    """The value of "TABLE.KEY" in a scene (resolved or not)."""
    table, name = key.split(".")
    return getattr(getattr(scene, table), name)


def is_possible(
    resolved: ResolvedScene, settings: Settings, memory_cap: int | None = None
) -> bool:
    """Whether the scene can be rendered with these settings, within ``memory_cap`` bytes on the device if given."""
    try:
        scene = apply(resolved, settings)
        check_scene(scene)
        check_memory(scene, memory_cap)
    except ClvolError:
        return False
    return True


def canonical(
    resolved: ResolvedScene, tunables: Mapping[str, SceneTunable], settings: Settings
) -> dict[str, Any]:
    """``settings`` with the scene's own value for every tunable that has no effect in combination with the others.

    Settings that produce the same picture in the same way are therefore equal.
    """
    scene = apply(resolved, settings)
    return {
        key: value if tunables[key].tunable.counts(scene) else tunables[key].scene_value
        for key, value in settings.items()
    }


def key_of(settings: Settings) -> tuple:
    """A hashable key that is equal for equal settings."""
    return tuple(sorted(settings.items(), key=lambda item: item[0]))


def changed(settings: Settings, base: Settings) -> list[str]:
    """The keys in which ``settings`` differ from ``base``."""
    return [key for key in settings if settings[key] != base[key]]


def neighbours(tunables: Mapping[str, SceneTunable], settings: Settings) -> Iterator[dict[str, Any]]:
    """Settings that differ by one notch of a ladder, or by another alternative, in one tunable."""
    for key, tunable in tunables.items():
        own = settings[key]
        if tunable.tunable.is_ladder:
            others = [tunable.next_to(own, -1), tunable.next_to(own, 1)]
        else:
            others = [value for value in tunable.values if value != own]
        for value in others:
            if value is not None:
                yield {**settings, key: value}


def label(tunables: Mapping[str, SceneTunable], settings: Settings, resolved: ResolvedScene) -> str:
    """A short description: the alternatives, the main ladders, and every other value that differs from the scene."""
    parts, scene = [], apply(resolved, settings)
    for key, tunable in tunables.items():
        value = settings[key]
        if not tunable.tunable.counts(scene):
            continue
        if tunable.tunable.is_main or value != tunable.scene_value or key.endswith(".classification"):
            about = tunable.tunable
            named = about.is_ladder or value == "none"  # which says nothing by itself
            parts.append((about.is_ladder, format_setting(about.title, value, named)))
    parts.sort(key=lambda part: part[0])  # alternatives first
    return ", ".join(text for _, text in parts)


def format_setting(title: str, value: Any, is_ladder: bool = True) -> str:
    """A tunable's value in words: "post", "step 0.5", "no interblock"."""
    if isinstance(value, bool):
        return title if value else f"no {title}"
    text = value if isinstance(value, str) else f"{value:.4g}"
    return f"{title} {text}" if is_ladder else text


def _with(own: Any, values: tuple, tunable: Tunable) -> tuple:
    """``values`` with the scene's own value inserted in order."""
    if own in values:
        return values
    if not tunable.is_ladder:
        return (*values, own)
    rising = len(values) < 2 or tunable.order(values[0]) < tunable.order(values[-1])
    return tuple(sorted((*values, own), key=tunable.order, reverse=not rising))
