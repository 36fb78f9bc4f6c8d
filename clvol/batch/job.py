"""Jobs: scenes times volumes times the values of keys that vary, and the pictures that they make."""

from __future__ import annotations

import glob
import itertools
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import Field, model_validator

from clvol.batch.names import check_pattern, filled, stem_of
from clvol.errors import SceneError
from clvol.scene.load import parsed_file
from clvol.scene.table import Table, scene_error, wrong

MOST_PICTURES = 1_000_000


class Vary(Table):
    """A key of scenes and the values that it takes."""

    key: str = Field(
        title="Key of the scenes that varies, such as camera.view or integration.step.",
        description="the name of a key of scenes, such as 'camera.view'",
        min_length=1,
        examples=["camera.view"],
    )
    values: list[Any] = Field(
        title="Its values, in the order of the pictures.",
        description="a list of values that the key may take",
        min_length=1,
        examples=[["front", "left"]],
    )
    name: str | None = Field(
        None,
        title="Name of the key in patterns of file names; by default the key itself.",
        description="a name of letters, digits, dots and underscores",
        pattern=r"^[A-Za-z0-9_.]+$",
    )

    @property
    def label(self) -> str:
        return self.name or self.key


class Job(Table):
    """A job as its file says it. Files are relative to the folder of the job."""

    version: int = Field(1, title="Version of the format of jobs.", description="1", ge=1, le=1)
    scenes: list[str] = Field(
        [],
        title="Scene files. Without any, each volume is rendered as 'clvol render VOLUME' renders it.",
        description="a list of scene files (.toml); patterns such as 'scenes/*.toml' name several",
    )
    volumes: list[str] = Field(
        [],
        title="Volumes that take the place of the scenes' own.",
        description="a list of volume files; patterns such as 'data/*.nrrd' name several",
    )
    output: str | list[str] = Field(
        title="Pattern of the names of the pictures, with {scene}, {volume}, {number} and what varies.",
        description="a name such as 'out/{volume}_{camera.view}.png', or a list of them",
        examples=["out/{scene}_{number:04d}.png"],
    )
    set: dict[str, Any] = Field(
        {},
        title="Keys of all scenes, with their values.",
        description="a table of keys and values, such as {\"image.width\" = 512}",
    )
    vary: list[Vary] = Field(
        [], title="Keys that vary: every combination is a picture.", description="tables with 'key' and 'values'"
    )
    max_error: float | None = Field(
        None,
        title="Largest error of each picture: settings are chosen for it, and the error is measured.",
        description="a number above 0",
        gt=0,
    )

    @model_validator(mode="after")
    def _not_contradictory(self) -> Job:
        if not self.scenes and not self.volumes:
            raise wrong("scenes", self.scenes, "scenes, or volumes, or both")
        labels = [vary.label for vary in self.vary]
        for i, label in enumerate(labels):
            if label in labels[:i] or label in ("scene", "volume", "number"):
                raise wrong(f"vary.{i}", label, "another key or name for each table, other than scene, volume, number")
        return self

    @property
    def outputs(self) -> list[str]:
        return [self.output] if isinstance(self.output, str) else self.output


@dataclass(frozen=True)
class Picture:
    """One picture of a job. ``source``: the scene file, or the volume where there is none. ``settings``: keys with
    values that differ from the scene's. ``varied``: those that vary, by label. ``files``: to be written."""

    number: int
    source: str
    volume: str | None
    settings: tuple[tuple[str, Any], ...]
    varied: dict[str, Any]
    files: tuple[str, ...]

    def as_result(self) -> dict[str, Any]:
        """What the lines of results say of it."""
        return {
            "picture": self.number, "files": list(self.files), "source": self.source, "volume": self.volume,
            "set": dict(self.settings),
        }  # fmt: skip


