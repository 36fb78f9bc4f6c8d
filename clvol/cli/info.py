"""clvol info: prints what a volume contains, and how much memory rendering it takes."""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import TYPE_CHECKING

import click

from clvol.cli.options import complete_file, json_option, memory_cap_option, overrides_option, volume_argument
from clvol.cli.standard_output import STANDARD, check_standard, is_standard, kept_clean
from clvol.errors import UsageError

if TYPE_CHECKING:
    from clvol.scene import Scene
    from clvol.store.stored_codes import CodesFacts
    from clvol.volume import Volume
    from clvol.volume.series import VolumeSeries

_BINS, _BINS_DRAWN = 24, 256  # of a histogram as text, and as a picture


@click.command("info", short_help="Print shape, type, spacing, range and memory of a volume.")
@volume_argument
@json_option
@overrides_option
@click.option("--histogram", is_flag=True, help="Print the histogram of the values, too.")
@click.option("--bins", type=click.IntRange(1, 65536), metavar="N", help="Most bins; 24, or 256 in a picture.")
@click.option(
    "-o", "--output", metavar="FILE", shell_complete=complete_file,
    help="Write the histogram as a picture (.png); '-' is standard output.",
)  # fmt: skip
@memory_cap_option("Largest amount of memory that the volume may take.")
def command(
    volume: str, as_json: bool, overrides: tuple[str, ...], histogram: bool, bins: int | None, output: str | None,
    memory_cap: int | None,
) -> None:  # fmt: skip
    """Print what VOLUME contains: a volume file, a DICOM folder, a Zarr store, a scene, or a picture that carries one.
    Of a series, as a pattern in quotes such as 't_*.nrrd', its steps are listed, and the range is that over all times.

    A .raw file needs --set volume.dims=[nx,ny,nz] --set 'volume.dtype="uint8"'.
    """
    from clvol.cli.outputs import check_outputs, scene_inputs
    from clvol.inputs import protected
    from clvol.scene import load_scene

    _check_output(output, histogram, bins, as_json)
    if is_standard(output):
        check_standard(1, int(as_json))
    scene = load_scene(volume, overrides)
    with protected(scene_inputs(volume, scene)), kept_clean(is_standard(output)) as write_standard:
        check_outputs([], [] if output is None or is_standard(output) else [output])
        _tell(scene, volume, as_json, histogram, bins, output, memory_cap, write_standard)


def _check_output(output: str | None, histogram: bool, bins: int | None, as_json: bool) -> None:
    for name, is_given in (("-o", output is not None), ("--bins", bins is not None)):
        if is_given and not histogram:
            raise UsageError(f"clvol info: {name}", "given without --histogram", "--histogram")
    if output is not None and not is_standard(output) and not output.lower().endswith(".png"):
        raise UsageError(output, "unknown ending of a histogram", "a file name that ends in .png, or -")


def _tell(
    scene: Scene, volume: str, as_json: bool, histogram: bool, bins: int | None, output: str | None,
    memory_cap: int | None, write_standard: Callable[[bytes], None],
) -> None:  # fmt: skip
    """Prints the facts; ``volume``: the name that was given."""
    from clvol.choice.histogram import histogram_of
    from clvol.cli.console import say, say_json, say_path, say_table, working
    from clvol.cli.histogram import drawn, histogram_rows
    from clvol.image import atomic_paths
    from clvol.integrators.registry import integrator_of
    from clvol.scene.sizes import format_size
    from clvol.volume import describe

    with working(f"reading {volume}", False, scene.input_paths):
        integrator, loaded = integrator_of(scene), scene.load_volume(memory_cap)
        facts = describe(loaded)
        steps = _step_facts(scene.load_series(memory_cap))
        if steps:
            facts["steps"] = steps
        told = histogram_of(loaded, bins or _BINS) if histogram else None
        if told is not None:
            facts["histogram"] = told.to_json()
        if told is not None and output is not None:
            name = loaded.name or os.path.basename(os.path.abspath(volume))
            picture = drawn(told if bins else histogram_of(loaded, _BINS_DRAWN), name)
            if output == STANDARD:
                write_standard(picture)
                return
            with atomic_paths([output]) as temporaries:
                temporaries[0].write_bytes(picture)
    facts["memory_needed"] = integrator.device_bytes(loaded, scene)
    store = _store_facts(loaded)
    if store:
        facts["store"] = store
    asked = scene.compression
    if asked.codec != "none":
        facts["compression"] = {"codec": asked.codec, **asked.target.to_json(), "decode": asked.decode}
    if as_json:
        say_json(facts)
        return
    grid = loaded.grid
    low, high = loaded.value_range
    needed, by = format_size(facts["memory_needed"]), integrator.memory_advice(scene)[0]
    rows = [
        ("file", str(facts.get("path") or volume)),
        ("format", str(facts.get("format") or "")),
        ("size", " x ".join(str(n) for n in grid.size) + "  (x, y, z)"),
        ("shape", f"{list(loaded.shape)}  [z, y, x]"),
        ("type", str(loaded.dtype)),
        ("spacing", _numbers(grid.spacing) + (f"  ({loaded.unit})" if loaded.unit else "")),
        ("origin", _numbers(grid.origin)),
        ("direction", "; ".join(_numbers(row) for row in grid.direction) + "  (row by row)"),
        ("frame", str(facts.get("frame") or "")),
        ("range", f"{low:.9g} to {high:.9g}"),
        ("values", "" if loaded.axis.is_plain else _line(loaded)),
        ("steps", f"{len(steps)}, whose range over all times is above" if steps else ""),
        ("NaN voxels", "" if steps else str(loaded.nan_count)),
        ("infinite voxels", "" if steps else str(loaded.inf_count)),
        ("blocks", _blocks(store) if store else ""),
        ("codec", ", ".join(dict.fromkeys(store["codecs"])) if store else ""),
        *_codes_rows(store.get("codes")),
        ("compression", _asked(facts.get("compression"))),
        ("on disk", format_size(store["bytes_on_disk"]) if store else ""),
        ("memory", f"{needed} on the device, {by}picture and tables included"),
    ]
    say_table(row for row in rows if row[1])
    if steps:
        say("\n".join(_step_rows(steps)))
    if told is not None:
        part = "" if told.voxels == told.all_voxels else f", of {told.voxels} of {told.all_voxels} voxels"
        say(f"histogram  (bars are logarithmic{part})")
        say("\n".join(histogram_rows(told)))
    if output is not None:
        say_path(output)


