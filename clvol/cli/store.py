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
    from clvol.store.codecs.coded_blocks import RateTarget
    from clvol.store.codecs.encoding import Trainer
    from clvol.store.journal import Unfinished
    from clvol.store.voxel_source import FieldSource, VolumeSource


@click.command("store", short_help="Build the multiresolution store of a volume.")
@volume_argument
@click.option(
    "-o", "--output", required=True, metavar="STORE", help="Folder to write, an OME-Zarr image."
)
@click.option(
    "--codec",
    metavar="NAME",
    help="Lossless: blosc-lz4 (default), zstd or none, and for labels and masks 'labels'. Lossy: rvq (the one to use), "
    "hvq, vq-mean or vq, vector quantisation that is decoded by clvol.",
)
@click.option(
    "--max-voxel-error",
    type=float,
    metavar="E",
    help="With a lossy codec: largest error of any voxel, as a share of the volume's range of values, such as 0.01.",
)
@click.option(
    "--psnr", type=float, metavar="DB", help="With a lossy codec: signal-to-noise ratio to reach, over the range."
)
@click.option(
    "--bits-per-voxel",
    type=float,
    metavar="B",
    help="With a lossy codec: size of level 0 with codebooks to stay below. At most one of these three.",
)
@click.option(
    "--seed",
    type=click.IntRange(0, 2**31 - 1),
    metavar="N",
    help="With a lossy codec: seed of the random choice of the voxels that codebooks are made from; default 0. The "
    "same voxels, options and seed give the same bytes.",
)
@click.option(
    "--device",
    "devices",
    multiple=True,
    metavar="NAME",
    help="With a lossy codec: device that encodes, by its name in 'clvol doctor'. Repeatable: devices share the "
    "blocks. The store does not depend on them.",
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
    max_voxel_error: float | None,
    psnr: float | None,
    bits_per_voxel: float | None,
    seed: int | None,
    devices: tuple[str, ...],
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

    A lossy codec stores codes of blocks instead of samples; 'clvol info STORE' prints the measured errors. Lossy codecs
    refuse labels and masks. The coarsest levels are always samples, which other Zarr readers open.

    The store appears whole or not at all. An interrupted run leaves STORE.partial; the same command resumes it.
    """
    from pathlib import Path

    from clvol.cli.console import say_path, working
    from clvol.cli.outputs import scene_inputs
    from clvol.errors import UsageError
    from clvol.scene import load_scene
    from clvol.store.build import build_store
    from clvol.store.build_folder import check_place, places_of
    from clvol.store.codecs import DEFAULT
    from clvol.store.codecs.coded_blocks import RateTarget
    from clvol.store.geometry import EDGE
    from clvol.store.journal import unfinished

    codec = DEFAULT if codec is None else codec
    target = RateTarget(max_voxel_error, psnr, bits_per_voxel)
    lossy = _checked(codec, target, devices, seed)
    check_place(Path(output), overwrite)
    scene = load_scene(volume, overrides)
    if not scene.step_is_fixed and (series := scene.load_series(memory_cap)) is not None:
        raise UsageError(volume, f"a series of {len(series)} steps", "one of them: --set volume.step=0")
    inputs = scene_inputs(volume, scene)
    for place in places_of(Path(output)):
        inputs.check_folder(place)
    source = _source(scene, volume, memory_cap, quiet)
    left = None if restart or quiet else unfinished(Path(output))
    with _trainer(devices, lossy, quiet) as trainer, _named_as_options():
        with working(f"storing {volume}", quiet) as bar:
            build_store(
                source, output, edge=EDGE if edge is None else edge, shard=shard, codec=codec, target=target,
                trainer=trainer, seed=seed or 0, overwrite=overwrite, restart=restart,
                progress=None if quiet else _reporting(output, bar, left),
                on_phase=None if bar is None else lambda name: bar(None, None, f"{name} {volume}"),
            )  # fmt: skip
    say_path(output)


def _checked(codec: str, target: RateTarget, devices: tuple[str, ...], seed: int | None) -> bool:
    """Whether the codec needs a device; UsageError if the options do not fit it."""
    from clvol.errors import UsageError
    from clvol.store.codecs import CODECS, CODES
    from clvol.store.coding import check_target

    chosen = CODECS.get(codec) or CODES.get(codec)
    if chosen is None:
        return False  # build_store says so
    with _named_as_options():
        check_target(chosen, target)
    for option, given, needed in (
        ("--device", next(iter(devices), None), "which needs a device"), ("--seed", seed, "which draws voxels")
    ):  # fmt: skip
        if given is not None and chosen.lossless:
            raise UsageError(option, f"got {given!r} with the codec {codec!r}", f"a lossy codec, {needed}")
    return not chosen.lossless


@contextmanager
def _trainer(devices: tuple[str, ...], needed: bool, quiet: bool) -> Iterator[Trainer | None]:
    """A trainer on ``devices`` (none: the default) for the block; None if it is not ``needed``."""
    if not needed:
        yield None
        return
    from clvol.cli.devices import measure_for_all
    from clvol.encoding.shared import SharedTrainer
    from clvol.encoding.trainer import CodeTrainer
    from clvol.render.renderer import open_contexts

    measure_for_all(devices, quiet)
    contexts = open_contexts(devices)
    trainer = SharedTrainer([CodeTrainer(context) for context in contexts], [context.name for context in contexts])
    try:
        yield trainer
    finally:
        trainer.close()
        for context in contexts:
            context.release()


def _source(scene: Scene, volume: str, memory_cap: int | None, quiet: bool) -> FieldSource | VolumeSource:
    """The voxels to store: those of a computed field are computed when they are needed, others are loaded."""
    from clvol.cli.console import working
    from clvol.store.voxel_source import FieldSource, VolumeSource
    from clvol.volume.axis import ValueAxis

    settings = scene.volume
    if settings.field is not None and settings.size is not None:
        axis = ValueAxis(settings.slope, settings.offset)
        return FieldSource(settings.field, settings.size, settings.spacing or (1.0, 1.0, 1.0), axis)
    with working(f"loading {volume}", quiet, [volume]):
        return VolumeSource(scene.load_volume(memory_cap), settings.model_dump(mode="json"))


def _reporting(output: str, bar: ShowProgress | None, left: Unfinished | None) -> Callable[[int, int], None]:
    """A progress function that moves the bar, if there is one, and reports once that what is ``left`` is resumed."""
    from clvol.cli.console import note

    begun = False

    def progress(done: int, total: int) -> None:
        nonlocal begun
        if left is not None and left.done and not begun:
            text = f"resuming {output}.partial: {left.done} of {left.total} regions are done"
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
        options = ("codec", "edge", "shard", "max_voxel_error", "psnr", "bits_per_voxel")
        where = f"--{error.where.replace('_', '-')}" if error.where in options else error.where
        raise UsageError(where, error.what, error.expected) from None
