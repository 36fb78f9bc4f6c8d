"""clvol store: writes a volume to disk as blocks at several levels of detail."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

import click

from clvol.cli.options import memory_cap_option, overrides_option, volume_argument

if TYPE_CHECKING:
    from clvol.cli.console import ShowProgress
    from clvol.scene import Scene
    from clvol.store.voxel_source import FieldSource, VolumeSource


@click.command("store", short_help="Build the multiresolution store of a volume.")
@volume_argument
@click.option(
    "-o", "--output", required=True, metavar="STORE", help="Folder to write, an OME-Zarr image."
)
@click.option(
    "--codec", metavar="NAME", help="Compression of samples: blosc-lz4 (default), zstd or none."
)
@click.option(
    "--edge", type=int, metavar="N", help="Voxels per axis of a block: 4, 8, 16 (default) or 32."
)
@click.option(
    "--shard",
    type=int,
    metavar="N",
    help="Voxels per axis of a file, a multiple of the edge; default 128, or 256 for volumes longer than 1024.",
)
@click.option(
    "--overwrite", is_flag=True, help="Replace an existing store, once the new one is complete."
)
@click.option(
    "--restart", is_flag=True, help="Discard the work of an interrupted run, and start again."
)
@overrides_option
@memory_cap_option("Largest amount of memory that the volume may take.")
@click.option("--quiet", is_flag=True, help="Show no progress on the terminal.")
def command(
    volume: str,
    output: str,
    codec: str | None,
    edge: int | None,
    shard: int | None,
    overwrite: bool,
    restart: bool,
    overrides: tuple[str, ...],
    memory_cap: int | None,
    quiet: bool,
) -> None:
    """Store VOLUME as blocks at all resolutions, and print the store's path.

    VOLUME is a volume file, a DICOM folder, a Zarr folder or a scene. A .raw file needs
    --set volume.dims=[nx,ny,nz] --set 'volume.dtype="uint8"'.

    The store appears whole or not at all. An interrupted run leaves STORE.partial; the same command resumes it.
    """
    from pathlib import Path

    from clvol.cli.console import say_path, working
    from clvol.cli.outputs import scene_inputs
    from clvol.scene import load_scene
    from clvol.store.build import build_store
    from clvol.store.build_folder import check_place, places_of
    from clvol.store.codecs import DEFAULT
    from clvol.store.geometry import EDGE

    check_place(Path(output), overwrite)
    scene = load_scene(volume, overrides)
    inputs = scene_inputs(volume, scene)
    for place in places_of(Path(output)):
        inputs.check_folder(place)
    source = _source(scene, volume, memory_cap, quiet)
    with _named_as_options(), working(f"storing {volume}", quiet) as bar:
        build_store(
            source, output, edge=EDGE if edge is None else edge, shard=shard,
            codec=DEFAULT if codec is None else codec, overwrite=overwrite, restart=restart,
            progress=None if quiet else _reporting(output, bar),
        )  # fmt: skip
    say_path(output)


def _source(scene: Scene, volume: str, memory_cap: int | None, quiet: bool) -> FieldSource | VolumeSource:
    """The voxels to store: those of a computed field are computed when they are needed, others are loaded."""
    from clvol.cli.console import working
    from clvol.store.voxel_source import FieldSource, VolumeSource
    from clvol.volume.axis import ValueAxis

    settings = scene.volume
    if settings.field is not None and settings.size is not None:
        axis = ValueAxis(settings.slope, settings.offset)
        return FieldSource(settings.field, settings.size, settings.spacing or (1.0, 1.0, 1.0), axis)
    with working(f"loading {volume}", quiet):
        return VolumeSource(scene.load_volume(memory_cap), settings.model_dump(mode="json"))


def _reporting(output: str, bar: ShowProgress | None) -> Callable[[int, int], None]:
    """A progress function that moves the bar, if there is one, and reports once that a store is resumed."""
    from clvol.cli.console import note

    begun = False

    def progress(done: int, total: int) -> None:
        nonlocal begun
        if done and not begun:
            text = f"resuming {output}.partial: {done} of {total} regions are done"
            bar(done, total, text) if bar is not None else note(text)
        elif bar is not None:
            bar(done, total)
        begun = True

    return progress


@contextmanager
def _named_as_options() -> Iterator[None]:
    """Makes errors raised in the block name the command's options instead of the function's arguments."""
    from clvol.errors import UsageError

    try:
        yield
    except UsageError as error:
        where = f"--{error.where}" if error.where in ("codec", "edge", "shard") else error.where
        raise UsageError(where, error.what, error.expected) from None
