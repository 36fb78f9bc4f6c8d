"""What the bench of compression is made of: its arithmetic, its tables, its pictures, and the process of its peers,
with stand-ins for zfp and SZ3."""

from __future__ import annotations

import json
import math
import sys

import numpy as np
import pytest
from PIL import Image

from bench import compression as bench
from bench import compression_peers
from bench.compression_chart import CURVES, curve_points, rate_chart
from bench.compression_child import as_voxels
from bench.compression_errors import bits_at_error, bits_at_psnr, bits_per_voxel, voxel_error
from bench.compression_pictures import chosen, codec_strip, shown_rate
from bench.compression_rates import middle, picture_name
from bench.compression_scenes import BOUNDS, CODED_SCENES, ENGINE, Ask, asks
from bench.compression_speed import ASKED, rate
from bench.compression_tables import equal_rows, markdown, markdown_table, reach_text, show, verdicts
from bench.options import Options

# Errors


def test_errors_are_those_of_the_definition():
    random = np.random.default_rng(4)
    voxels = random.integers(10, 200, (40, 5, 6)).astype(np.uint8)
    decoded = np.clip(voxels.astype(int) + random.integers(-9, 10, voxels.shape), 0, 255).astype(np.uint8)
    apart = decoded.astype(float) - voxels
    found = voxel_error(decoded, voxels, (10.0, 199.0))
    assert found.largest == pytest.approx(np.abs(apart).max() / 189.0)
    assert found.psnr == pytest.approx(20 * math.log10(189.0 / math.sqrt(np.mean(apart**2))))


def test_equal_voxels_have_no_error_and_those_without_a_value_do_not_count():
    voxels = np.array([[[0.0, np.nan], [np.inf, 2.0]]], np.float32)
    decoded = np.array([[[0.0, 5.0], [7.0, 2.0]]], np.float32)
    found = voxel_error(decoded, voxels, (0.0, 2.0))
    assert found.psnr == math.inf and found.largest == 0.0
    decoded[0, 1, 1] = 1.0
    assert voxel_error(decoded, voxels, (0.0, 2.0)).largest == 0.5
    assert voxel_error(np.full_like(voxels, 3.0), np.full_like(voxels, 3.0), (3.0, 3.0)).psnr == math.inf


def test_voxels_of_another_type_or_shape_are_not_compared():
    voxels = np.zeros((2, 2, 2), np.uint8)
    for other in (voxels.astype(np.float32), voxels[1:]):
        with pytest.raises(ValueError, match="beside"):
            voxel_error(other, voxels, (0.0, 1.0))


def test_rates_at_the_same_error_lie_on_the_curve():
    assert bits_per_voxel(300, 100) == 24.0
    curve = [(1.0, 40.0), (4.0, 50.0), (0.25, 30.0)]
    assert bits_at_psnr(curve, 45.0).seconds == pytest.approx(2.0)
    assert bits_at_psnr(curve, 40.0).seconds == pytest.approx(1.0)
    assert bits_at_psnr(curve, 51.0).seconds is None
    assert bits_at_psnr(curve, 20.0).kind == "at most"
    assert bits_at_error([(1.0, 0.04), (4.0, 0.01)], 0.02).seconds == pytest.approx(2.0)
    assert [reach_text(vars(bits_at_psnr(curve, psnr))) for psnr in (45.0, 51.0, 20.0)] == [
        "2.00", "not reached", "≤ 0.25"
    ]  # fmt: skip


# Scenes


def test_every_goal_is_asked_for_and_every_curve_is_drawn():
    for scene in CODED_SCENES:
        all_of = list(asks(scene))
        if scene.goal is not None:
            assert Ask("rvq", "rate", scene.goal[0]) in all_of and Ask("rvq", "psnr", scene.goal[1]) in all_of
        assert {ask.curve for ask in all_of} - {"rvq, psnr"} == CURVES.keys()
        assert len({picture_name(scene.name, ask.curve, ask.value) for ask in all_of}) == len(all_of)
        assert {ask.curve for ask in asks(scene, quick=True)} == {ask.curve for ask in all_of}
        assert ASKED[scene.name][0] in all_of


