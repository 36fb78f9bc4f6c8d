"""[[clip]]: a plane, a box, a sphere or a closed mesh that keeps one of its sides."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from pydantic import Field, model_validator

from clvol.errors import SceneError, VolumeError
from clvol.readers.meshes import ClosedMesh, read_mesh
from clvol.scene.table import Length, Table, Vector, wrong

_NEEDS = {"plane": ("point", "normal"), "box": ("lower", "upper"), "sphere": ("center", "radius"), "mesh": ("file",)}
_KEYS = ("point", "normal", "lower", "upper", "center", "radius", "file")
_EXPECTED = {"radius": "a world length", "file": "a closed mesh (.stl, .obj, .ply)"}
_POINT = "three finite numbers [x, y, z]"


class Clip(Table):
    """A plane, a box, a sphere or a closed mesh in world coordinates.

    A plane through ``point`` keeps the side that its ``normal`` (of any length but 0) points to. A box, which is
    aligned with the world axes, a sphere, and the closed mesh of a ``file`` keep their inside or their outside.
    """

    type: Literal["plane", "box", "sphere", "mesh"] = Field(
        "plane",
        title="Shape of the clip.",
        description="'plane', 'box', 'sphere' or 'mesh'",
    )
    point: Vector | None = Field(
        None,
        title="World point on the plane.",
        description=_POINT,
        examples=[[63.5, 0.0, 0.0]],
    )
    normal: Vector | None = Field(
        None,
        title="World direction that points to the side of the plane that is kept; its length does not matter.",
        description="three finite numbers [x, y, z], not all 0",
        examples=[[1.0, 0.0, 0.0]],
    )
    lower: Vector | None = Field(
        None,
        title="Lower world corner of the box.",
        description=_POINT,
        examples=[[0.0, 0.0, 0.0]],
    )
    upper: Vector | None = Field(
        None,
        title="Upper world corner of the box.",
        description=_POINT,
        examples=[[64.0, 64.0, 64.0]],
    )
    center: Vector | None = Field(
        None,
        title="World centre of the sphere.",
        description=_POINT,
        examples=[[63.5, 63.5, 63.5]],
    )
    radius: Length | None = Field(
        None,
        title="Radius of the sphere in world units.",
        description="a finite world length greater than 0",
        examples=[40.0],
    )
    file: str | None = Field(
        None,
        title="File of the mesh, relative to the scene: triangles that close (.stl, .obj, .ply; extra 'mesh').",
        description="the path of a closed mesh (.stl, .obj, .ply)",
        examples=["part.stl"],
    )
    keep: Literal["inside", "outside"] = Field(
        "inside",
        title="Which side of a box, sphere or mesh is kept.",
        description="'inside' or 'outside'",
    )

    @classmethod
    def table_name(cls) -> str:
        return "clip"

    @model_validator(mode="after")
    def _has_what_its_type_needs(self) -> Clip:
        needed = _NEEDS[self.type]
        for key in _KEYS:
            value = getattr(self, key)
            if key in needed and value is None:
                expected = _EXPECTED.get(key, "three numbers [x, y, z]")
                raise wrong(key, None, f"{expected} for a {self.type}")
            if key not in needed and value is not None:
                got = value if key in _EXPECTED else list(value)
                raise wrong(key, got, f"no {key} for a clip of type {self.type!r}")
        if self.type == "plane" and "keep" in self.model_fields_set:
            raise wrong("keep", self.keep, "no keep for a plane: it keeps its normal's side")
        if self.type == "plane" and self.normal is not None and not any(self.normal):
            raise wrong("normal", list(self.normal), "a vector that is not 0")
        if self.type == "box" and self.lower is not None and self.upper is not None:
            for axis, (low, high) in enumerate(zip(self.lower, self.upper)):
                if not low < high:
                    raise wrong(f"upper.{axis}", high, f"greater than lower's {low}")
        return self

    def found_in(self, folder: Path, origin: str, number: int) -> Clip:
        """The clip itself, or a ``MeshClip`` with the mesh of its file, relative to ``folder``.

        ``number``: of the clip in its scene. SceneError for a file that holds no closed mesh.
        """
        if self.file is None:
            return self
        path = folder / self.file
        try:
            mesh = read_mesh(path)
        except VolumeError as error:
            where = f"{origin}: clip.{number}.file"
            raise SceneError(where, f"got {self.file!r}: {error.what}", error.expected) from None
        return MeshClip(type=self.type, keep=self.keep, file=str(path), mesh=mesh)


class MeshClip(Clip):
    """A clip of type "mesh" in a resolved scene, with the whole path of its file."""

    mesh: ClosedMesh
