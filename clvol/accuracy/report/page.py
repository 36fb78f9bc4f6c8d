"""index.html: the report as one page that needs nothing else.

Everything is there without scripts: plots, pictures, table. The script adds what a pointer at rest
shows, colours by other knobs, sorting, and pictures in turn at the same place.
"""

from __future__ import annotations

import json
import shlex
import statistics
from html import escape
from pathlib import Path
from typing import Any

from clvol.accuracy.difference import Scale
from clvol.accuracy.report import wording
from clvol.accuracy.report.images import PageImages, color_stops
from clvol.accuracy.report.svg import front_plot, knob_plot
from clvol.accuracy.report.sweep import Point, Sweep, median

_HERE = Path(__file__).resolve().parent
# The browser itself refuses whatever would come from elsewhere.
_POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'unsafe-inline'"


def page(sweep: Sweep, images: PageImages) -> str:
    """The whole page as HTML."""
    style = (_HERE / "page.css").read_text(encoding="utf-8")
    script = (_HERE / "page.js").read_text(encoding="utf-8")
    parts = [
        "<!DOCTYPE html>",
        '<html lang="en">',
        "<head>",
        '<meta charset="utf-8">',
        f'<meta http-equiv="Content-Security-Policy" content="{_POLICY}">',
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        '<meta name="color-scheme" content="light dark">',
        f"<title>{escape(sweep.name)}: what accuracy costs in time</title>",
        f"<style>\n{style}</style>",
        "</head>",
        "<body>",
        "<main>",
        _header(sweep),
        _headlines(sweep),
        _plot(sweep),
        _pictures(sweep, images),
        _knobs(sweep),
        _table(sweep),
        _method(sweep),
        "</main>",
        '<div id="tip" hidden></div>',
        _viewer(),
        f'<script type="application/json" id="data">{_data(sweep)}</script>',
        f"<script>\n{script}</script>",
        "</body>",
        "</html>",
    ]
    return "\n".join(part for part in parts if part) + "\n"


def _header(sweep: Sweep) -> str:
    scene, machine = sweep.result["scene"], sweep.result["machine"]
    facts = [
        f"{scene['width']} × {scene['height']} pixels",
        f"{machine['device_name']}, {machine['cores']} cores",
        _several(len(sweep.points), "setting"),
    ]
    items = "".join(f"<li>{escape(fact)}</li>" for fact in facts)
    return (
        '<header>\n<p class="kicker">What accuracy costs in time</p>\n'
        f"<h1>{escape(sweep.name)}</h1>\n"
        f'<ul class="facts">{items}</ul>\n</header>'
    )


def _headlines(sweep: Sweep) -> str:
    rows = []
    for sentence in sweep.result["sentences"]:
        point = sweep.point(sentence["point"])
        notes = []
        if "scene" not in str(sentence["text"]):  # it may say this itself
            notes.append(f"<span>{escape(_upper(sweep.against_baseline(point)))}</span>")
        options = _options(sweep, point)
        if options:
            notes.append(f"<code>{escape(options)}</code>")
        rows.append(
            f'<li data-id="{escape(str(point["id"]))}">'
            f'<p class="limit"><span>error below</span> {escape(_threshold(sentence["error"]))}</p>'
            f'<div><p class="sentence">{escape(str(sentence["text"]))}</p>'
            f'<p class="note">{"".join(notes)}</p></div>'
            f'<p class="cost">{escape(wording.seconds(sentence["seconds"], 2))}</p></li>'
        )
    inside = f'<ol class="headlines">{"".join(rows)}</ol>' if rows else (
        "<p>None of the settings reaches an error that could be stated.</p>"
    )
    return (f'<section aria-label="In short">\n{inside}\n<p class="own-scene">{_own(sweep)}</p>\n'
            "</section>")


def _own(sweep: Sweep) -> str:
    """What to think of the scene's own settings, HTML."""
    own = sweep.baseline
    parts = [
        f"Your scene as it is (<b>{escape(str(own['label']))}</b>) has an error of "
        f"{escape(wording.number(own['rmse'], 2))} and takes "
        f"{escape(wording.seconds(median(own), 2))}."
    ]
    better = sweep.better()
    if better is not None:
        parts.append(
            f"<b>{escape(str(better['label']))}</b> is faster and at least as exact: error "
            f"{escape(wording.number(better['rmse'], 2))} in "
            f"{escape(wording.seconds(median(better), 2))}."
        )
    elif len(sweep.points) > 1:
        parts.append("Nothing measured is as exact and faster beyond the spread of the times.")
    return " ".join(parts)