def test_targets_are_what_a_scene_may_state():
    from clvol.store.codecs.coded_blocks import RateTarget

    for ask in asks(ENGINE):
        if not ask.is_peer:
            assert RateTarget(**ask.target).to_json() == ask.target
    assert Ask("rvq", "bound", 0.02).target == {"max_voxel_error": 0.02}
    assert Ask("vq").target == {}


def test_only_volumes_that_are_there_are_measured(monkeypatch, tmp_path):
    monkeypatch.setattr("bench.scenes.BenchScene.path", lambda scene: tmp_path / scene.file)
    (tmp_path / "heptane.nrrd").touch()
    missing: list[str] = []
    assert [scene.name for scene in bench.coded_scenes(Options(), missing)] == ["heptane"]
    assert missing == ["engine-smooth", "chest", "aneurism"]


def test_a_quick_run_takes_the_middle():
    from clvol import Volume

    volume = Volume(np.arange(9 * 4 * 12, dtype=np.uint16).reshape(9, 4, 12), spacing=(1.0, 2.0, 3.0))
    found = middle(volume, 5)
    assert (found.data == volume.data[2:7, :, 3:8]).all() and found.grid.spacing == volume.grid.spacing


# Peers


def test_values_are_rounded_and_clipped_to_the_type_of_voxels():
    values = np.array([-3.0, 1.4, 254.6, 300.0], np.float32)
    assert as_voxels(values, np.dtype(np.uint8)).tolist() == [0, 1, 255, 255]
    assert as_voxels(values, np.dtype(np.float32)) is not None
    assert as_voxels(values, np.dtype(np.float32)).tolist() == values.tolist()


ZFPY = """
import numpy as np
def compress_numpy(values, tolerance=0.0, rate=0.0):
    assert values.dtype == np.float32
    step = tolerance or 1.0 / rate
    return repr((np.rint(values / step).tolist(), step)).encode()
def decompress_numpy(stream):
    values, step = eval(stream)
    return np.array(values, np.float32) * step
"""
PYSZ = """
import numpy as np
class szErrorBoundMode:
    ABS = 0
class szConfig:
    def __init__(self, shape):
        self.shape = shape
class sz:
    def compress(values, config):
        assert config.errorBoundMode == 0 and config.shape == values.shape
        return np.append(np.float32(config.absErrorBound), values.ravel()).view(np.uint8), 1.0
    def decompress(stream, dtype, shape):
        values = stream.view(np.float32)
        return values[1:].reshape(shape) + values[0], None
"""


@pytest.fixture
def process(tmp_path, monkeypatch):
    """The child process with stand-ins: a zfp that rounds to multiples of its tolerance, a SZ3 off by its bound."""
    packages = tmp_path / "packages"
    for name, code in (("zfpy", ZFPY), ("pysz", PYSZ)):
        packages.mkdir(exist_ok=True)
        (packages / f"{name}.py").write_text(code, encoding="utf-8")
        info = packages / f"{name}-1.5.dist-info"
        info.mkdir()
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.5\n", encoding="utf-8")
    monkeypatch.setenv("PYTHONPATH", str(packages))
    found = compression_peers.Peers(sys.executable, tmp_path)
    yield found
    found.close()


def test_peers_encode_and_decode_in_their_own_process(process, tmp_path):
    voxels = np.arange(24, dtype=np.uint8).reshape(2, 3, 4)
    assert process.codecs == ("zfp", "sz3") and process.versions["zfpy"] == "1.5"
    process.load(voxels)
    encoded = process.encode("zfp", "tolerance", 4.0)
    decoded, seconds = process.decode(encoded)
    assert decoded.dtype == np.uint8 and (decoded == 4 * np.rint(voxels / 4)).all()
    assert encoded.bytes > 24 and encoded.seconds > 0.0 < seconds and process.decode_seconds(encoded) > 0.0
    coarse = process.encode("zfp", "rate", 0.25)
    assert (process.decode(coarse)[0] == decoded).all()  # both are kept side by side
    assert not list(tmp_path.glob("*.npy"))


