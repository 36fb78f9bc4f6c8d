"""clvol info: prints what a volume contains, and how much memory rendering it takes."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from clvol.cli.options import json_option, memory_cap_option, overrides_option, volume_argument

if TYPE_CHECKING:
    from clvol.store.stored_codes import CodesFacts
    from clvol.volume import Volume


@click.command("info", short_help="Print shape, type, spacing, range and memory of a volume.")
@volume_argument
@json_option
@overrides_option
@memory_cap_option("Largest amount of memory that the volume may take.")
def command(
    volume: str, as_json: bool, overrides: tuple[str, ...], memory_cap: int | None
) -> None:
    """Print what VOLUME contains: a volume file, a DICOM folder, a Zarr store or a scene.

    A .raw file needs --set volume.dims=[nx,ny,nz] --set 'volume.dtype="uint8"'.
    """
    from clvol.cli.console import say_json, say_table
    from clvol.integrators.registry import integrator_of
    from clvol.scene import load_scene
    from clvol.scene.sizes import format_size
    from clvol.volume import describe

    scene = load_scene(volume, overrides)
    integrator, loaded = integrator_of(scene), scene.load_volume(memory_cap)
    facts = describe(loaded)
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
        ("NaN voxels", str(loaded.nan_count)),
        ("infinite voxels", str(loaded.inf_count)),
        ("blocks", _blocks(store) if store else ""),
        ("codec", ", ".join(dict.fromkeys(store["codecs"])) if store else ""),
        *_codes_rows(store.get("codes")),
        ("compression", _asked(facts.get("compression"))),
        ("on disk", format_size(store["bytes_on_disk"]) if store else ""),
        ("memory", f"{needed} on the device, {by}picture and tables included"),
    ]
    say_table(row for row in rows if row[1])


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
