"""The report of a sweep: complete, self-contained, and never in the way of odd results."""

from __future__ import annotations

import copy
import json
import math
import re
from html import unescape
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from clvol.accuracy.metrics import compare
from clvol.accuracy.report import label_layout, wording, write_report
from clvol.accuracy.report.svg import text_width
from clvol.accuracy.report.sweep import Sweep
from clvol.errors import RenderError, UsageError

STEPS = [4.0, 2.0, 1.0, 0.5]
VOID = {"meta", "img", "input", "link", "br", "hr"}


def image(error: float, size: tuple[int, int] = (24, 32)) -> np.ndarray:
    """A blob whose brightness is off by about ``error``."""
    y, x = np.mgrid[-1:1:size[0] * 1j, -1:1:size[1] * 1j]
    alpha = np.exp(-3 * (x * x + y * y)) * (1 + error * np.sin(9 * x))
    return (alpha[..., None] * [0.9, 0.6, 0.3, 1.0]).astype(np.float32)


def point(key: str, label: str, settings: dict, seconds: float, rgba: np.ndarray) -> dict:
    return {
        "id": key, "label": label, "settings": settings, "changed": [],
        **compare(rgba, image(0.0, rgba.shape[:2])),
        "seconds": {"median": seconds, "min": 0.9 * seconds, "max": 1.3 * seconds, "spread": 0.05,
                    "frames": 5},
        "samples": 12345, "rays": 768, "prepare_seconds": 0.0, "device_bytes": 1 << 24,
        "on_front": False, "sweep": None,
    }


def finished(points: list[dict], pictures: dict, knobs: list[dict], baseline: str) -> tuple:
    """The front, the sentences and all the rest."""
    own = next(p for p in points if p["id"] == baseline)
    best, front = math.inf, []
    for p in sorted(points, key=lambda p: (p["seconds"]["median"], p["rmse"])):
        p["changed"] = [k for k, v in p["settings"].items() if v != own["settings"][k]]
        if p["rmse"] < best:
            best = p["rmse"]
            p["on_front"] = True
            front.append(p)
    sentences = []
    for error in (1e-1, 1e-2, 1e-3, 1e-4):
        p = next((p for p in front if p["rmse"] <= error), None)
        if p is not None:
            took = p["seconds"]["median"]
            text = f"for error below {error:g}, use {p['label']}: {took:.3g} s"
            sentences.append({"error": error, "point": p["id"], "seconds": took, "text": text})
    result = {
        "version": 1,
        "scene": {"name": "blob", "width": 32, "height": 24, "source": "version = 1\n"},
        "machine": {"devices": ["pocl"], "device_name": "some CPU", "cores": 2, "clvol": "0.1"},
        "reference": {"tolerance": 1e-9, "seconds": 3.2, "error_estimate": 1e-10, "failed_rays": 0},
        "method": {"frames": 5, "rounds": 3, "clock": "render seconds"},
        "knobs": knobs, "baseline": baseline, "points": points, "front": [p["id"] for p in front],
        "sentences": sentences,
    }
    kept = {p["id"] for p in front} | {baseline}
    kept_pictures = {key: rgba for key, rgba in pictures.items() if key in kept}
    return result, {**kept_pictures, "reference": image(0.0)}


def sweep() -> tuple[dict, dict]:
    """Steps by classifications; "post" is the better one."""
    knobs = [
        {"name": "integration.step", "title": "step", "unit": "voxel edges", "values": STEPS,
         "scene_value": 1.0, "about": "distance between samples"},
        {"name": "integration.classification", "title": "classification", "unit": "",
         "values": ["pre", "post"], "scene_value": "pre", "about": "where colour comes from"},
    ]
    points, pictures = [], {}
    for name, factor in (("pre", 1.0), ("post", 0.1)):
        for step in STEPS:
            key = f"p{len(points)}"
            pictures[key] = image(0.05 * factor * step * step)
            settings = {"integration.step": step, "integration.classification": name}
            p = point(key, f"{name}, step {step:g}", settings, 0.01 / step, pictures[key])
            p["sweep"] = "integration.step" if name == "pre" and step != 1.0 else (
                "integration.classification" if step == 1.0 and name != "pre" else None)
            points.append(p)
    return finished(points, pictures, knobs, "p2")