def test_sz3_uses_the_rounding_of_integers_and_nothing_else(process):
    for dtype, bound, off in ((np.uint8, 2.9, 2), (np.int16, 5.0, 5), (np.float32, 2.5, 2.5)):
        process.load(np.full((2, 2, 2), 7, dtype))
        decoded, _ = process.decode(process.encode("sz3", "bound", bound))
        assert decoded.dtype == dtype and (decoded == 7 + off).all()


def test_what_a_peer_cannot_do_is_an_error_and_the_process_goes_on(process):
    process.load(np.zeros((2, 2, 2), np.uint8))
    with pytest.raises(compression_peers.PeerError, match="sz3 rate 1: ValueError"):
        process.encode("sz3", "rate", 1.0)
    encoded = process.encode("sz3", "bound", 1.0)
    process.forget()
    with pytest.raises(compression_peers.PeerError, match="KeyError"):
        process.decode(encoded)


def test_a_process_that_ends_is_an_error(process):
    process._process.kill()
    with pytest.raises(compression_peers.PeerError, match="ended"):
        process.load(np.zeros((1, 1, 1), np.uint8))


def test_where_nothing_can_be_installed_the_bench_says_so(monkeypatch, tmp_path):
    commands: list[list[str]] = []

    def fails(command, say):
        commands.append(command)
        return "venv" in command

    monkeypatch.setattr(compression_peers, "_quietly", fails)
    said: list[str] = []
    assert compression_peers.environment(said.append, tmp_path / "peers") is None
    assert [command[-1] for command in commands[1:]] == ["zfpy", "pysz"]
    monkeypatch.setattr(compression_peers, "environment", lambda say: None)
    with compression_peers.peers(said.append) as found:
        assert found is None
    assert "left out" in said[-1]


def test_an_environment_that_is_there_is_not_made_again(monkeypatch, tmp_path):
    monkeypatch.setattr(compression_peers, "_quietly", lambda command, say: pytest.fail("made again"))
    python = tmp_path / ("Scripts/python.exe" if sys.platform == "win32" else "bin/python")
    python.parent.mkdir()
    python.touch()
    (tmp_path / "installed.json").touch()
    assert compression_peers.environment(print, tmp_path) == python


# What is said


def _row(volume: str, codec: str, kind: str, asked: float | None, bits: float, psnr: float, largest: float) -> dict:
    ask = Ask(codec, kind, asked)
    return {"volume": volume, "codec": codec, "kind": kind, "curve": ask.curve, "asked": asked, "bytes": 100,
            "bits": bits, "psnr": psnr, "largest": largest, "delta_e": 0.1, "delta_e_largest": 2.0,
            "encode_seconds": 1.0, "decode_seconds": 0.5, "training_seconds": 9.0,
            "picture": picture_name(volume, ask.curve, asked)}  # fmt: skip


def _time(median: float) -> dict:
    return {"median": median, "min": median, "max": median, "spread": 0.02, "frames": 7}


def _ratio(ratio: float) -> dict:
    return {"ratio": ratio, "low": 0.9 * ratio, "high": 1.1 * ratio}


