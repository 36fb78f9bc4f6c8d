"""Closed meshes of triangles: STL, OBJ and PLY, through trimesh (extra "mesh")."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from clvol.errors import VolumeError
from clvol.readers.extras import library
from clvol.readers.quiet import quiet
from clvol.readers.recognise import first_line

ENDINGS = (".stl", ".obj", ".ply")
EXPECTED = "a closed mesh: .stl, .obj or .ply"
_KEPT = 8  # meshes that are not read again
MOST_TRIANGLES = 2_000_000
_ASCII = bytes(range(128)) + b"?" * 128  # what each byte of text becomes


@dataclass(frozen=True, eq=False)
class ClosedMesh:
    """``vertices`` float64 [n, 3] in world coordinates, ``triangles`` int64 [k, 3].

    Every edge belongs to an even number of triangles, so that a ray crosses them an even number of times. Which way
    they are wound does not matter. It does not change, and equals itself alone.
    """

    vertices: np.ndarray
    triangles: np.ndarray

    @property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """The lowest and the highest corner, float64 [3] each, of the box around it."""
        return self.vertices.min(axis=0), self.vertices.max(axis=0)


def read_mesh(path: Path) -> ClosedMesh:
    """The mesh of a file; the same object for a file that has not changed. VolumeError for what is no closed mesh."""
    try:
        state = path.stat()
    except OSError as error:
        raise VolumeError(str(path), error.strerror or "cannot be read", EXPECTED) from None
    return _read(path, state.st_mtime_ns, state.st_size)


@lru_cache(maxsize=_KEPT)
def _read(path: Path, changed: int, size: int) -> ClosedMesh:
    where, kind = str(path), path.suffix.lower()
    if kind not in ENDINGS:
        raise VolumeError(where, f"a file that ends in {kind!r}", EXPECTED)
    trimesh = library("trimesh", "mesh", path)
    try:
        with quiet():
            loaded = _loaded(trimesh, path)
        vertices, faces = np.asarray(loaded.vertices, np.float64), np.asarray(loaded.faces, np.int64)
    except Exception as error:  # what a library makes of a damaged file can be any exception
        raise VolumeError(where, first_line(error) or "cannot be read", EXPECTED) from error
    return closed_mesh(vertices, faces, where)


def _loaded(trimesh: Any, path: Path) -> Any:
    """The mesh as trimesh has it. Letters beyond ASCII are those of names and comments, in any encoding."""
    data, how = path.read_bytes(), {"process": False, "force": "mesh", "skip_materials": True}
    kind = path.suffix.lower()[1:]
    try:
        return trimesh.load(BytesIO(data), file_type=kind, **how)
    except (ImportError, UnicodeDecodeError):  # other encodings than UTF-8 are guessed by a library beyond the extra
        text, end, binary = data.partition(b"end_header") if kind == "ply" else (data, b"", b"")
        return trimesh.load(BytesIO(text.translate(_ASCII) + end + binary), file_type=kind, **how)


def closed_mesh(vertices: np.ndarray, faces: np.ndarray, where: str) -> ClosedMesh:
    """A mesh of ``vertices`` [n, 3] and ``faces`` [k, 3], whose equal vertices become one. VolumeError, which names
    ``where``, unless it is closed."""
    if vertices.ndim != 2 or faces.ndim != 2 or not len(faces):
        raise VolumeError(where, "no triangles", EXPECTED)
    if not np.isfinite(vertices).all():
        raise VolumeError(where, "a vertex that is not finite", EXPECTED)
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise VolumeError(where, f"a triangle of vertex {faces.max()}, of {len(vertices)}", EXPECTED)
    if len(faces) > MOST_TRIANGLES:
        raise VolumeError(where, f"{len(faces)} triangles", f"at most {MOST_TRIANGLES}")
    unique, number = np.unique(vertices + 0.0, axis=0, return_inverse=True)  # + 0.0: -0 is 0
    triangles = number.reshape(-1)[faces]
    a, b, c = triangles.T
    triangles = triangles[(a != b) & (b != c) & (c != a)]  # others have no area
    edges = np.sort(np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]), axis=1)
    found, counts = np.unique(edges, axis=0, return_counts=True)
    open_ = found[counts % 2 == 1]
    if len(open_):
        one, other = (_point(unique[k]) for k in open_[0])
        noun = "open edge" if len(open_) == 1 else "open edges"
        what = f"{len(open_)} {noun}, the first from {one} to {other}"
        raise VolumeError(where, what, "a closed mesh, each edge of which belongs to two triangles")
    if not len(triangles):
        raise VolumeError(where, "no triangle with an area", EXPECTED)
    unique.setflags(write=False)
    return ClosedMesh(unique, triangles)


def _point(place: np.ndarray) -> str:
    return "[" + ", ".join(f"{x:.6g}" for x in place) + "]"
