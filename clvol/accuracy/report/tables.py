"""The tables of the report, as HTML: one setting at a time, and all settings."""

from __future__ import annotations

from html import escape
from typing import Any

from clvol.accuracy.report import wording
from clvol.accuracy.report.svg import tunable_plot
from clvol.accuracy.report.sweep import Point, Sweep, median

_COLUMNS = (  # title, explanation, path in a point, format
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


def tunables_alone(sweep: Sweep) -> str:
    parts = []
    for tunable in sweep.tunables:
        points = sweep.alone(tunable["name"])
        if len(points) < 2:
            continue
        rows = "".join(
            f'<tr data-id="{escape(str(p["id"]))}"'
            f'{_own_class(p, sweep)}><th scope="row">'
            f"{escape(wording.setting(p['settings'].get(tunable['name'])))}</th>"
            f"<td>{escape(wording.number(p['rmse'], 2))}</td>"
            f"<td>{escape(wording.seconds(median(p), 2))}</td></tr>"
            for p in points
        )
        unit = f" ({escape(str(tunable['unit']))})" if tunable.get("unit") else ""
        about = f"<p>{escape(wording.upper(str(tunable.get('about') or '')))}</p>"
        parts.append(
            f'<article><h3>{escape(wording.upper(str(tunable["title"])))}<small>{unit}</small></h3>{about}'
            f'{tunable_plot(sweep, tunable)}<table class="values"><thead><tr><th scope="col">'
            f'{escape(str(tunable["title"]))}</th><th scope="col">error</th><th scope="col">time</th>'
            f"</tr></thead><tbody>{rows}</tbody></table></article>"
        )
    if not parts:
        return ""
    return (
        "<section>\n<h2>One setting at a time</h2>\n"
        '<p class="lead">All other settings are those of your scene, which is ringed. The axes are '
        "those of the plot above, so a setting that moves nothing here changes nothing.</p>\n"
        f'<div class="knobs">\n{"".join(parts)}\n</div>\n</section>'
    )


def all_settings(sweep: Sweep) -> str:
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
        '</span>Settings on the front are bold.</p>\n'
        '<div class="scroll"><table id="all" class="values"><thead><tr>'
        f'{head}</tr></thead><tbody>\n{chr(10).join(rows)}\n</tbody></table></div>\n</section>'
    )


def _quality(point: Point, path: str, value: float | None, front: set[str]) -> str:
    if value is None:
        exact = point["rmse"] == 0 or point["id"] in front
        return "∞" if path == "psnr" and exact else wording.NOTHING
    return f"{value:.1f}" if path == "psnr" else f"{value:.5f}"


def _look_up(point: Point, path: str) -> Any:
    value: Any = point
    for key in path.split("."):
        value = value.get(key) if isinstance(value, dict) else None
    return value


def _own_class(point: Point, sweep: Sweep) -> str:
    return ' class="baseline"' if point["id"] == sweep.baseline["id"] else ""