def one_point() -> tuple[dict, dict]:
    result, pictures = sweep()
    only = {**result["points"][2], "on_front": True}
    result |= {"points": [only], "front": ["p2"], "sentences": []}
    result["knobs"] = [{**k, "values": [k["scene_value"]]} for k in result["knobs"]]
    return result, {"reference": pictures["reference"], "p2": image(0.05)}


def equal_errors() -> tuple[dict, dict]:
    result, pictures = sweep()
    for p in result["points"]:
        p.update(rmse=0.01, max_abs=0.02)
    return result, pictures


def exact() -> tuple[dict, dict]:
    """One point has no error at all."""
    result, pictures = sweep()
    last = result["points"][-1]
    last.update(rmse=0.0, max_abs=0.0, psnr=None, ssim=1.0, delta_e_mean=0.0, delta_e_max=0.0)
    return result, {**pictures, last["id"]: pictures["reference"]}


def all_exact() -> tuple[dict, dict]:
    result, pictures = sweep()
    for p in result["points"]:
        p.update(rmse=0.0, max_abs=0.0, psnr=math.inf)
    return result, {key: pictures["reference"] for key in pictures}


def nothing_finite() -> tuple[dict, dict]:
    result, pictures = sweep()
    for p in result["points"]:
        p.update(rmse=math.nan, max_abs=math.inf, psnr=math.nan, ssim=math.nan,
                 delta_e_mean=math.nan, delta_e_max=math.nan)
    broken = np.full_like(pictures["reference"], np.nan)
    return {**result, "sentences": []}, {**dict.fromkeys(pictures, broken), "reference": broken}


def missing_measures() -> tuple[dict, dict]:
    result, pictures = sweep()
    for p in result["points"]:
        if not p["on_front"]:
            p.update(psnr=None, ssim=None, delta_e_mean=None, delta_e_max=None)
    result["points"][0]["seconds"].update(median=0.0, min=0.0)
    return result, pictures


def front_of_one() -> tuple[dict, dict]:
    result, pictures = sweep()
    result["front"] = result["front"][-1:]
    result["sentences"] = result["sentences"][-1:]
    return result, pictures


def many_points() -> tuple[dict, dict]:
    rng = np.random.default_rng(1)
    base, _ = sweep()
    points, pictures = [], {}
    values = [float(v) for v in np.geomspace(4, 0.01, 200)]
    for i, step in enumerate(values):
        settings = {"integration.step": step, "integration.classification": "pre"}
        pictures[f"p{i}"] = image(0.02 * step)
        p = point(f"p{i}", f"a rather long name, step {step:.4g}, and so on and on and on",
                  settings, 0.01 / step * float(rng.uniform(1, 2)), pictures[f"p{i}"])
        points.append({**p, "sweep": "integration.step"})
    knobs = [{**base["knobs"][0], "values": values}, base["knobs"][1]]
    return finished(points, pictures, knobs, "p50")


def no_pictures() -> tuple[dict, dict]:
    return sweep()[0], {}


NASTY = """<script>alert(1)</script>&amp;"'</title></svg> $x_1$ $\\frac{ _a 你好"""


def nasty_names() -> tuple[dict, dict]:
    """Names that HTML, SVG, JSON in a script, matplotlib or a file name could trip over."""
    result, pictures = sweep()
    for i, p in enumerate(result["points"]):
        p["label"] = f"{NASTY} {i}"
        p["settings"]["integration.classification"] += NASTY
    result["scene"].update(name=NASTY, source=NASTY + "\n" * 3)
    result["machine"].update(device_name=NASTY, devices=[NASTY])
    result["method"]["clock"] = NASTY
    for knob in result["knobs"]:
        knob.update(title=NASTY, unit=NASTY, about=NASTY)
    for sentence in result["sentences"]:
        sentence["text"] = NASTY + sentence["text"]
    text = json.dumps(result)
    for key in [p["id"] for p in result["points"]]:
        text = text.replace(f'"{key}"', json.dumps(f"../{key}<&'\"/ b"))
    return json.loads(text), {
        key if key == "reference" else f"../{key}<&'\"/ b": rgba for key, rgba in pictures.items()
    }


CASES = [sweep, one_point, equal_errors, exact, all_exact, nothing_finite, missing_measures,
         front_of_one, many_points, no_pictures, nasty_names]


