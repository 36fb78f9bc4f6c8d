"""[environment]: light from all around, given by a picture."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated, Literal

from pydantic import AfterValidator, BeforeValidator, Field

from clvol.errors import SceneError, UsageError
from clvol.image.exr import check_size
from clvol.scene.table import Number, Table
from clvol.scene.volume import is_path, path_text

_FILE = "the name of an EXR file, in quotes"


class Environment(Table):
    """A picture of the surroundings that lights the volume: ``file`` (.exr, linear light), relative to the scene file.

    ``layout``: "latlong" has up (+y) in the first row and -z in the middle; "cube" is a vertical
    strip of the square faces +x, -x, +y, -y, +z, -z; "sphere" is a mirror ball as seen from afar along -z, with +y up:
    its middle mirrors +z, its rim -z, and what is around the disc is not read. ``rotation_degrees`` rotates the map
    about the world's y axis. ``visible``: rays that leave the volume show the map instead of the background.
    """

    file: Annotated[str, BeforeValidator(path_text), AfterValidator(is_path)] = Field(
        min_length=1,
        title="EXR picture of the surroundings, in linear light; relative to the scene file.",
        description=_FILE,
        examples=["studio.exr"],
    )
    layout: Literal["latlong", "cube", "sphere"] = Field(
        "latlong",
        title="Latitude-longitude map, a vertical strip of cube faces +x, -x, +y, -y, +z, -z, or a mirror ball.",
        description="'latlong', 'cube' or 'sphere'",
    )
    intensity: Number = Field(
        1.0, ge=0, le=1e6,
        title="Factor on the radiance of the map.",
        description="a number from 0 to 1e6",
    )
    rotation_degrees: Number = Field(
        0.0, ge=-36000, le=36000,
        title="Rotation of the map about the world's y axis, in degrees.",
        description="an angle from -36000 to 36000 degrees",
    )
    visible: bool = Field(
        False,
        title="Whether the map is shown behind the volume instead of the background.",
        description="true or false",
    )

    @classmethod
    def table_name(cls) -> str:
        return "environment"

    @property
    def path(self) -> Path:
        """The path of the file. In a resolved scene it includes the scene's folder."""
        return Path(self.file)

    def found_in(self, folder: Path, origin: str, memory_cap: int | None = None) -> Environment:
        """A copy whose file is a path that includes ``folder``.

        Raises SceneError if the file does not exist, is not an EXR file, or takes more than ``memory_cap`` bytes
        (default: 1 GiB).
        """
        path, where = folder / self.file, f"{origin}: environment.file"
        if path.suffix.lower() != ".exr":
            raise SceneError(where, f"got {self.file!r}", "a picture in EXR (.exr)")
        if not os.path.isfile(path):
            raise SceneError(where, f"got {self.file!r}, no such file", "a picture in EXR (.exr)")
        _check_size(str(path), memory_cap)
        return self.model_copy(update={"file": str(path)})


def _check_size(path: str, memory_cap: int | None) -> None:
    """SceneError if the picture is too large. A damaged file is reported when it is read."""
    try:
        check_size(path, memory_cap)
    except UsageError as error:
        raise SceneError(error.where, error.what, error.expected) from None
    except (OSError, RuntimeError, ValueError):
        pass
