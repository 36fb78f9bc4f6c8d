"""The report of a job: one self-contained page of thumbnails, parameters, times, errors and failures."""

from __future__ import annotations

import base64
import io
import os
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from statistics import median
from typing import Any

from clvol.batch.job import Picture
from clvol.batch.results import results_in
from clvol.errors import ClvolError
from clvol.image import atomic_path, load_image
from clvol.image.develop import BLACK, developed
from clvol.text import printable

_EDGE = 240  # pixels of a thumbnail's longer edge
_MOST_BYTES = 1 << 30  # of a picture
# The browser refuses to load anything from outside the page.
_POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'"
_STYLE = """
:root { color-scheme: light dark; --line: #8884; --dim: #777; --bad: #c0392b; }
body { font: 15px/1.45 system-ui, sans-serif; margin: 0 auto; max-width: 84rem; padding: 1.5rem; }
h1 { font-size: 1.5rem; margin: 0 0 .25rem; } h2 { font-size: 1.1rem; margin: 2rem 0 .75rem; }
.facts { color: var(--dim); margin: 0 0 1rem; }
.failed { border-left: 4px solid var(--bad); margin: .5rem 0; padding: .25rem .75rem; overflow-wrap: anywhere; }
.grid { display: grid; gap: 1rem; grid-template-columns: repeat(auto-fill, minmax(15rem, 1fr)); }
figure { border: 1px solid var(--line); border-radius: 6px; margin: 0; overflow: hidden; }
figure > div { align-items: center; background: #8882; display: flex; height: 15rem; justify-content: center; }
img { display: block; max-height: 15rem; max-width: 100%; }
figcaption { font-size: .85rem; padding: .5rem .75rem .75rem; overflow-wrap: anywhere; }
dl { display: grid; gap: 0 .5rem; grid-template-columns: auto 1fr; margin: 0; }
dt { color: var(--dim); } dd { margin: 0; }
.name { font-weight: 600; } .warning { color: var(--bad); }
"""


def write_report(path: str, name: str, pictures: Sequence[Picture], results: str) -> None:
    """Writes the page to ``path``. What is known of ``pictures`` is in the file ``results``, where the last line of a
    picture counts."""
    known = {tuple(map(str, result["files"])): result for result in results_in(results)}
    text = page(name, pictures, [known.get(picture.files, {}) for picture in pictures], Path(path).parent)
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="utf-8", errors="replace")


def page(name: str, pictures: Sequence[Picture], results: Sequence[Mapping[str, Any]], folder: Path) -> str:
    """The page as HTML, whose links to pictures are relative to ``folder``."""
    failed = [(p, r) for p, r in zip(pictures, results) if r.get("status") == "failed"]
    cards = [_card(p, r, folder) for p, r in zip(pictures, results) if r.get("status") != "failed"]
    problems = [
        f'<p class="failed"><span class="name">{_label(picture)}</span><br>{_text(result.get("message", ""))}</p>'
        for picture, result in failed
    ]
    parts = [
        "<!DOCTYPE html>",
        '<html lang="en">',
        "<head>",
        '<meta charset="utf-8">',
        f'<meta http-equiv="Content-Security-Policy" content="{_POLICY}">',
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        f"<title>{_text(name)}</title>",
        f"<style>{_STYLE}</style>",
        "</head>",
        "<body>",
        f"<h1>{_text(name)}</h1>",
        f'<p class="facts">{_text(_summary(pictures, results))}</p>',
        *(["<h2>Failures</h2>", *problems] if problems else []),
        *(["<h2>Pictures</h2>", '<div class="grid">', *cards, "</div>"] if cards else []),
        "</body>",
        "</html>",
    ]
    return "\n".join(parts) + "\n"


def _summary(pictures: Sequence[Picture], results: Sequence[Mapping[str, Any]]) -> str:
    failed = sum(result.get("status") == "failed" for result in results)
    seconds = [s for result in results if (s := _seconds(result)) is not None]
    facts = [f"{len(pictures)} pictures", f"{failed} failed" if failed else "none failed"]
    if seconds:
        facts.append(f"{median(seconds):.3g} s per frame (median), {sum(seconds):.3g} s in all")
    errors = [e for result in results if (e := _error(result)) is not None]
    if errors:
        facts.append(f"largest error bound {max(bound for _, bound in errors):.3g}")
    return " · ".join(facts)


def _card(picture: Picture, result: Mapping[str, Any], folder: Path) -> str:
    rows = list(picture.varied.items())
    if (seconds := _seconds(result)) is not None:
        rows.append(("frame", f"{seconds:.3g} s"))
    if isinstance(result.get("samples"), int):
        rows.append(("samples", f"{result['samples']:,}"))
    if (error := _error(result)) is not None:
        rows.append(("RMSE", f"{error[0]:.3g}, at most {error[1]:.3g}"))
    listed = "".join(f"<dt>{_text(key)}</dt><dd>{_text(value)}</dd>" for key, value in rows)
    told = "".join(f'<div class="warning">{_text(warning)}</div>' for warning in result.get("warnings", []))
    link = escape(os.path.relpath(picture.files[0], folder).replace("%", "%25").replace("#", "%23").replace("?", "%3F"))
    shown = _thumbnail(picture)
    image = f'<a href="{link}"><img alt="{_label(picture)}" src="{shown}"></a>' if shown else "<span>not there</span>"
    caption = f'<div class="name">{_label(picture)}</div><dl>{listed}</dl>{told}'
    return f"<figure><div>{image}</div><figcaption>{caption}</figcaption></figure>"


def _label(picture: Picture) -> str:
    return _text(os.path.basename(picture.files[0]))


def _thumbnail(picture: Picture) -> str | None:
    """A picture of a job as a data URL; None if it cannot be read."""
    from PIL import Image

    try:
        loaded = load_image(picture.files[0], _MOST_BYTES)
        rgba = loaded["rgba"]
        step = max(1, -(-max(rgba.shape[:2]) // (2 * _EDGE)))
        background = loaded["background"]
        shown = developed(rgba[::step, ::step], BLACK if background is None else background)
    except ClvolError:
        return None
    image = Image.fromarray(shown[..., :3])
    image.thumbnail((_EDGE, _EDGE))
    stream = io.BytesIO()
    image.save(stream, "PNG")
    return "data:image/png;base64," + base64.b64encode(stream.getvalue()).decode("ascii")


def _seconds(result: Mapping[str, Any]) -> float | None:
    seconds = result.get("seconds")
    found = seconds.get("render") if isinstance(seconds, dict) else None
    return float(found) if isinstance(found, (int, float)) else None


def _error(result: Mapping[str, Any]) -> tuple[float, float] | None:
    error = result.get("error")
    if not isinstance(error, dict) or not all(isinstance(error.get(k), (int, float)) for k in ("rmse", "bound")):
        return None
    return float(error["rmse"]), float(error["bound"])


def _text(value: Any) -> str:
    return escape(printable(str(value)))