class Reader(HTMLParser):
    """Elements in order, with the check that each one is closed where it must be."""

    def __init__(self, text: str):
        super().__init__(convert_charrefs=True)
        self.stack: list[str] = []
        self.elements: list[tuple[str, dict]] = []
        self.text: list[str] = []
        self.scripts: list[str] = []
        self.feed(text)
        self.close()
        assert self.stack == []

    def handle_starttag(self, tag, attributes):
        names = [name for name, _ in attributes]
        assert len(names) == len(set(names)), f"an attribute twice in {tag}: {names}"
        self.elements.append((tag, dict(attributes)))
        if tag not in VOID:
            self.stack.append(tag)

    def handle_startendtag(self, tag, attributes):
        self.elements.append((tag, dict(attributes)))

    def handle_endtag(self, tag):
        assert self.stack and self.stack[-1] == tag, f"</{tag}> inside {self.stack}"
        self.stack.pop()

    def handle_data(self, data):
        code = self.stack and self.stack[-1] in ("script", "style")
        (self.scripts if code else self.text).append(data)

    def having(self, tag: str, name: str) -> list[dict]:
        return [a for t, a in self.elements if t == tag and name in (a.get("class") or "").split()]


@pytest.fixture(scope="module", params=CASES, ids=lambda case: case.__name__)
def report(request, tmp_path_factory):
    """(result, folder, files) of each case; nothing handed over may be changed by it."""
    result, pictures = request.param()
    before = copy.deepcopy(result)
    folder = tmp_path_factory.mktemp("report") / "new" / "folder"
    files = write_report(result, pictures, folder)
    assert repr(result) == repr(before)
    return result, folder, files


def page_of(folder: Path) -> str:
    return (folder / "index.html").read_text(encoding="utf-8")


def test_the_files_are_those_told_and_none_else(report):
    _, folder, files = report
    assert sorted(files) == sorted(p for p in folder.rglob("*") if p.is_file())
    assert {"index.html", "tradeoff.json", "tradeoff.png"} <= {p.name for p in files}


def test_the_page_is_well_formed(report):
    Reader(page_of(report[1]))


def test_the_page_needs_nothing_else(report):
    text = page_of(report[1])
    assert not re.search(r"https?:", text) and "@import" not in text and "url(" not in text
    reader = Reader(text)
    assert not [t for t, _ in reader.elements if t in ("link", "iframe", "object", "embed", "base")]
    for tag, attributes in reader.elements:
        for name in ("src", "href", "srcset", "data", "action", "poster", "xlink:href"):
            value = attributes.get(name)
            assert value is None or value.startswith(("data:image/png;base64,", "#")), (tag, name)
    policy = [a for t, a in reader.elements if t == "meta" and "http-equiv" in a]
    assert "default-src 'none'" in policy[0]["content"]


def test_nothing_from_the_result_becomes_markup(report):
    reader = Reader(page_of(report[1]))
    assert len([t for t, _ in reader.elements if t == "script"]) == 2
    assert not [a for _, a in reader.elements for name in a if name.startswith("on")]
    data = next(s for s in reader.scripts if s.lstrip().startswith('{"points"'))
    assert "<" not in data
    assert set(json.loads(data)["points"]) == {p["id"] for p in report[0]["points"]}


def test_the_page_says_each_sentence_and_names_each_point(report):
    result, folder, _ = report
    reader = Reader(page_of(folder))
    said = "".join(reader.text)
    for sentence in result["sentences"]:
        assert sentence["text"] in said
    for p in result["points"]:
        assert p["label"] in said
    names = {a["data-id"] for a in reader.having("circle", "on-front")}
    assert names == {k for k in result["front"] if _plottable(result, k)}


def _plottable(result: dict, key: str) -> bool:
    p = next(p for p in result["points"] if p["id"] == key)
    return p["rmse"] is not None and math.isfinite(p["rmse"]) and p["seconds"]["median"] > 0


def test_every_finite_coordinate_lies_in_its_plot(report):
    text = page_of(report[1])
    assert not re.search(r'(?:x|y|x1|x2|y1|y2|cx|cy|points)="[^"]*(?:nan|inf)', text)
    for svg in re.findall(r"<svg.*?</svg>", text, re.S):
        width, height = map(float, re.search(r'viewBox="0 0 ([\d.]+) ([\d.]+)"', svg).groups())
        for x, y in re.findall(r'<circle[^>]* cx="([-\d.]+)" cy="([-\d.]+)"', svg):
            assert 0 <= float(x) <= width and 0 <= float(y) <= height