def _result() -> dict:
    held = {"time": _time(0.01), **_ratio(1.0), "compression": None, "delta_e": 0.0, "delta_e_largest": 0.0}
    methods = [f"{held}, {method}" for held in ("voxels", "resident") for method in ("raycast", "pyramid")]
    decoding = {"rvq, rate: numpy": 1.0, "rvq, rate: pocl, codes resident": 0.001,
                "rvq, rate: pocl, codes uploaded": 0.01, "zfp, rate": 0.02, "zfp, accuracy": 0.04}  # fmt: skip
    return {
        "size": 64, "seconds": 1.0, "load_before": None, "load_after": None, "quick": True,
        "missing": ["chest"], "failed": ["frames: no"], "peers": {"zfpy": "1.0", "pysz": "1.1"},
        "machine": {"processor": "some", "cores": 2, "commit": None},
        "rates": [
            _row("engine", "rvq", "rate", 0.45, 0.44, 45.0, 0.2),
            _row("engine", "rvq", "rate", 1.0, 0.99, 50.0, 0.1),
            _row("engine", "rvq", "psnr", 44.5, 0.4, 44.4, 0.3),
            _row("engine", "rvq", "bound", 0.04, 0.5, 45.0, 0.04),
            _row("engine", "rvq", "bound", 0.02, 0.7, 48.0, 0.021),
            _row("engine", "vq", "own rate", None, 1.0, 35.0, 0.5),
            _row("engine", "sz3", "bound", 0.04, 0.2, 40.0, 0.04),
            _row("engine", "sz3", "bound", 0.01, 0.8, 50.0, 0.01),
            _row("engine", "sz3", "bound", 0.001, 2.0, None, 0.0),
            _row("engine", "rvq", "rate", 8.0, 8.1, None, 0.0),
        ],
        "speed": [{"volume": "engine", "voxels": 10**7, "asked": {}, "training": {"rvq, rate": 20.0},
                   "encoding": {"rvq, rate": _time(0.5), "zfp, rate": _time(0.1)},
                   "decoding": {way: _time(seconds) for way, seconds in decoding.items()}}],
        "frames": [{"scene": "engine-smooth", "bits": 0.45, "same": True,
                    "store": {"bits": 0.44, "bits_all": 0.6, "psnr": 45.0, "largest": 0.1},
                    "ways": {"voxels": held, "upload": held, "resident": {**held, **_ratio(1.2)}}}],
        "crossover": [{"scene": "heptane", "times": dict.fromkeys(methods, _time(0.1)),
                       "samples": dict.fromkeys(methods, 5),
                       "faster": dict.fromkeys(("voxels", "resident"), _ratio(2.0))}],
        "budget": [{"scene": "crab", "ratio": 9.0, "memory": 2**20,
                    "ways": {"voxels": {**held, "delta_e": 2.2, "delta_e_largest": 43.0},
                             "rvq": {**held, "delta_e": 1.0, "delta_e_largest": 16.0}}}],
    }  # fmt: skip


def test_every_goal_is_judged_by_what_was_reached():
    met = [(verdict.reached, verdict.goal, verdict.is_met) for verdict in verdicts(_result())]
    assert met == [
        (45.0, 44.5, True), (0.44, 0.45, True), (44.4, 44.5, False), (0.4, 0.315, False),  # rate, then PSNR asked for
        (0.04, 0.04, True), (0.021, 0.02, False),  # bounds
        (10000.0, 4000.0, True), (pytest.approx(20.0), 20.0, True),  # decoding: resident codes over the faster zfp
        (20.0, 30.0, False),  # encoding
        (1.2, 1.1, False),  # frames
        (1.0, 1.09, True), (16.0, 15.0, False),  # budget
    ]  # fmt: skip


def test_rivals_are_told_at_the_same_error():
    by_psnr, _, by_error, worse = equal_rows(_result()["rates"])
    assert by_psnr["by"] == "PSNR" and by_error["by"] == worse["by"] == "largest error"
    assert by_psnr["rivals"]["sz3, bound"]["seconds"] == pytest.approx(0.4)  # half the way from 40 to 50 dB
    assert by_error["rivals"]["sz3, bound"]["seconds"] == pytest.approx(0.2)
    assert set(by_psnr["rivals"]) == {"sz3, bound"}


def test_everything_measured_is_shown():
    result = _result()
    assert rate(result["speed"][0], "encoding", "rvq, rate") == pytest.approx(20.0)
    json.dumps(result)
    for told in (show(result), markdown(result)):
        for words in ("zfpy 1.0", "engine", "heptane", "crab", "SZ3", "codes resident", "9 : 1", "20 ± 1% (20)"):
            assert words in told
    assert "no figure of it is a result" in show(result) and "frames: no" in show(result)
    assert markdown(result).count("(some, 2 cores)") == 7  # the processor with every table
    assert "are left out" in show({**result, "peers": {}})
    assert markdown_table(["a", "b"], [["1", "2"]]) == "| a | b |\n| --- | --- |\n| 1 | 2 |"


