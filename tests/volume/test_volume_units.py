"""Units of length: one for all axes, whatever each is called."""

from __future__ import annotations

import json

import nibabel
import numpy as np
import pytest
import tifffile
import zarr
from click.testing import CliRunner
from slice_files import loaded, voxels

from clvol.cli.info import command as info
from clvol.readers import load_volume
from clvol.store.build import build_store
from clvol.volume import Volume
from clvol.volume.units import find_unit, one_unit

METRES = {
    1e-10: ("Å", "Angstrom", "angstrom", "\u212b", "ångström"),
    1e-12: ("pm", "picometer", "picometre"),
    1e-9: ("nm", "nanometer", "Nanometre", "nanometers", " NM "),
    1e-6: ("µm", "μm", "um", "micron", "microns", "micrometer", "MICROMETER", "\\u00B5m"),
    1e-3: ("mm", "millimeter", "millimetre", "Millimeters", "MM"),
    1e-2: ("cm", "centimeter"),
    1.0: ("m", "meter", "metres"),
    1e3: ("km", "kilometer"),
    1e6: ("Mm", "megameter"),
    0.0254: ("inch", "in", "Inches"),
    0.3048: ("ft", "foot", "feet"),
}
SPELLINGS = [(name, metres) for metres, names in METRES.items() for name in names]


@pytest.mark.parametrize("name, metres", SPELLINGS)
def test_spellings(name, metres) -> None:
    assert find_unit(name)[1] == pytest.approx(metres, rel=1e-15)


def test_what_is_no_length() -> None:
    for name in ("pixel", "px", "reference frame", "voxels"):
        assert find_unit(name) == ("pixel", None)
    for name in (None, "", "second", "hertz", "bananas", "mb"):
        assert find_unit(name) is None


def test_one_unit_for_all_axes() -> None:
    assert one_unit(["µm", "micron", "nm"]) == ([1.0, 1.0, 1e-3], "µm", None)
    assert one_unit(["nm", "nm", "µm"]) == ([1.0, 1.0, 1e3], "nm", None)
    assert one_unit(["inch"] * 3) == ([1.0] * 3, "in", None)
    assert one_unit(["mm", "mm", "inch"])[0] == pytest.approx([1, 1, 25.4], rel=1e-15)
    assert one_unit([None] * 3) == ([1.0] * 3, None, None)
    assert one_unit(["µm", "µm", "pixel"], [True, True, False]) == ([1.0] * 3, "µm", None)
    for mixed in (["µm", "µm", "pixel"], ["µm", "µm", None], ["bananas", "bananas", "nm"]):
        factors, unit, wrong = one_unit(mixed)
        assert factors == [1.0] * 3 and unit is None and "cannot be brought to one" in wrong
    assert "unknown unit of length 'bananas'" in one_unit(["bananas"] * 3)[2]


# ---- in files ------------------------------------------------------------------------------------

# Along x, y, z: sizes and their units as written; the spacing in the unit of x.
MIXED = [
    ((0.1, 0.1, 200.0), ("µm", "µm", "nm"), (0.1, 0.1, 0.2), "µm"),
    ((100.0, 100.0, 0.2), ("nm", "nm", "µm"), (100, 100, 200), "nm"),
    ((0.5, 600.0, 0.07), ("mm", "µm", "cm"), (0.5, 0.6, 0.7), "mm"),
    ((1000.0, 1.0, 2.0), ("Å", "nm", "pm"), (1000, 10, 0.02), "Å"),
    ((2.0, 2.0, 3.0), ("pixel", "pixel", "pixel"), (2, 2, 3), "pixel"),
]
LONG_NAMES = {"µm": "micrometer", "nm": "nanometer", "mm": "millimeter", "cm": "centimeter"}
LONG_NAMES |= {"Å": "angstrom", "pm": "picometer", "pixel": "pixel"}


@pytest.mark.parametrize("sizes, units, spacing, unit", MIXED)
def test_ome_tiff(tmp_path, sizes, units, spacing, unit) -> None:
    metadata = {"axes": "ZYX"}
    for axis, size, name in zip("XYZ", sizes, units):
        metadata |= {f"PhysicalSize{axis}": size, f"PhysicalSize{axis}Unit": name}
    path = tmp_path / "v.ome.tif"
    tifffile.imwrite(path, voxels(), metadata=metadata, photometric="minisblack")
    volume, warned = loaded(path)
    assert volume.grid.spacing == pytest.approx(spacing, rel=1e-12)
    assert volume.unit == unit and warned == ""
    said = json.loads(CliRunner().invoke(info, [str(path), "--json"]).output)
    assert said["unit"] == unit
    assert f"({unit})" in CliRunner().invoke(info, [str(path)]).output


def test_ome_tiff_without_units_is_in_micrometres(tmp_path) -> None:
    metadata = dict(axes="ZYX", PhysicalSizeX=0.5, PhysicalSizeY=0.5, PhysicalSizeZ=2000.0)
    metadata["PhysicalSizeZUnit"] = "nm"
    tifffile.imwrite(
        tmp_path / "v.ome.tif", voxels(), metadata=metadata, photometric="minisblack"
    )
    volume, _ = loaded(tmp_path / "v.ome.tif")
    assert volume.grid.spacing == (0.5, 0.5, 2.0) and volume.unit == "µm"


