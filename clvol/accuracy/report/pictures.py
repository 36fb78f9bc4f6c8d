"""The pictures of the report, each with its difference from the reference below it, as HTML."""

from __future__ import annotations

from html import escape

from clvol.accuracy.report import wording
from clvol.accuracy.report.images import PageImages
from clvol.accuracy.report.scales import scales
from clvol.accuracy.report.sweep import Sweep, median


def pictures(sweep: Sweep, images: PageImages) -> str:
    if not images.pictures:
        return ""
    front = {p["id"] for p in sweep.front}
    judged_by = wording.judged_by(sweep.result)
    cards = [
        '<figure class="card" data-id="reference">'
        f'{_image(images, "reference", f"The {judged_by}")}'
        f"{scales(images)}<figcaption><b>The {judged_by}</b>"
        "<span>the reference for all other pictures</span></figcaption></figure>"
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
            f'<span class="gain each">gain {escape(wording.number(scale.gain))}, last colour at '
            f"{escape(wording.number(scale.full))}</span></div>"
            f"<figcaption><b>{escape(label)}</b>{note}"
            f"<span>error {escape(wording.number(point['rmse']))}, largest "
            f"{escape(wording.number(point.get('max_abs'), 2))}</span>"
            f"<span>{escape(wording.seconds(median(point)))} per frame</span></figcaption></figure>"
        )
    return (
        "<section>\n<h2>What it looks like</h2>\n"
        '<p class="lead">The settings of the front, cheapest first, each with its difference from '
        f"the {judged_by} below.</p>\n"
        '<input type="radio" name="scale" id="scale-shared" checked>'
        '<input type="radio" name="scale" id="scale-each">\n'
        '<p class="choice"><label for="scale-shared">One scale for all</label>'
        '<label for="scale-each">A scale for each</label>'
        '<span class="with-script" hidden>Click a picture to enlarge it and to switch to the exact '
        "one.</span></p>\n"
        f'<div class="cards">\n{"".join(cards)}\n</div>\n{_sizes(images)}</section>'
    )


def _image(images: PageImages, key: str, alt: str) -> str:
    return (
        f'<img class="picture" src="{images.pictures[key]}" width="{images.width}" '
        f'height="{images.height}" alt="{escape(alt)}">'
    )


def _sizes(images: PageImages) -> str:
    if images.width == images.full_width:
        return ""
    return (
        f'<p class="small-print">Shown {images.width} pixels wide, averaged down from '
        f"{images.full_width}; the folder <code>images</code> beside this page has them in full size. "
        "Errors are of the full size.</p>\n"
    )