def _plot(sweep: Sweep) -> str:
    knob = sweep.color_knob()
    keys = []
    if knob is not None:
        for i, value in enumerate(sweep.values(knob["name"])):
            keys.append(f'<li><i class="key c{i}"></i>{escape(wording.setting(value))}</li>')
    name = escape(str(knob["title"])) if knob else ""
    choice = (
        f'<span id="color-name">{name}</span><select id="color" aria-label="colour by" hidden>'
        "</select>"
    )
    legend = (
        f'<div class="legend"><span class="legend-title">colour: {choice}</span>'
        f'<ul id="keys">{"".join(keys)}</ul>'
        '<ul><li><i class="key line"></i>nothing measured is faster and as exact</li>'
        '<li><i class="key own"></i>your scene</li>'
        '<li><i class="key bar"></i>fastest to slowest frame</li></ul></div>'
        if knob else ""
    )
    lost = sum(p["rmse"] is None or median(p) is None for p in sweep.points)
    note = (
        f'<p class="small-print">{_several(lost, "setting")} with no finite error or no time: only '
        "in the table.</p>" if lost else ""
    )
    return (
        '<section class="plot-section">\n<h2>Error against time</h2>\n'
        '<p class="lead">Each dot is one setting of the renderer. Left is faster, down is more '
        "exact; both axes are logarithmic.</p>\n"
        f'{legend}\n<div class="plot">\n{front_plot(sweep, 1100, 600, "wide")}\n'
        f'{front_plot(sweep, 400, 440, "narrow")}\n</div>\n{note}</section>'
    )


def _pictures(sweep: Sweep, images: PageImages) -> str:
    if not images.pictures:
        return ""
    front = {p["id"] for p in sweep.front}
    judged_by = wording.judged_by(sweep.result)
    cards = [
        '<figure class="card" data-id="reference">'
        f'{_image(images, "reference", f"The {judged_by}")}'
        f"{_scales(images)}<figcaption><b>The {judged_by}</b>"
        "<span>what the others are measured against</span></figcaption></figure>"
    ]
    for point in sweep.shown():
        key, label = point["id"], str(point["label"])
        if key not in images.pictures:
            continue
        note = ""
        if key == sweep.baseline["id"]:
            note = '<em class="badge">your scene</em>'
            if key not in front:
                note += '<em class="badge">not on the front</em>'
            note = f"<span>{note}</span>"
        scale = images.scales[key]
        cards.append(
            f'<figure class="card" data-id="{escape(str(key))}" id="at-{escape(str(key))}">'
            f"{_image(images, key, label)}"
            f'<div class="differences"><img class="shared" src="{images.shared[key]}" '
            f'width="{images.width}" height="{images.height}" '
            f'alt="difference of {escape(label)} from the {judged_by}, shared scale">'
            f'<img class="each" src="{images.own[key]}" width="{images.width}" '
            f'height="{images.height}" '
            f'alt="difference of {escape(label)} from the {judged_by}, scale of its own">'
            f'<span class="gain each">gain {escape(wording.number(scale.gain))}, last colour from '
            f"{escape(wording.number(scale.full))}</span></div>"
            f"<figcaption><b>{escape(label)}</b>{note}"
            f"<span>error {escape(wording.number(point['rmse']))}, largest "
            f"{escape(wording.number(point.get('max_abs'), 2))}</span>"
            f"<span>{escape(wording.seconds(median(point)))} a frame</span></figcaption></figure>"
        )
    return (
        "<section>\n<h2>What it looks like</h2>\n"
        '<p class="lead">The settings of the front, cheapest first; below each its difference from '
        f"the {judged_by}.</p>\n"
        '<input type="radio" name="scale" id="scale-shared" checked>'
        '<input type="radio" name="scale" id="scale-each">\n'
        '<p class="choice"><label for="scale-shared">One scale for all</label>'
        '<label for="scale-each">A scale for each</label>'
        '<span class="with-script" hidden>Click a picture to see it large, in turn with the exact '
        "one.</span></p>\n"
        f'<div class="cards">\n{"".join(cards)}\n</div>\n{_sizes(images)}</section>'
    )