def test_the_names_in_a_plot_do_not_overlap(report):
    for svg in re.findall(r"<svg.*?</svg>", page_of(report[1]), re.S):
        boxes = []
        found = re.findall(r'<text class="name([^"]*)" x="([\d.]+)" y="([\d.]+)">(.*?)</text>', svg)
        for mark, x, y, text in found:
            width = text_width(unescape(text), 11 if "small" in mark else 12)
            x = float(x) - width * {"start": 0, "middle": 0.5, "end": 1}[mark.split()[-1]]
            boxes.append((x, float(y) - 10, x + width, float(y)))
        for i, a in enumerate(boxes):
            for b in boxes[:i]:
                assert a[0] >= b[2] or b[0] >= a[2] or a[1] >= b[3] or b[1] >= a[3], found


def test_the_json_is_the_result_with_null_for_what_is_not_finite(report):
    result, folder, _ = report
    told = json.loads((folder / "tradeoff.json").read_text(encoding="utf-8"),
                      parse_constant=pytest.fail)

    def same(a, b):
        if isinstance(b, dict):
            return set(a) == set(b) and all(same(a[k], b[k]) for k in b)
        if isinstance(b, list):
            return len(a) == len(b) and all(map(same, a, b))
        return a is None if isinstance(b, float) and not math.isfinite(b) else a == b

    assert same(told, result)


def test_the_pictures_are_pictures(report):
    from PIL import Image

    _, folder, files = report
    for path in files:
        if path.suffix == ".png":
            with Image.open(path) as opened:
                opened.load()
                assert opened.format == "PNG"
    with Image.open(folder / "tradeoff.png") as chart:
        pixels = np.asarray(chart.convert("L"))
    assert pixels.shape[1] >= 1400
    assert (pixels < 128).mean() > 0.002 and (pixels > 240).mean() > 0.7


def test_the_page_stays_small(report):
    assert (report[1] / "index.html").stat().st_size < 6e6


def test_each_front_point_is_shown_beside_its_difference(tmp_path):
    result, pictures = sweep()
    write_report(result, pictures, tmp_path)
    reader = Reader(page_of(tmp_path))
    cards = [a["data-id"] for a in reader.having("figure", "card")]
    assert cards == ["reference", "p2", *result["front"]], "the scene's own is not on the front"
    wide = re.search(r'<svg class="wide".*?</svg>', page_of(tmp_path), re.S).group()
    names = re.findall(r'<text class="name[^>]*>([^<]*)<', wide)
    front = {p["label"] for p in result["points"] if p["on_front"]}
    assert set(names) == front | {"pre, step 1 (your scene)"}
    for mark in ("shared", "each"):
        assert len(reader.having("img", mark)) == len(result["front"]) + 1
    names = {p.name for p in (tmp_path / "images").iterdir()}
    for key in ["p2", *result["front"]]:
        assert {f"{key}.png", f"{key}-difference.png"} <= names


def test_large_pictures_are_made_smaller_and_the_page_says_so(tmp_path):
    from PIL import Image

    result, _ = sweep()
    noise = np.random.default_rng(3).random((300, 1000, 4)).astype(np.float32)
    pictures = dict.fromkeys(["reference", "p2", *result["front"]], noise)
    write_report(result, pictures, tmp_path)
    text = page_of(tmp_path)
    widths = {int(w) for w in re.findall(r'<img class="picture"[^>]* width="(\d+)"', text)}
    assert len(widths) == 1 and widths.pop() <= 640
    assert "averaged down from 1000" in text and len(text) < 6e6
    with Image.open(tmp_path / "images" / "reference.png") as kept:
        assert kept.size == (1000, 300)


def test_the_background_shows_behind_the_pictures(tmp_path):
    from PIL import Image

    result, pictures = sweep()
    result["scene"]["background"] = [0.0, 0.0, 1.0]
    write_report(result, pictures, tmp_path)
    with Image.open(tmp_path / "images" / "reference.png") as shown:
        assert shown.getpixel((0, 0))[2] > 200


def test_what_the_scene_could_do_better_is_told(tmp_path):
    result, pictures = sweep()
    better = Sweep(result).better()
    assert better is not None and better["rmse"] <= result["points"][2]["rmse"]
    write_report(result, pictures, tmp_path)
    said = "".join(Reader(page_of(tmp_path)).text)
    assert f"{better['label']} is faster and at least as exact" in said


def test_times_within_the_spread_are_not_told_apart():
    result, _ = sweep()
    own, other = result["points"][2], result["points"][3]
    other["seconds"].update(median=own["seconds"]["median"] * 0.98, spread=0.05)
    assert "within the spread" in Sweep(result).against_baseline(other)
    other["seconds"].update(median=own["seconds"]["median"] / 2)
    assert Sweep(result).against_baseline(other).startswith("2 times as fast")


