"""What a picture was made from: version, scene, voxels, camera, and frame number. With it a later run can tell
whether it would produce the same picture."""

from __future__ import annotations

import hashlib
import json
from typing import TYPE_CHECKING, Any

import clvol
from clvol.errors import ClvolError
from clvol.features.compression import coded_source
from clvol.integrators.registry import integrator_of
from clvol.json_values import plain
from clvol.scene.compression import NOT_COMPRESSED
from clvol.volume.digest import file_digest, volume_digest
from clvol.volume.series import StepVolume

if TYPE_CHECKING:
    from clvol.scene.camera import Camera
    from clvol.scene.resolve import ResolvedScene
    from clvol.volume.volume import Volume

_LOOK = ("integration", "image", "multiresolution", "pyramid", "slicing")  # tables that measuring errors may change


class MadeFrom:
    """A callable that returns what the picture of ``resolved`` from ``camera`` at its ``animation.time`` is
    made from: a dict of JSON values, the same for the same picture. ``frame`` is its number in an
    animation, or None.

    Nothing is computed before the first call; until then the scene and its volume stay in memory.
    """

    def __init__(
        self, resolved: ResolvedScene, camera: Camera | None = None, frame: int | None = None
    ) -> None:
        self._asked: tuple | None = (resolved, camera or resolved.camera, frame)
        self._told: dict[str, Any] = {}

    @property
    def holds_voxels(self) -> bool:
        """Whether voxels stay in memory for it: those of a step of a series are read again when they are needed."""
        return self._asked is not None and not isinstance(self._asked[0].volume, StepVolume)

    def __call__(self) -> dict[str, Any]:
        asked = self._asked  # which another thread may forget meanwhile
        if asked is not None:
            self._told = _told(*asked)
            self._asked = None
        return self._told


def _told(resolved: ResolvedScene, camera: Camera, frame: int | None) -> dict[str, Any]:
    facts: dict[str, Any] = {
        "clvol": clvol.__version__,
        "scene": _digest(resolved.source or ""),
        "look": _look(resolved),
        "camera": camera.model_dump(mode="json"),
        "time": resolved.animation.time,
        **_sources(resolved),
    }
    if frame is not None:
        facts["frame"] = frame
    if isinstance(resolved.volume, StepVolume):
        facts["step"] = resolved.volume.number
    return json.loads(json.dumps(plain(facts)))


def _sources(resolved: ResolvedScene) -> dict[str, Any]:
    """Digests of "voxels", and, where the scene has them, "fields", "label_tables", "environment", "light_images" and
    "clip_meshes"; None for data that has disappeared meanwhile, or does not fit into memory."""
    by_blocks = integrator_of(resolved).reads_blocks or coded_source(resolved.volume) is not None
    found: dict[str, Any] = {"voxels": None, "fields": None, "environment": None}
    try:
        found["voxels"] = volume_digest(resolved.volume, by_blocks)
        found["fields"] = [volume_digest(volume) for volume in _of_fields(resolved)]
        found["channels"] = [volume_digest(channel.volume, by_blocks) for channel in resolved.channels[1:]]
        if tables := [field.labels_path for field in resolved.fields if field.labels_path is not None]:
            found["label_tables"] = [file_digest(path) for path in tables]
        if resolved.environment is not None:
            found["environment"] = file_digest(resolved.environment.path)
        if images := [light.file for light in resolved.lights if light.file is not None]:
            found["light_images"] = [file_digest(image) for image in images]
        if meshes := [clip.file for clip in resolved.clips if clip.file is not None]:
            found["clip_meshes"] = [file_digest(mesh) for mesh in meshes]
    except (OSError, ClvolError):
        pass
    return {name: value for name, value in found.items() if value or name == "voxels"}


def _of_fields(resolved: ResolvedScene) -> list[Volume]:
    """The volumes of all fields; of one of colours those of its components."""
    named: list[Volume] = []
    for field in resolved.fields:
        named += [field.volume] if field.colors_of_voxels is None else field.colors_of_voxels.channels
    return named


_last_look: tuple[tuple[Any, ...], str] = ((), "")  # what it is of, and its digest


def _look(resolved: ResolvedScene) -> str:
    """A digest of the transfer function and of the tables that measuring errors may change. Scenes of one job or
    animation share it."""
    global _last_look
    of = resolved.transfer_function, resolved.background, resolved.compression, *(getattr(resolved, t) for t in _LOOK)
    before, digest = _last_look
    if len(of) != len(before) or any(a is not b for a, b in zip(of, before)):
        digest = _digest(_look_text(resolved))
        _last_look = of, digest
    return digest


def _look_text(resolved: ResolvedScene) -> str:
    function = resolved.transfer_function
    numbers = [function.values, function.opacities, function.colors, function.opacity_unit]
    tables = {name: getattr(resolved, name).model_dump(mode="json") for name in _LOOK}
    if resolved.compression != NOT_COMPRESSED:  # pictures without compression keep the digest of earlier versions
        tables["compression"] = resolved.compression.model_dump(mode="json")
    return json.dumps(plain([numbers, resolved.background, tables]), sort_keys=True)


def _digest(text: str) -> str:
    return hashlib.blake2b(text.encode("utf-8", "surrogatepass"), digest_size=16).hexdigest()