def test_curves_leave_out_what_an_axis_cannot_show():
    rows = [_row("engine", "sz3", "bound", bound, bits, psnr, largest) for bound, bits, psnr, largest in (
        (0.01, 2.0, 60.0, 0.01), (0.001, 3.0, None, 0.0), (0.04, 1.0, 40.0, 0.04))]  # fmt: skip
    assert curve_points(rows, "sz3, bound", "psnr", 1.0, False) == [(1.0, 40.0), (2.0, 60.0)]
    assert curve_points(rows, "sz3, bound", "largest", 100.0, True) == [(1.0, 4.0), (2.0, 1.0)]
    rows += [_row("engine", "rvq", "rate", 0.5, 0.5, 42.0, 0.1), _row("engine", "rvq", "psnr", 40.0, 0.4, 40.0, 0.1)]
    assert curve_points(rows, "rvq, rate", "psnr", 1.0, False) == [(0.4, 40.0), (0.5, 42.0)]


# All of it


@pytest.mark.slow
def test_a_quick_run_measures_shows_and_draws_without_peers(device, shared_volume, monkeypatch, tmp_path):
    for name in ("engine.nrrd", "chest.nrrd"):
        shared_volume(name)
    monkeypatch.setattr("bench.options.RESULTS", tmp_path)
    monkeypatch.setattr("bench.compression_rates.QUICK_EDGE", 32)
    monkeypatch.setattr(compression_peers, "environment", lambda say: None)
    options = Options(quick=True, scenes=("engine-smooth", "chest"))
    result = bench.run(options)
    json.dumps(result, allow_nan=False)
    assert not result["failed"] and not result["missing"]
    own = {ask.curve for ask in asks(ENGINE) if not ask.is_peer}
    for name in ("engine", "chest"):
        assert {row["curve"] for row in result["rates"] if row["volume"] == name} == own
    for row in result["rates"]:
        assert row["kind"] != "bound" or row["largest"] <= row["asked"]
    for row in result["speed"]:
        assert "rvq, rate" in row["encoding"] and "rvq, rate: numpy" in row["decoding"]
        assert any("codes resident" in way for way in row["decoding"])
    for row in result["frames"]:
        assert row["ways"]["upload"]["compression"]["codec"] == "rvq" and row["same"]
    assert "zfp and SZ3 are left out" in show(result)
    drawn = bench.draw(result, options)
    assert [path.name for path in drawn] == [
        "compression.md", "compression.png", "compression-crossover.png", "compression-engine.png",
        "compression-chest.png",
    ]  # fmt: skip
    for row in result["crossover"]:
        voxels, codes, dear = row["rows"]
        assert (voxels["held"], codes["repeats"], dear["repeats"]) == ("voxels", 0, 4) and voxels["cost"] == 1.0
        assert row["samples"]["voxels, pyramid"] == row["samples"]["resident, pyramid"]
    assert all(path.parent == options.folder and path.exists() for path in drawn)


# Pictures


def test_pictures_are_of_about_the_same_rate():
    rows = [_row("engine", "rvq", "rate", bits, bits, 40.0, 0.1) for bits in (0.2, 0.5, 1.0)]
    rows += [_row("engine", "sz3", "bound", 1 / bits, bits, 40.0, 0.1) for bits in (0.1, 0.6, 0.2)]
    rows.append(_row("engine", "vq", "own rate", None, 1.0, 35.0, 0.5))
    assert [(row["curve"], row["bits"]) for row in chosen(rows, 0.4)] == [
        ("vq", 1.0), ("rvq, rate", 0.5), ("sz3, bound", 0.6)
    ]  # fmt: skip
    assert [row["curve"] for row in chosen(rows[3:], 0.4)] == ["vq", "sz3, bound"]
    assert [shown_rate(scene.name) for scene in CODED_SCENES] == [0.45, 0.18, 1.0, 0.06]


def test_a_strip_and_a_chart_are_drawn_of_what_was_measured(tmp_path):
    rows = _result()["rates"]
    random = np.random.default_rng(2)
    for name in ("engine.npy", *(row["picture"] for row in rows)):
        np.save(tmp_path / name, random.random((64, 64, 4)).astype(np.float32))
    with Image.open(codec_strip("engine", rows, tmp_path, tmp_path / "strip.png")) as strip:
        assert strip.width > 3 * 200 and strip.height > 2 * 200
    assert (tmp_path / "strip.png").stat().st_size < 500_000
    with Image.open(rate_chart(_result(), tmp_path / "chart.png")) as chart:
        assert chart.width > 400
    assert all(0.0 < bound < 1.0 for bound in BOUNDS)
