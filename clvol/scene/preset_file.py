"""Presets with a technique: TOML files with control points, filter and material, for data of one kind."""

from __future__ import annotations

import os
import sys
from difflib import get_close_matches
from functools import cache
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, ValidationError, model_validator

from clvol.errors import SceneError
from clvol.scene.integration import Integration
from clvol.scene.material import Material
from clvol.scene.table import COLOR, AsTuple, Color, Fraction, Number, Positive, Table, scene_error, wrong
from clvol.transfer import PRESETS

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ENDING = ".toml"


class PresetPoint(Table):
    """Opacity and colour at one place of the preset's scale."""

    at: Number = Field(title="Place on the preset's scale.", description="a finite number", examples=[0.5])
    opacity: Fraction = Field(
        title="Opacity over one opacity unit.", description="a number from 0 to 1", examples=[0.5]
    )
    color: Color = Field(
        title="Colour, sRGB-encoded.", description=COLOR, examples=[[0.9, 0.8, 0.7]]
    )


class PresetFile(Table):
    """A preset: ``points`` on a ``scale``, and the technique that shows them.

    ``scale``: "hounsfield" places points in Hounsfield units (an offset in the data is found and added); "relative" as
    fractions of the volume's range; "object" between the background (0), the boundary of the object (0.5) and what is
    bright in it (1), as found in the voxels. Opacities refer to ``unit_voxels`` mean edges of a voxel, or to the length
    with which rays through the object have a mean opacity of ``mean_opacity``, or else to a 32nd of the volume's
    shortest edge. ``kinds``: the kinds of data, as they are recognised, for which no warning is given.
    """

    summary: str = Field(min_length=1, title="What is shown.", description="one line")
    expects: str = Field(min_length=1, title="The data that the preset is for.", description="one line")
    scale: Literal["hounsfield", "relative", "object"] = Field(
        title="Scale of the points.", description="'hounsfield', 'relative' or 'object'"
    )
    kinds: Annotated[tuple[str, ...], AsTuple] = Field(
        (), title="Kinds of data for which no warning is given.", description="a list of texts"
    )
    unit_voxels: Positive | None = Field(
        None, title="Opacity unit in mean edges of a voxel.", description="a number greater than 0"
    )
    mean_opacity: Fraction | None = Field(
        None, title="Mean opacity of rays through the object.", description="a number from 0 to 1"
    )
    points: Annotated[tuple[PresetPoint, ...], AsTuple] = Field(
        title="Control points, ascending.", description="a list of points { at = …, opacity = …, color = [r, g, b] }"
    )
    integration: Integration = Field(Integration(), title="Filter, step and compositing.", description="a table")
    material: Material = Field(Material(), title="How lit samples reflect.", description="a table")
    lit: bool = Field(True, title="Whether lights are chosen.", description="true or false")

    @model_validator(mode="after")
    def _ascending(self) -> PresetFile:
        if not self.points:
            raise wrong("points", [], "at least one point")
        for i in range(1, len(self.points)):
            at, before = self.points[i].at, self.points[i - 1].at
            if at < before:
                raise wrong(f"points.{i}.at", at, f"ascending places, here {before} or more")
        if self.unit_voxels is not None and self.mean_opacity is not None:
            raise wrong("mean_opacity", self.mean_opacity, "either unit_voxels or mean_opacity, not both")
        if self.mean_opacity is not None and not 0 < self.mean_opacity < 1:
            raise wrong("mean_opacity", self.mean_opacity, "a number between 0 and 1")
        return self


@cache
def preset_folder() -> Path | None:
    """The folder of the presets that come with clvol: clvol/presets in a wheel, data/presets in a checkout."""
    package = Path(__file__).resolve().parent.parent
    for folder in (package / "presets", package.parent / "data" / "presets"):
        if folder.is_dir():
            return folder
    return None


@cache
def preset_names() -> tuple[str, ...]:
    """The names of the presets with a technique that come with clvol, sorted."""
    folder = preset_folder()
    return () if folder is None else tuple(sorted(path.stem for path in folder.glob(f"*{ENDING}")))


def is_known(name: str) -> bool:
    """Whether ``name`` is a preset that comes with clvol, or the name of a file."""
    return name in PRESETS or name in preset_names() or name.endswith(ENDING)


def has_technique(name: str | None) -> bool:
    """Whether the preset called ``name`` is a file: one that says more than a transfer function."""
    return name is not None and (name in preset_names() or name.endswith(ENDING))


def expected_preset(name: str) -> str:
    """What to say was expected in place of the unknown preset ``name``."""
    known = [*PRESETS, *(name for name in preset_names() if name not in PRESETS)]
    near = get_close_matches(name, known, n=1)
    hint = f" (did you mean {near[0]!r}?)" if near else ""
    return "one of " + ", ".join(map(repr, known)) + f", or a file (*{ENDING})" + hint


def load_preset(name: str, folder: Path, origin: str) -> PresetFile:
    """The preset called ``name``, or in the file of that name, relative to ``folder``.

    SceneError, whose ``where`` begins with ``origin``, for a file that does not exist or is none.
    """
    where = f"{origin}: transfer_function.preset"
    inside = preset_folder()
    if name in preset_names() and inside is not None:
        path = inside / f"{name}{ENDING}"
    else:
        path = folder / name
        if not os.path.isfile(path):
            raise SceneError(where, f"got {name!r}, no such file", expected_preset(name))
    try:
        data = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        what = f"cannot be read ({' '.join(str(error).split())})"
        raise SceneError(str(path), what, "a preset in TOML, text in UTF-8") from None
    try:
        return PresetFile.model_validate(data)
    except ValidationError as error:
        raise scene_error(error, PresetFile, str(path)) from None