def _image(images: PageImages, key: str, alt: str) -> str:
    return (
        f'<img class="picture" src="{images.pictures[key]}" width="{images.width}" '
        f'height="{images.height}" alt="{escape(alt)}">'
    )


def _scales(images: PageImages) -> str:
    """What the colours of the differences mean, in the place of the reference's own difference."""
    if images.shared_scale is None:
        return ""
    ratio = f"aspect-ratio:{images.width}/{images.height}"
    return (
        f'<div class="scales" style="{ratio}"><div class="shared">{_bar(images.shared_scale)}'
        "<p>Logarithmic; the same colour is the same error in every picture.</p></div>"
        f'<div class="each">{_bar(None)}'
        "<p>Linear; the gain stands in each picture. At most one pixel in a thousand exceeds it."
        "</p></div><p>A pixel shows the largest of its differences in R, G, B, A, linear light.</p>"
        "</div>"
    )


def _bar(scale: Scale | None) -> str:
    gradient = f"background:linear-gradient(to right,{','.join(color_stops())})"
    if scale is None:
        ticks = ["0", "1 / gain"]
    else:
        values = scale.ticks()
        every = max(1, -(-(len(values) - 1) // 3))  # few enough for a narrow picture
        kept = values[::-1][::every][::-1]
        kept = kept if kept[0] == values[0] else [values[0], *kept[1:]]
        ticks = [wording.number(v, 1) if v >= 1e-2 else wording.power_of_ten(_exponent(v))
                 for v in kept]
        shares = scale.share(kept)
        inside = "".join(
            f'<span style="left:{100 * s:.1f}%" class="{_align(s)}">{escape(t)}</span>'
            for s, t in zip(shares, ticks)
        )
        return f'<div class="bar" style="{gradient}"></div><div class="bar-ticks">{inside}</div>'
    inside = (f'<span class="first" style="left:0%">{ticks[0]}</span>'
              f'<span class="last" style="left:100%">{ticks[1]}</span>')
    return f'<div class="bar" style="{gradient}"></div><div class="bar-ticks">{inside}</div>'


def _align(share: float) -> str:
    return "first" if share < 0.01 else "last" if share > 0.99 else "mid"


def _exponent(value: float) -> int:
    return int(f"{value:e}".split("e")[1])


def _sizes(images: PageImages) -> str:
    if images.width == images.full_width:
        return ""
    return (
        f'<p class="small-print">Shown at {images.width} pixels\' width, averaged down from '
        f"{images.full_width}; the folder <code>images</code> beside this page has them in full. "
        "Errors are of the full size.</p>\n"
    )


def _knobs(sweep: Sweep) -> str:
    parts = []
    for knob in sweep.knobs:
        points = sweep.alone(knob["name"])
        if len(points) < 2:
            continue
        rows = "".join(
            f'<tr data-id="{escape(str(p["id"]))}"'
            f'{_own_class(p, sweep)}><th scope="row">'
            f"{escape(wording.setting(p['settings'].get(knob['name'])))}</th>"
            f"<td>{escape(wording.number(p['rmse'], 2))}</td>"
            f"<td>{escape(wording.seconds(median(p), 2))}</td></tr>"
            for p in points
        )
        unit = f" ({escape(str(knob['unit']))})" if knob.get("unit") else ""
        about = f"<p>{escape(_upper(str(knob.get('about') or '')))}</p>"
        parts.append(
            f'<article><h3>{escape(_upper(str(knob["title"])))}<small>{unit}</small></h3>{about}'
            f'{knob_plot(sweep, knob)}<table class="values"><thead><tr><th scope="col">'
            f'{escape(str(knob["title"]))}</th><th scope="col">error</th><th scope="col">time</th>'
            f"</tr></thead><tbody>{rows}</tbody></table></article>"
        )
    if not parts:
        return ""
    return (
        "<section>\n<h2>One knob at a time</h2>\n"
        '<p class="lead">All else as in your scene, which is ringed. The axes are those of the '
        "plot above, so a knob that moves nothing here changes nothing.</p>\n"
        f'<div class="knobs">\n{"".join(parts)}\n</div>\n</section>'
    )


_COLUMNS = (  # title, explanation, where it is, how it is written
    ("RMSE", "root mean square of the difference, linear RGBA", "rmse", wording.number),
    ("max", "largest difference of a channel, linear RGBA", "max_abs", wording.number),
    ("PSNR, dB", "peak signal-to-noise ratio, as displayed", "psnr", None),
    ("SSIM", "mean structural similarity, as displayed", "ssim", None),
    ("ΔE mean", "CIEDE2000, as displayed", "delta_e_mean", wording.number),
    ("ΔE max", "CIEDE2000, as displayed", "delta_e_max", wording.number),
    ("time", "median of the frames", "seconds.median", wording.seconds),
    ("spread", "interquartile range over median", "seconds.spread", wording.percent),
    ("samples", "reconstructions of the volume", "samples", wording.count),
    ("prepare", "before the first frame, once", "prepare_seconds", wording.seconds),
    ("memory", "on the device", "device_bytes", wording.size_of),
)


def _table(sweep: Sweep) -> str:
    head = '<th scope="col" data-kind="text">setting</th>' + "".join(
        f'<th scope="col" title="{escape(about)}">{escape(title)}</th>'
        for title, about, _, _ in _COLUMNS
    )
    count = len(sweep.points)
    title = f"All {count} settings" if count > 1 else "The setting"
    front = set(sweep.result["front"])
    rows = []
    for point in sorted(sweep.points, key=lambda p: median(p) or 0.0):
        marks = [m for m, on in (("front", point["id"] in front),
                                 ("baseline", point["id"] == sweep.baseline["id"])) if on]
        note = '<em class="badge">your scene</em>' if "baseline" in marks else ""
        cells = [f'<th scope="row">{escape(str(point["label"]))}{note}</th>']
        for _, _, path, write in _COLUMNS:
            value = _look_up(point, path)
            text = _quality(point, path, value, front) if write is None else write(value)
            order = value if value is not None else ("inf" if text == "∞" else "")
            cells.append(f'<td data-v="{order}">{escape(text)}</td>')
        rows.append(f'<tr data-id="{escape(str(point["id"]))}" class="{" ".join(marks)}">'
                    f'{"".join(cells)}</tr>')
    return (
        f"<section>\n<h2>{title}</h2>\n"
        '<p class="lead">Fastest first. <span class="with-script" hidden>Click a heading to sort. '
        '</span>Those of the front are bold.</p>\n'
        '<div class="scroll"><table id="all" class="values"><thead><tr>'
        f'{head}</tr></thead><tbody>\n{chr(10).join(rows)}\n</tbody></table></div>\n</section>'
    )


def _quality(point: Point, path: str, value: float | None, front: set[str]) -> str:
    if value is None:
        exact = point["rmse"] == 0 or point["id"] in front
        return "∞" if path == "psnr" and exact else wording.NOTHING
    return f"{value:.1f}" if path == "psnr" else f"{value:.5f}"


def _look_up(point: Point, path: str) -> Any:
    for key in path.split("."):
        point = point.get(key) if isinstance(point, dict) else None
    return point


def _method(sweep: Sweep) -> str:
    result = sweep.result
    scene, machine = result["scene"], result["machine"]
    method, reference = result["method"], result["reference"]
    spreads = [p["seconds"]["spread"] for p in sweep.points
               if p["seconds"].get("spread") is not None]
    judged_by = wording.judged_by(sweep.result)
    failed = reference.get("failed_rays") or 0
    rounds = method.get("rounds")
    frames = _several(method["frames"], "frame") + " a setting"
    if isinstance(rounds, int):
        frames += f", in {_several(rounds, 'round')}"
    rows = [
        ("Error", f"RMSE: root of the mean squared difference from the {judged_by}, over all "
                  "pixels and R, G, B, A, in linear light, premultiplied. PSNR, SSIM and CIEDE2000 "
                  "(ΔE): of the displayed picture."),
        (judged_by.capitalize(), _judge(reference, failed)),
        ("Time", f"{method['clock']}; median of {frames}"),
    ]
    if spreads:
        rows.append(("Spread of times", f"interquartile range over median: "
                     f"{wording.percent(statistics.median(spreads))} at a typical setting, "
                     f"{wording.percent(max(spreads))} at the worst. Times closer than that are "
                     "not told apart."))
    rows += [
        ("Device", f"{machine['device_name']} ({', '.join(map(str, machine['devices']))}), "
                   f"{machine['cores']} cores, clvol {machine['clvol']}"),
        ("Picture", f"{scene['width']} × {scene['height']} pixels"),
        ("Not on the front", "the settings for which some other one is at least as fast and at "
                             "least as exact"),
    ]
    items = "".join(f"<dt>{escape(name)}</dt><dd>{escape(text)}</dd>" for name, text in rows)
    warning = _warning(sweep, failed)
    source = ""
    if scene.get("source"):
        source = (f"<details><summary>The scene</summary><pre>{escape(str(scene['source']))}</pre>"
                  "</details>")
    return f"<section>\n<h2>How it was measured</h2>\n{warning}<dl>{items}</dl>\n{source}</section>"


def _judge(reference: dict, failed: int) -> str:
    """How what pictures were judged by was found."""
    estimate = wording.number(reference.get("error_estimate"), 2)
    if reference.get("step"):
        return (f"effects have no exact integral: the ray caster's own picture at a step of "
                f"{wording.number(reference['step'])} voxel edges, which differs from that at twice the "
                f"step by {estimate}")
    return (f"adaptive quadrature in double precision, tolerance "
            f"{wording.number(reference['tolerance'])}, estimated error {estimate}, "
            f"{wording.seconds(reference.get('seconds'))}; rays that missed the tolerance: {failed}")


def _warning(sweep: Sweep, failed: int) -> str:
    """Where the reference is not good enough to judge by."""
    estimate = sweep.result["reference"].get("error_estimate")
    errors = [p["rmse"] for p in sweep.front if p["rmse"]]
    told = []
    if failed:
        told.append(f"{_several(failed, 'ray')} of the exact integral missed the tolerance.")
    if estimate and errors and min(errors) < 10 * estimate:
        told.append(f"The smallest errors are near the {wording.judged_by(sweep.result)}'s own error: take them as "
                    "upper bounds.")
    return f'<p class="warning">{escape(" ".join(told))}</p>\n' if told else ""


def _viewer() -> str:
    return (
        '<dialog id="viewer"><div class="viewer-bar"><p id="viewer-name"></p>'
        '<div id="viewer-what"></div><button type="button" id="viewer-close" '
        'aria-label="close">×</button></div><img id="viewer-image" alt="">'
        '<p id="viewer-help">Space: in turn with the exact one. \N{LEFTWARDS ARROW} '
        "\N{RIGHTWARDS ARROW}: the other settings.</p></dialog>"
    )


def _data(sweep: Sweep) -> str:
    """What the script needs, as JSON that cannot end the element it stands in."""
    baseline = sweep.baseline["settings"]
    points = {
        str(p["id"]): {
            "label": p["label"], "error": wording.number(p["rmse"]),
            "time": wording.seconds(median(p)),
            "frames": _several(p["seconds"]["frames"], "frame"),
            "range": f"{wording.seconds(p['seconds'].get('min'))} to "
                     f"{wording.seconds(p['seconds'].get('max'))}",
            "settings": [
                [k["title"], wording.setting(p["settings"].get(k["name"])),
                 p["settings"].get(k["name"]) != baseline.get(k["name"])]
                for k in sweep.knobs
            ],
            "against": sweep.against_baseline(p),
        }
        for p in sweep.points
    }
    knobs = []
    for knob in sweep.varied():
        values = sweep.values(knob["name"])
        ordered = all(isinstance(v, (int, float)) and not isinstance(v, bool) for v in values)
        knobs.append({
            "title": knob["title"], "ordered": ordered and len(values) > 2,
            "values": [wording.setting(v) for v in values],
            "of": {str(p["id"]): sweep.color_class(p, knob) for p in sweep.points},
        })
    chosen = sweep.color_knob()
    first = next((i for i, k in enumerate(sweep.varied()) if k is chosen), 0)
    text = json.dumps({"points": points, "knobs": knobs, "color": first}, ensure_ascii=False)
    return text.replace("&", "\\u0026").replace("<", "\\u003c").replace(">", "\\u003e")


def _options(sweep: Sweep, point: Point) -> str:
    return " ".join(f"--set {shlex.quote(option)}" for option in sweep.options(point))


def _own_class(point: Point, sweep: Sweep) -> str:
    return ' class="baseline"' if point["id"] == sweep.baseline["id"] else ""


def _threshold(value: float) -> str:
    exponent = _exponent(value)
    return f"{value:g}" if value >= 9.9e-5 else (
        wording.power_of_ten(exponent) if abs(value / 10.0**exponent - 1) < 1e-9
        else wording.number(value)
    )


def _several(n: int, noun: str) -> str:
    return f"{n} {noun}" if n == 1 else f"{n} {noun}s"


def _upper(text: str) -> str:
    return text[:1].upper() + text[1:]