def test_a_setting_can_be_copied_to_the_command_line(tmp_path):
    result, pictures = sweep()
    write_report(result, pictures, tmp_path)
    options = [t for t in Reader(page_of(tmp_path)).text if t.startswith("--set")]
    assert any("""--set 'integration.classification="post"'""" in o for o in options)


def test_a_poor_reference_is_owned_up_to(tmp_path):
    result, pictures = sweep()
    least = min(p["rmse"] for p in result["points"])
    result["reference"].update(error_estimate=least, failed_rays=3)
    write_report(result, pictures, tmp_path)
    said = "".join(Reader(page_of(tmp_path)).text)
    assert "3 rays of the exact integral missed" in said and "upper bounds" in said


def test_a_second_report_takes_the_first_one_s_place(tmp_path):
    result, pictures = sweep()
    first = write_report(result, pictures, tmp_path)
    result["scene"]["name"] = "renamed"
    assert write_report(result, pictures, tmp_path) == first
    assert "<h1>renamed</h1>" in page_of(tmp_path)


def test_a_file_in_the_folder_s_place_is_refused(tmp_path):
    (tmp_path / "taken").write_text("mine")
    for folder in (tmp_path / "taken", tmp_path / "taken" / "below"):
        with pytest.raises(UsageError, match="taken"):
            write_report(*sweep(), folder)
    assert [p.name for p in tmp_path.iterdir()] == ["taken"]


def test_a_failure_leaves_nothing_behind(tmp_path, monkeypatch):
    def full(self, data):
        if len(list(tmp_path.rglob("*.part*"))) > 3:
            raise OSError(28, "No space left on device")
        return len(data)

    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(RenderError, match="No space left"):
        write_report(*sweep(), tmp_path / "new")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.0041, "4.1 ms"), (0.9999, "1 s"), (0.99949, "999 ms"), (3e-6, "3 µs"), (12.345, "12.3 s"),
     (1234.0, "20.6 min"), (1e5, "27.8 h"), (0.0, "0 s"), (None, "–")],
)
def test_seconds_have_the_unit_that_suits_them(value, text):
    assert wording.seconds(value).replace("\N{NO-BREAK SPACE}", " ") == text


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.00152610, "0.00153"), (2.83e-5, "2.83 × 10⁻⁵"), (1e-9, "10⁻⁹"), (0, "0"),
     (123456, "123000"), (9.996, "10"), (-3e-7, "-3 × 10⁻⁷"), (None, "–")],
)
def test_numbers_are_short(value, text):
    assert wording.number(value).replace("\N{NO-BREAK SPACE}", " ") == text


@pytest.mark.parametrize("low", [1e-12, 3e-5, 0.02, 0.9, 70.0])
@pytest.mark.parametrize("ratio", [1.2, 3.0, 30.0, 1e3, 1e9])
def test_an_axis_has_a_few_numbers_within_it(low, ratio):
    ends = label_layout.limits([low, low * ratio])
    axis = label_layout.LogAxis(*ends, 0.0, 100.0)
    ticks = axis.ticks(9)
    assert 2 <= len(ticks) <= 9 and all(0 <= axis.place(t) <= 100 for t in ticks)
    assert ticks == sorted(ticks)


def test_labels_keep_clear_of_each_other_and_of_the_points():
    rng = np.random.default_rng(5)
    places = [(float(x), float(y)) for x, y in rng.uniform(60, 540, (25, 2))]
    labels = [label_layout.Label(str(i), "", x, y, 70, 14) for i, (x, y) in enumerate(places)]
    frame = (0.0, 0.0, 600.0, 600.0)
    placed = label_layout.place_labels(labels, frame, [(x, y, 5) for x, y in places])
    assert len(placed) > 20
    boxes = []
    for p in placed:
        left = p.x - 70 * {"start": 0, "middle": 0.5, "end": 1}[p.anchor]
        boxes.append((left, p.y - 7, left + 70, p.y + 7))
    for i, (left, top, right, bottom) in enumerate(boxes):
        assert left >= 0 and top >= 0 and right <= 600 and bottom <= 600
        assert not any(left < x < right and top < y < bottom for x, y in places)
        for b in boxes[:i]:
            assert left >= b[2] or b[0] >= right or top >= b[3] or b[1] >= bottom
