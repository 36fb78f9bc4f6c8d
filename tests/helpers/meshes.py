"""Closed meshes of triangles, and the files that hold them."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np


def box_mesh(lower, upper) -> tuple[np.ndarray, np.ndarray]:
    """(vertices [8, 3], triangles [12, 3]) of a box."""
    vertices = np.array(list(itertools.product(*zip(lower, upper))), float)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return vertices, np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))])


def star_mesh(centre, radius, arms=0.4, rows=16) -> tuple[np.ndarray, np.ndarray]:
    """A sphere with bumps and hollows: rays meet it many times."""
    columns = 2 * rows
    polar = np.pi * np.arange(1, rows) / rows
    around = 2 * np.pi * np.arange(columns) / columns
    p, a = np.meshgrid(polar, around, indexing="ij")
    r = radius * (1 + arms * np.sin(5 * a) * np.sin(4 * p))
    ring = np.stack([r * np.sin(p) * np.cos(a), r * np.sin(p) * np.sin(a), r * np.cos(p)], axis=-1).reshape(-1, 3)
    vertices = np.concatenate([ring, [[0, 0, radius], [0, 0, -radius]]]) + centre
    top, bottom = len(ring), len(ring) + 1
    triangles = []
    for k in range(columns):
        n = (k + 1) % columns
        triangles += [(top, k, n), (bottom, (rows - 2) * columns + n, (rows - 2) * columns + k)]
        for row in range(rows - 2):
            i, j = row * columns, (row + 1) * columns
            triangles += [(i + k, j + k, j + n), (i + k, j + n, i + n)]
    return vertices, np.array(triangles)


def write_obj(path: Path, vertices, triangles) -> str:
    lines = ["v " + " ".join(repr(float(x)) for x in v) for v in vertices]
    lines += ["f " + " ".join(str(k + 1) for k in t) for t in triangles]
    path.write_text("\n".join(lines) + "\n")
    return str(path)


def write_stl(path: Path, vertices, triangles) -> str:
    """Binary: every triangle with vertices of its own, in single precision."""
    record = np.zeros(len(triangles), [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("more", "<u2")])
    record["corners"] = np.asarray(vertices)[np.asarray(triangles)]
    path.write_bytes(bytes(80) + np.uint32(len(triangles)).tobytes() + record.tobytes())
    return str(path)


def write_ply(path: Path, vertices, triangles) -> str:
    head = ["ply", "format ascii 1.0", f"element vertex {len(vertices)}", *(f"property double {x}" for x in "xyz"),
            f"element face {len(triangles)}", "property list uchar int vertex_indices", "end_header"]  # fmt: skip
    rows = [" ".join(repr(float(x)) for x in v) for v in vertices]
    rows += ["3 " + " ".join(map(str, t)) for t in triangles]
    path.write_text("\n".join([*head, *rows]) + "\n")
    return str(path)