def test_ome_tiff_that_leaves_out_z_says_so(tmp_path) -> None:
    metadata = dict(axes="ZYX", PhysicalSizeX=0.5, PhysicalSizeY=0.5)
    tifffile.imwrite(
        tmp_path / "v.ome.tif", voxels(), metadata=metadata, photometric="minisblack"
    )
    volume, warned = loaded(tmp_path / "v.ome.tif")
    assert volume.grid.spacing == (0.5, 0.5, 0.5) and "PhysicalSizeZ" in warned


@pytest.mark.parametrize("sizes, units, spacing, unit", MIXED)
def test_imagej(tmp_path, sizes, units, spacing, unit) -> None:
    written = ["\\u00B5m" if name == "µm" else LONG_NAMES[name] for name in units]
    tifffile.imwrite(
        tmp_path / "v.tif",
        voxels("uint16"),
        imagej=True,
        resolution=(1 / sizes[0], 1 / sizes[1]),
        metadata=dict(
            axes="ZYX", spacing=sizes[2], unit=written[0], yunit=written[1], zunit=written[2]
        ),
    )
    volume, warned = loaded(tmp_path / "v.tif")
    assert volume.grid.spacing == pytest.approx(spacing, rel=1e-6)
    assert volume.unit == unit and warned == ""


@pytest.mark.parametrize("version", ["0.4", "0.5"])
@pytest.mark.parametrize("sizes, units, spacing, unit", MIXED)
def test_ome_zarr(tmp_path, version, sizes, units, spacing, unit) -> None:
    axes = [
        {"name": axis, "type": "space", "unit": LONG_NAMES[name]}
        for axis, name in zip("zyx", units[::-1])
    ]
    moved = [7.0 * size for size in sizes[::-1]]
    steps = [
        {"type": "scale", "scale": list(sizes[::-1])},
        {"type": "translation", "translation": moved},
    ]
    multiscale = {"axes": axes, "datasets": [{"path": "0", "coordinateTransformations": steps}]}
    older = version == "0.4"
    group = zarr.open_group(str(tmp_path / "v.zarr"), mode="w", zarr_format=2 if older else 3)
    group.create_array("0", data=voxels())
    whole = {"version": version, "multiscales": [multiscale]}
    group.attrs.update({"multiscales": [multiscale]} if older else {"ome": whole})
    volume, warned = loaded(tmp_path / "v.zarr")
    assert volume.grid.spacing == pytest.approx(spacing, rel=1e-12)
    assert volume.grid.origin == pytest.approx([7 * length for length in spacing], rel=1e-12)
    assert volume.unit == unit and warned == ""


def test_units_that_do_not_go_together_are_told(tmp_path) -> None:
    tifffile.imwrite(
        tmp_path / "v.tif",
        voxels("uint16"),
        imagej=True,
        resolution=(2, 2),
        metadata=dict(axes="ZYX", spacing=3, unit="um", zunit="pixel"),
    )
    volume, warned = loaded(tmp_path / "v.tif")
    assert volume.grid.spacing == (0.5, 0.5, 3.0) and volume.unit is None
    assert "cannot be brought to one (x um, y um, z pixel)" in warned


@pytest.mark.parametrize("name, unit", [("mm", "mm"), ("micron", "µm"), ("meter", "m")])
def test_nifti(tmp_path, name, unit) -> None:
    image = nibabel.Nifti1Image(voxels().transpose(), np.diag([0.5, 2, 3, 1]))
    image.header.set_xyzt_units(name)
    nibabel.save(image, tmp_path / "v.nii")
    assert load_volume(tmp_path / "v.nii").unit == unit


def test_resolution_tags(tmp_path) -> None:
    for name, unit, spacing in (("INCH", "mm", 12.7), ("CENTIMETER", "mm", 5), ("NONE", None, 0.5)):
        tifffile.imwrite(
            tmp_path / "v.tif",
            voxels(),
            resolution=(2, 2),
            resolutionunit=name,
            photometric="minisblack",
        )
        volume = load_volume(tmp_path / "v.tif")
        assert volume.grid.spacing[0] == pytest.approx(spacing, rel=1e-12) and volume.unit == unit


@pytest.mark.parametrize("unit", ["mm", "µm", "Å", "in", "pixel", None])
def test_a_store_keeps_the_unit(tmp_path, unit) -> None:
    build_store(Volume(voxels(), (1, 2, 3), unit=unit), tmp_path / "s.zarr")
    assert load_volume(tmp_path / "s.zarr").unit == unit
    said = json.loads((tmp_path / "s.zarr" / "zarr.json").read_text())
    for axis in said["attributes"]["ome"]["multiscales"][0]["axes"]:
        assert axis.get("unit") == (LONG_NAMES | {"in": "inch", "pixel": None, None: None})[unit]
