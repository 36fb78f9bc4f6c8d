"""index.html: the report as one self-contained page.

Plots, pictures and tables do not need scripts. The script adds tooltips, colours by other tunables, sorting, and
a viewer that switches between pictures in place.
"""

from __future__ import annotations

import json
import shlex
from html import escape
from pathlib import Path

from clvol.accuracy.report import wording
from clvol.accuracy.report.images import PageImages
from clvol.accuracy.report.method import method
from clvol.accuracy.report.pictures import pictures
from clvol.accuracy.report.svg import front_plot
from clvol.accuracy.report.sweep import Point, Sweep, median
from clvol.accuracy.report.tables import all_settings, tunables_alone

_HERE = Path(__file__).resolve().parent
# The browser refuses to load anything from outside the page.
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
        pictures(sweep, images),
        tunables_alone(sweep),
        all_settings(sweep),
        method(sweep),
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
        wording.several(len(sweep.points), "setting"),
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
        if "scene" not in str(sentence["text"]):  # the sentence may mention the scene already
            notes.append(f"<span>{escape(wording.upper(sweep.against_baseline(point)))}</span>")
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
        "<p>No setting reaches any of the listed errors.</p>"
    )
    return (f'<section aria-label="In short">\n{inside}\n<p class="own-scene">{_own(sweep)}</p>\n'
            "</section>")


def _own(sweep: Sweep) -> str:
    """An assessment of the scene's own settings, as HTML."""
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
        parts.append("No measured setting is as exact and faster by more than the spread of the times.")
    return " ".join(parts)


def _plot(sweep: Sweep) -> str:
    tunable = sweep.color_tunable()
    keys = []
    if tunable is not None:
        for i, value in enumerate(sweep.values(tunable["name"])):
            keys.append(f'<li><i class="key c{i}"></i>{escape(wording.setting(value))}</li>')
    name = escape(str(tunable["title"])) if tunable else ""
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
        if tunable else ""
    )
    lost = sum(p["rmse"] is None or median(p) is None for p in sweep.points)
    note = (
        f'<p class="small-print">{wording.several(lost, "setting")} without a finite error or time: '
        "in the table only.</p>" if lost else ""
    )
    return (
        '<section class="plot-section">\n<h2>Error against time</h2>\n'
        '<p class="lead">Each dot is one setting of the renderer. Left is faster, down is more '
        "exact; both axes are logarithmic.</p>\n"
        f'{legend}\n<div class="plot">\n{front_plot(sweep, 1100, 600, "wide")}\n'
        f'{front_plot(sweep, 400, 440, "narrow")}\n</div>\n{note}</section>'
    )


def _viewer() -> str:
    return (
        '<dialog id="viewer"><div class="viewer-bar"><p id="viewer-name"></p>'
        '<div id="viewer-what"></div><button type="button" id="viewer-close" '
        'aria-label="close">×</button></div><img id="viewer-image" alt="">'
        '<p id="viewer-help">Space: switch to the exact picture and back. \N{LEFTWARDS ARROW} '
        "\N{RIGHTWARDS ARROW}: other settings.</p></dialog>"
    )


def _data(sweep: Sweep) -> str:
    """The data of the script, as JSON that cannot close the HTML element that contains it."""
    baseline = sweep.baseline["settings"]
    points = {
        str(p["id"]): {
            "label": p["label"], "error": wording.number(p["rmse"]),
            "time": wording.seconds(median(p)),
            "frames": wording.several(p["seconds"]["frames"], "frame"),
            "range": f"{wording.seconds(p['seconds'].get('min'))} to "
                     f"{wording.seconds(p['seconds'].get('max'))}",
            "settings": [
                [k["title"], wording.setting(p["settings"].get(k["name"])),
                 p["settings"].get(k["name"]) != baseline.get(k["name"])]
                for k in sweep.tunables
            ],
            "against": sweep.against_baseline(p),
        }
        for p in sweep.points
    }
    tunables = []
    for tunable in sweep.varied():
        values = sweep.values(tunable["name"])
        ordered = all(isinstance(v, (int, float)) and not isinstance(v, bool) for v in values)
        tunables.append({
            "title": tunable["title"], "ordered": ordered and len(values) > 2,
            "values": [wording.setting(v) for v in values],
            "of": {str(p["id"]): sweep.color_class(p, tunable) for p in sweep.points},
        })
    chosen = sweep.color_tunable()
    first = next((i for i, k in enumerate(sweep.varied()) if k is chosen), 0)
    text = json.dumps({"points": points, "knobs": tunables, "color": first}, ensure_ascii=False)
    return text.replace("&", "\\u0026").replace("<", "\\u003c").replace(">", "\\u003e")


def _options(sweep: Sweep, point: Point) -> str:
    return " ".join(f"--set {shlex.quote(option)}" for option in sweep.options(point))


def _threshold(value: float) -> str:
    exponent = wording.exponent_of(value)
    return f"{value:g}" if value >= 9.9e-5 else (
        wording.power_of_ten(exponent) if abs(value / 10.0**exponent - 1) < 1e-9
        else wording.number(value)
    )