def _step_facts(series: VolumeSeries | None) -> list[dict]:
    """What is known of the steps of a series, as JSON types: range and counts are None where it was stated for all of
    them, ``error`` the reason why a step cannot be read."""
    if series is None:
        return []
    facts = series.facts
    found = []
    for k, step in enumerate(series.steps):
        known, failure = series.ranges.get(k), series.failures.get(k)
        span = None if known is None or known.span is None else list(facts.axis.span(known.span))
        found.append({
            "step": k, "name": step.name, "path": step.path, "value_range": span,
            "nan_count": None if known is None else known.nans, "inf_count": None if known is None else known.infs,
            "error": None if failure is None else str(failure),
        })  # fmt: skip
    return found


def _step_rows(steps: list[dict]) -> list[str]:
    """A line for each step: number, range, holes, and name or error."""
    lines = []
    for each in steps:
        low, high = each["value_range"] or (None, None)
        told = "" if low is None else f"{low:.6g} to {high:.6g}"
        for count, what in ((each["nan_count"], "NaN"), (each["inf_count"], "infinite")):
            told += f", {count} {what}" if count else ""
        lines.append((str(each["step"]), told, each["error"] or each["name"]))
    widths = [max(len(line[k]) for line in lines) for k in (0, 1)]
    return [f"  {number:>{widths[0]}}  {told:<{widths[1]}}  {name}".rstrip() for number, told, name in lines]


def _asked(compression: dict | None) -> str:
    """What a scene requests of a codec, in words."""
    if compression is None:
        return ""
    stated = [f"{key} {value:g}" for key, value in compression.items() if key not in ("codec", "decode")]
    return ", ".join([compression["codec"], *stated, f"decode {compression['decode']}"])


def _store_facts(volume: Volume) -> dict:
    """Facts about a store made by ``clvol store``; nothing for other volumes."""
    source = getattr(volume, "blocks_source", None)
    if source is None:
        return {}
    layout = source.layout
    facts = {
        "edge": layout.edge,
        "levels": layout.blocks.levels,
        "blocks_zyx": list(layout.blocks.counts),
        "shard": layout.shard,
        "codecs": [codec.name for codec in layout.codecs],
        "lossless": all(codec.lossless for codec in layout.codecs),
        "bytes_on_disk": source.bytes_on_disk,
        "checks_places": source.checks_places,
    }
    return facts if source.codes is None else facts | {"codes": _codes_facts(source.codes)}


def _codes_facts(codes: CodesFacts) -> dict:
    """What was measured while the store was built. ``psnr`` is None if nothing differs."""
    from math import isfinite

    measured = codes.measured
    return {
        "codec": codes.codec,
        "psnr": measured.psnr if isfinite(measured.psnr) else None,
        "max_voxel_error": measured.max_voxel_error,
        "bits_per_voxel": measured.bits_per_voxel,
        "bits_per_voxel_all": codes.bits_per_voxel_all,
        "target": codes.target.to_json(),
        "seed": codes.seed,
        **({"distinct_vectors": codes.policy["distinct_vectors"]} if "distinct_vectors" in codes.policy else {}),
        "original": {"dtype": codes.original_dtype.name, "value_range": list(codes.original_range)},
    }


def _codes_rows(codes: dict | None) -> list[tuple[str, str]]:
    if codes is None:
        return []
    psnr = "no error" if codes["psnr"] is None else f"PSNR {codes['psnr']:.2f} dB"
    largest = f"largest {100 * codes['max_voxel_error']:.3g} % of the range"
    rate, whole = (f"{codes[key]:.3g}" for key in ("bits_per_voxel", "bits_per_voxel_all"))
    low, high = codes["original"]["value_range"]
    target = ", ".join(f"{key} {value:g}" for key, value in codes["target"].items())
    return [
        ("bits per voxel", f"{rate} at full resolution with codebooks, {whole} in all"),
        ("error", psnr if codes["psnr"] is None else f"{psnr}, {largest}"),
        *([("vectors", f"{codes['distinct_vectors']} distinct ones, fewer than codes, each exact")]
          if "distinct_vectors" in codes else []),
        ("requested", target),
        ("original", f"{codes['original']['dtype']}, {low:.9g} to {high:.9g}"),
    ]


def _blocks(store: dict) -> str:
    counts, edge = store["blocks_zyx"], store["edge"]
    sizes = ", ".join(f"{edge >> level}^3" for level in range(store["levels"]))
    size = " x ".join(map(str, counts[::-1]))
    return f"{size} of {edge}^3, at {sizes}; files of {store['shard']}^3"


def _line(volume: Volume) -> str:
    return f"{volume.slope:.9g} * stored {'-' if volume.offset < 0 else '+'} {abs(volume.offset):.9g}"


def _numbers(values) -> str:
    return " ".join(f"{float(value):.9g}" for value in values)
