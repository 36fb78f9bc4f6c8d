"""The ray caster against closed forms and the exact integral, and what must not change a picture."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.small_scenes import SMOOTH, exact, make_scene, picture, rms, waves

from clvol import Camera, Renderer, TransferFunction, Volume
from clvol.errors import DeviceError, RenderError, SceneError, UsageError, VolumeError
from clvol.integrators.raycast.caster import Raycaster
from clvol.opencl.structs import view_dtype
from clvol.transfer.pieces import IN_HALF_REGISTERS, IN_REGISTERS, piece_count

CLASSIFICATIONS = ("pre", "post", "preintegrated")
TYPES = (np.uint8, np.int8, np.uint16, np.int16, np.float32, np.float64)
ONE_PEAK = TransferFunction([0, 95, 100, 105, 255], [0, 0, 0.7, 0, 0], [[1, 0, 0]] * 5)
PEAKS = TransferFunction(
    [0, 95, 100, 105, 175, 180, 185, 255],
    [0, 0, 0.7, 0, 0, 0.9, 0, 0],
    [[1, 0, 0]] * 4 + [[0, 1, 0]] * 4,
)
GREY = [[0.3, 0.5, 0.7]]


# --- closed forms ----------------------------------------------------------------------------------


@pytest.mark.parametrize("classification", CLASSIFICATIONS)
@pytest.mark.parametrize("dtype", TYPES)
def test_homogeneous_slab_absorbs_by_its_length_whatever_the_step(context, dtype, classification):
    array = np.full((5, 6, 7), 42, dtype)
    function = TransferFunction([0.0], [0.35], GREY, opacity_unit=1.7)
    grid = {"spacing": (0.5, 2.0, 3.0), "origin": (10.0, -4.0, 1.0)}
    camera = {
        "projection": "orthographic", "position": [0.0, 1.0, 7.0], "target": [11.5, 1.0, 7.0],
        "up": [0.0, 1.0, 0.0], "height": 6.0,
    }  # fmt: skip
    opacity = -np.expm1(3.0 / 1.7 * np.log1p(-0.35))  # the slab is 6 * 0.5 long
    for step in (0.37, 1.0, 2.5, 100.0):
        scene = make_scene(
            array, function, camera=camera, grid=grid, step=step, classification=classification
        )
        rgba = picture(context, scene).rgba
        np.testing.assert_allclose(rgba[..., 3], opacity, atol=2e-6)
        expected = np.broadcast_to(opacity * np.array(GREY[0]), (20, 24, 3))
        np.testing.assert_allclose(rgba[..., :3], expected, atol=2e-6)


@pytest.mark.parametrize("classification", CLASSIFICATIONS)
def test_linear_ramp_of_extinction_is_the_closed_form(context, classification):
    # Extinction runs linearly along x: tau = log-linear opacity, so sample it densely.
    n = 65
    array = np.broadcast_to(np.linspace(0, 1, n, dtype=np.float32), (3, 3, n)).copy()
    values = np.linspace(0, 1, 2001)
    function = TransferFunction(values, -np.expm1(-0.08 * values), np.tile(GREY, (2001, 1)))
    camera = {
        "projection": "orthographic", "position": [-5, 1, 1], "target": [5, 1, 1], "height": 1.5,
    }  # fmt: skip
    scene = make_scene(array, function, camera=camera, step=0.5, classification=classification)
    opacity = -np.expm1(-0.08 * (n - 1) / 2)
    np.testing.assert_allclose(picture(context, scene).rgba[..., 3], opacity, atol=1e-5)


def test_a_step_in_the_transfer_function_shows_the_length_behind_it(context):
    n = 101
    array = np.broadcast_to(np.linspace(0, 100, n, dtype=np.float32), (3, 3, n)).copy()
    function = TransferFunction([0, 40.3, 40.3, 100], [0, 0, 0.1, 0.1], np.tile(GREY, (4, 1)))
    camera = {
        "projection": "orthographic", "position": [-5, 1, 1], "target": [5, 1, 1], "height": 1.5,
    }  # fmt: skip
    scene = make_scene(array, function, camera=camera, step=0.7, table_size=512)
    opacity = -np.expm1((100 - 40.3) * np.log1p(-0.1))
    np.testing.assert_allclose(picture(context, scene).rgba[..., 3], opacity, atol=2e-4)


@pytest.mark.parametrize("classification", CLASSIFICATIONS)
@pytest.mark.parametrize("filter_name", ["nearest", "linear"])
def test_nested_boxes_agree_with_the_exact_integral(device, context, classification, filter_name):
    array = np.zeros((20, 22, 24), np.uint8)
    array[4:16, 4:18, 4:20] = 80
    array[7:13, 8:14, 9:15] = 200
    scene = make_scene(
        array, PEAKS if classification == "preintegrated" else SMOOTH, step=0.05,
        classification=classification, filter=filter_name,
    )  # fmt: skip
    # A box's face is a jump for the nearest filter: the sampling error is first order there.
    limit = 3e-3 if filter_name == "nearest" else 1e-3
    assert rms(picture(context, scene).rgba, exact(device, scene)) < limit


def test_an_opaque_ball_hides_what_is_behind_it_and_shows_its_front_colour(context):
    z, y, x = np.mgrid[:33, :33, :33] - 16.0
    array = (100.0 - 5.0 * np.sqrt(x * x + y * y + z * z)).astype(np.float32)
    function = TransferFunction(
        [0, 50, 50, 70, 100], [0, 0, 1, 1, 1], [GREY[0], GREY[0], [1, 0, 0], [0, 1, 0], [0, 1, 0]]
    )
    camera = {"position": [16, 16, -60], "target": [16, 16, 16], "fov_degrees": 20.0}
    data = picture(context, make_scene(array, function, camera=camera, width=41, height=41))
    centre = data.rgba[20, 20]
    assert centre[3] == 1.0
    assert centre[0] > 0.93 and centre[1] < 0.07  # not the mean of what the segment passes
    # The surface is 10 voxels in front of the centre; trilinear interpolation moves it a little.
    assert data.depth[20, 20] == pytest.approx(76 - 10, abs=0.6)
    assert data.rgba[0, 0, 3] == 0.0 and np.isinf(data.depth[0, 0])


# --- convergence -----------------------------------------------------------------------------------


@pytest.mark.parametrize("classification", CLASSIFICATIONS)
@pytest.mark.parametrize("projection", ["perspective", "orthographic"])
def test_it_converges_with_second_order_down_to_1e_5(device, context, classification, projection):
    array = waves((33, 35, 37))
    scenes = [
        make_scene(
            array, camera={"projection": projection}, width=16, height=16, step=step,
            classification=classification, table_size=512,
        )
        for step in (4.0, 2.0, 1.0, 0.5, 0.25, 0.0625)
    ]  # fmt: skip
    reference = exact(device, scenes[0])
    errors = [rms(picture(context, scene).rgba, reference) for scene in scenes]
    order = np.log2(errors[0] / errors[4]) / 4
    assert order > (1.7 if classification == "preintegrated" else 1.5), errors
    assert errors[-1] < 1e-5, errors


@pytest.mark.parametrize("dtype", TYPES)
def test_every_voxel_type_agrees_with_the_exact_integral(device, context, dtype):
    low, high = (-100, 100) if np.dtype(dtype).kind == "i" else (0, 255)
    array = waves((18, 20, 22), dtype, low, high)
    function = TransferFunction(
        SMOOTH.values / 255 * (high - low) + low, SMOOTH.opacities, SMOOTH.colors
    )
    scene = make_scene(array, function, step=0.125)
    assert rms(picture(context, scene).rgba, exact(device, scene)) < 2e-4


def test_a_peak_a_thousandth_of_the_range_wide_is_resolved(device, context):
    array = waves((24, 24, 24), np.uint16, 0, 65535)
    function = TransferFunction(
        [0, 30000, 30030, 30060, 65535], [0, 0, 0.9, 0, 0], np.tile(GREY, (5, 1)), 0.1
    )
    scene = make_scene(array, function, step=0.125)
    reference = exact(device, scene)
    assert reference[..., 3].max() > 0.05
    assert rms(picture(context, scene).rgba, reference) < 0.01 * reference[..., 3].max()


# --- what must not change the picture --------------------------------------------------------------


@pytest.mark.parametrize("classification", CLASSIFICATIONS)
def test_tiles_do_not_change_a_bit(context, classification):
    scene = make_scene(
        waves((21, 19, 23), np.uint8), PEAKS, width=45, height=38, classification=classification
    )
    pictures = [
        picture(context, scene, lanes=16, tile=tile) for tile in ((16, 16), (4, 4), (64, 8), (20, 36))
    ]
    for other in pictures[1:]:
        assert np.array_equal(pictures[0].rgba, other.rgba)
        assert np.array_equal(pictures[0].depth, other.depth)
        assert pictures[0].samples == other.samples


@pytest.mark.parametrize("classification", CLASSIFICATIONS)
def test_launching_in_bands_does_not_change_a_bit(context, classification, monkeypatch):
    from clvol.integrators.raycast import caster as raycast

    scene = make_scene(waves((21, 19, 23)), width=45, height=70, classification=classification)
    whole = picture(context, scene, lanes=16)
    monkeypatch.setattr(raycast, "_BAND_SECONDS", 1e-12)
    done = []
    caster = Raycaster(context, scene, lanes=16)
    cut = caster.render(scene.camera, 45, 70, lambda now, total: done.append((now, total)))
    assert done == [(k, 15) for k in range(1, 16)]
    assert np.array_equal(whole.rgba, cut.rgba) and whole.samples == cut.samples


@pytest.mark.parametrize("classification", CLASSIFICATIONS)
def test_a_packet_and_a_single_ray_give_the_same_picture(context, classification):
    scene = make_scene(waves((21, 19, 23)), PEAKS, classification=classification)
    packet, single = (picture(context, scene, lanes=lanes) for lanes in (16, 1))
    np.testing.assert_allclose(packet.rgba, single.rgba, atol=2e-5)


@pytest.mark.parametrize("classification", CLASSIFICATIONS)
@pytest.mark.parametrize("lanes", [1, 16])
def test_leaping_over_empty_space_changes_no_bit_and_takes_fewer_samples(
    context, classification, lanes
):
    array = np.zeros((70, 60, 50), np.uint8)
    array[10:14, 20:23, 30:33] = 200
    array[50:60, 40:55, 5:9] = waves((10, 15, 4), np.uint8, 60, 255)
    scene = make_scene(
        array, PEAKS, width=64, height=64, classification=classification, step=0.6
    )
    leaping = picture(context, scene, lanes=lanes)
    walking = picture(context, scene, lanes=lanes, skip=False)
    assert np.array_equal(leaping.rgba, walking.rgba)
    assert np.array_equal(leaping.depth, walking.depth)
    assert leaping.rgba[..., 3].max() > 0.1
    assert leaping.samples < walking.samples / 4


def test_a_transparent_volume_takes_no_sample(context):
    function = TransferFunction([0, 300, 400], [0, 0, 1], GREY * 3)
    data = picture(context, make_scene(waves((20, 20, 20), np.uint8), function))
    assert data.samples == 0 and not data.rgba.any()


def test_a_flipped_axis_in_the_header_is_a_flipped_volume(context):
    array = waves((15, 17, 19), np.uint8)
    flip = {"direction": np.diag([-1.0, 1.0, 1.0]), "origin": (18.0, 0.0, 0.0)}
    camera = {"position": [50, 40, -60], "target": [9, 8, 7], "up": [0, 1, 0]}
    flipped = picture(context, make_scene(array, camera=camera, grid=flip))
    plain = picture(context, make_scene(array[:, :, ::-1].copy(), camera=camera))
    np.testing.assert_allclose(flipped.rgba, plain.rgba, atol=1e-5)


def test_row_0_is_on_top_and_column_0_on_the_left(context):
    array = np.zeros((3, 9, 9), np.uint8)
    array[:, 8, 0] = 255  # large y, small x
    function = TransferFunction([0, 255], [0, 0.9], GREY * 2)
    # Looking along -z with y up, x runs to the right.
    camera = {
        "projection": "orthographic", "position": [4, 4, 50], "target": [4, 4, 1],
        "up": [0, 1, 0], "height": 9.0,
    }  # fmt: skip
    alpha = picture(
        context, make_scene(array, function, camera=camera, width=9, height=9)
    ).rgba[..., 3]
    assert np.unravel_index(alpha.argmax(), alpha.shape) == (0, 0)
    assert alpha[5:].max() == 0 and alpha[:, 5:].max() == 0


def test_samples_sit_at_voxel_centres_and_the_domain_is_their_hull(context):
    array = np.full((5, 5, 5), 100, np.uint8)
    function = TransferFunction([0], [0.5], GREY)
    camera = {
        "projection": "orthographic", "position": [2, 2, -9], "target": [2, 2, 2],
        "up": [0, 1, 0], "height": 6.0,
    }  # fmt: skip
    alpha = picture(
        context, make_scene(array, function, camera=camera, width=60, height=60)
    ).rgba[..., 3]
    inside = alpha > 0
    # Pixels are 0.1 wide; the hull runs from 0 to 4 in a window from -1 to 5.
    assert inside.any(axis=0).nonzero()[0].tolist() == list(range(10, 50))
    assert inside.any(axis=1).nonzero()[0].tolist() == list(range(10, 50))
    np.testing.assert_allclose(alpha[inside], 1 - 0.5**4, atol=1e-6)


# --- stopping early (what is hard for numbers: tests/hard_cases) -------------------------------------


def test_early_termination_saves_samples_and_keeps_its_promise(context):
    array = waves((40, 40, 40), np.uint8)
    function = TransferFunction([0, 255], [0.2, 0.9], GREY * 2)
    full = picture(context, make_scene(array, function))
    for threshold in (1e-3, 1e-2, 1e-1):
        early = picture(context, make_scene(array, function, early_termination=threshold))
        assert np.abs(early.rgba - full.rgba).max() <= threshold
        assert early.samples < full.samples
        full_opaque = full.rgba[..., 3] > 0.999
        assert full_opaque.any()


# --- what a change costs ---------------------------------------------------------------------------


def test_a_camera_move_compiles_nothing_and_a_transfer_function_only_rebuilds_tables(context):
    scene = make_scene(waves((20, 20, 20), np.uint8))
    caster = Raycaster(context, scene)
    caster.warm_up(24, 20)
    first = caster.render(scene.camera, 24, 20)
    programs, voxels = dict(context._programs), caster.volume.voxels
    for projection in ("perspective", "orthographic"):
        camera = Camera(projection=projection, position=(60.0, -20.0, 5.0))
        moved = caster.render(camera.complete(scene.volume.grid, scene.image), 24, 20)
        assert not np.array_equal(first.rgba, moved.rgba)
    assert piece_count(ONE_PEAK) <= IN_HALF_REGISTERS < piece_count(PEAKS) <= IN_REGISTERS
    for function, compiled in ((ONE_PEAK, 0), (PEAKS, 1), (SMOOTH, 1)):  # more pieces take another program, once
        caster.set_transfer_function(function)
        assert np.array_equal(first.rgba, caster.render(scene.camera, 24, 20).rgba) == (function is SMOOTH)
        assert programs.items() <= context._programs.items()
        assert len(context._programs) - len(programs) <= compiled  # 0 where a test before has compiled it
    assert caster.volume.voxels is voxels


def test_a_frame_that_somebody_holds_is_never_written_again(context):
    scene = make_scene(waves((20, 20, 20), np.uint8))
    caster = Raycaster(context, scene)
    other = Camera(projection="orthographic").complete(scene.volume.grid, scene.image)
    held = caster.render(scene.camera, 24, 20).rgba
    row = caster.render(scene.camera, 24, 20).rgba[3]  # a view holds it too
    before, row_before = held.copy(), row.copy()
    for camera in (other, scene.camera, other):
        caster.render(camera, 24, 20)
    assert np.array_equal(held, before) and np.array_equal(row, row_before)


def test_samples_are_proportional_to_the_length_of_the_rays(context):
    counts = {}
    for n in (16, 32, 64):
        scene = make_scene(waves((n, n, n), np.uint8), TransferFunction([0], [0.01], GREY))
        counts[n] = picture(context, scene).samples
    assert counts[32] / counts[16] == pytest.approx(2.0, rel=0.1)
    assert counts[64] / counts[32] == pytest.approx(2.0, rel=0.1)


@pytest.mark.parametrize("bits", [8, 16, 32, 64])
def test_the_view_struct_is_the_same_on_both_sides(context, bits):
    dtype = {8: np.uint8, 16: np.uint16, 32: np.float32, 64: np.float64}[bits]
    caster = Raycaster(context, make_scene(waves((8, 8, 8), dtype)))
    caster.check_structs(caster.switches)  # field by field
    assert caster.switches["VOXEL_BITS"] == bits


def test_a_caster_refuses_a_struct_that_is_not_the_devices(context, monkeypatch):
    ours = view_dtype(8)
    fields = {name: list(field[:2]) for name, field in ours.fields.items()}
    fields["step"][1], fields["stop_opacity"][1] = fields["stop_opacity"][1], fields["step"][1]
    formats, offsets = zip(*fields.values())
    swapped = np.dtype({"names": list(fields), "formats": formats, "offsets": offsets, "itemsize": ours.itemsize})
    monkeypatch.setattr(Raycaster, "structs", {"View": swapped})
    caster = Raycaster(context, make_scene(waves((8, 8, 8), np.uint8)))
    with pytest.raises(RenderError, match="struct View, field (step|stop_opacity)"):
        caster.warm_up(16, 16)


# --- the renderer ----------------------------------------------------------------------------------


def test_the_renderer_gives_frames_again_and_again(device):
    scene = make_scene(waves((20, 20, 20), np.uint8))
    with Renderer(scene, devices=[device]) as renderer:
        frame = renderer.render()
        again = renderer.render()
        other = renderer.render(camera=Camera(projection="orthographic"))
    assert frame.rgba.dtype == np.float32 and frame.rgba.shape == (20, 24, 4)
    assert np.array_equal(frame.rgba, again.rgba)
    assert not np.array_equal(frame.rgba, other.rgba)
    seconds = frame.stats["seconds"]
    assert set(seconds) == {"load", "prepare", "compile", "render", "write", "total"}
    assert all(value >= 0 for value in seconds.values())
    assert frame.stats["samples"] > 0 and frame.stats["rays"] == 480
    assert frame.stats["effects"] == ["emission-absorption"]
    with pytest.raises(RenderError, match="closed"):
        renderer.render()


def test_the_reference_method_is_a_renderer_too(device):
    array = waves((12, 12, 12))
    with Renderer(make_scene(array, method="reference"), devices=[device]) as renderer:
        reference = renderer.render()
    with Renderer(make_scene(array, step=0.05), devices=[device]) as renderer:
        fast = renderer.render()
    assert reference.stats["method"] == "reference" and reference.stats["samples"] > 0
    np.testing.assert_allclose(fast.rgba, reference.rgba, atol=1e-4)


@pytest.mark.slow
def test_a_volume_alone_is_not_blank_whatever_its_range(device):
    from clvol import Scene
    from clvol.scene import ImageSettings

    for low, high, dtype in ((0, 255, np.uint8), (1000, 1002, np.int16), (5e-7, 6e-7, np.float32),
                             (7, 7, np.uint8), (-1e6, 1e6, np.float64)):  # fmt: skip
        scene = Scene(
            volume=Volume(waves((16, 16, 16), np.float64, low, max(high, low + 1e-9)).astype(dtype)),
            image=ImageSettings(width=32, height=32),
        )
        with Renderer(scene, devices=[device]) as renderer:
            rgba = renderer.render().rgba
        assert rgba[..., 3].max() > 0.2, (low, high)
        assert (rgba[..., 3] > 0).mean() > 0.1, (low, high)


def test_what_cannot_be_rendered_is_refused_by_name(device):
    array = waves((8, 8, 8))
    with pytest.raises(SceneError, match="filter: got 'cubic' with the method 'multiresolution'"):
        Renderer(make_scene(array, method="multiresolution", filter="cubic"), devices=[device])
    with pytest.raises(UsageError, match="devices"):
        Renderer(make_scene(array), devices=[device, device])
    with pytest.raises(DeviceError):
        Renderer(make_scene(array), devices=["no such device"])


def test_the_memory_cap_refuses_before_the_upload(device):
    scene = make_scene(waves((16, 16, 16), np.uint8))
    with pytest.raises(VolumeError, match="at most the memory cap of 10000 bytes"):
        Renderer(scene, devices=[device], memory_cap=10**4)
    Renderer(scene, devices=[device], memory_cap=10**8).close()


def test_a_volume_larger_than_one_buffer_is_refused_with_the_numbers(context, monkeypatch):
    from clvol.device import volume as device_volume

    class Small:
        def __init__(self, device):
            self._device = device
            self.max_mem_alloc_size = 10_000

        def __getattr__(self, name):
            return getattr(self._device, name)

    monkeypatch.setattr(context, "device", Small(context.device))
    with pytest.raises(VolumeError, match="at most 10000 bytes"):
        device_volume.DeviceVolume(context, Volume(np.zeros((32, 32, 32), np.uint8)))