def load_job(path: str | os.PathLike[str]) -> Job:
    """Reads a job file (.toml). SceneError whose ``where`` is "FILE: KEY"."""
    from pydantic import ValidationError

    try:
        data = parsed_file(Path(path))
    except SceneError as error:
        raise SceneError(error.where, error.what, "a job file (.toml)") from None
    try:
        return Job.model_validate(data)
    except ValidationError as error:
        raise scene_error(error, Job, str(path)) from None


def pictures_of(job: Job, path: str | os.PathLike[str]) -> list[Picture]:
    """All pictures of the job in the file ``path``, those of one scene and volume one after the other. SceneError for
    patterns that name no file, and for names that two pictures would have."""
    origin, folder = str(path), Path(path).parent
    scenes = _files(job.scenes, folder, f"{origin}: scenes")
    volumes = _files(job.volumes, folder, f"{origin}: volumes")
    labels = [vary.label for vary in job.vary]
    known = [*(["scene"] if scenes else []), *(["volume"] if volumes else []), "number", *labels]
    for pattern in job.outputs:
        check_pattern(pattern, known, f"{origin}: output")
    count = max(len(scenes), 1) * max(len(volumes), 1)
    for vary in job.vary:
        count *= len(vary.values)
    if count > MOST_PICTURES:
        raise SceneError(origin, f"{count} pictures", f"at most {MOST_PICTURES}: fewer values, or several jobs")
    found = list(_combined(job, folder, scenes, volumes))
    _check_apart(found, job, known, f"{origin}: output")
    return found


def _combined(job: Job, folder: Path, scenes: Sequence[str], volumes: Sequence[str]) -> Iterator[Picture]:
    everywhere = tuple(job.set.items())
    nothing: list[str | None] = [None]
    sources = itertools.product(list(scenes) or nothing, list(volumes) or nothing)
    values = [vary.values for vary in job.vary]
    number = 0
    for scene, volume in sources:
        for chosen in itertools.product(*values):
            settings = [*everywhere, *zip((vary.key for vary in job.vary), chosen)]
            if scene is not None and volume is not None:
                settings.insert(0, ("volume.file", os.path.abspath(volume)))
            varied = dict(zip((vary.label for vary in job.vary), chosen))
            names: dict[str, Any] = {"number": number, **varied}
            if scene is not None:
                names["scene"] = stem_of(scene)
            if volume is not None:
                names["volume"] = stem_of(volume)
            source = scene if scene is not None else volume
            assert source is not None
            files = tuple(str(folder / filled(pattern, names)) for pattern in job.outputs)
            yield Picture(number, source, volume, tuple(settings), varied, files)
            number += 1


def _files(patterns: Sequence[str], folder: Path, where: str) -> list[str]:
    """The files that ``patterns`` name, in order; those of one pattern sorted by name."""
    found: list[str] = []
    for i, pattern in enumerate(patterns):
        path = str(folder / pattern)
        if os.path.lexists(path) or not glob.has_magic(pattern):
            found.append(path)
            continue
        matches = sorted(glob.glob(path, recursive=True))
        if not matches:
            raise SceneError(f"{where}.{i}", f"no file is named like {pattern!r}", "a file, or a pattern of some")
        found += matches
    return list(dict.fromkeys(found))


def _check_apart(pictures: Sequence[Picture], job: Job, known: Sequence[str], where: str) -> None:
    """SceneError if two pictures would be one file."""
    taken: dict[str, Picture] = {}
    for picture in pictures:
        for file in picture.files:
            place = os.path.realpath(file)
            if place in taken:
                other = taken[place]
                what = f"{_described(other)} and {_described(picture)} would both be {file!r}"
                fields = ", ".join("{" + each + "}" for each in known)
                raise SceneError(where, what, f"a pattern that tells them apart, with some of {fields}")
            taken[place] = picture


def _described(picture: Picture) -> str:
    parts = [picture.source, *([picture.volume] if picture.volume not in (None, picture.source) else [])]
    parts += [f"{label} = {value!r}" for label, value in picture.varied.items()]
    return f"picture {picture.number} ({', '.join(map(str, parts))})"
