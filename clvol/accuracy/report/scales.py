"""The colour bars of difference pictures with their ticks, as HTML."""

from __future__ import annotations

from html import escape

from clvol.accuracy.difference import Scale
from clvol.accuracy.report import wording
from clvol.accuracy.report.images import PageImages, color_stops


def scales(images: PageImages) -> str:
    """The colour bars, which take the place of a difference picture of the reference itself."""
    if images.shared_scale is None:
        return ""
    ratio = f"aspect-ratio:{images.width}/{images.height}"
    return (
        f'<div class="scales" style="{ratio}"><div class="shared">{_bar(images.shared_scale)}'
        "<p>Logarithmic; the same colour is the same error in every picture.</p></div>"
        f'<div class="each">{_bar(None)}'
        "<p>Linear; each picture states its gain. At most one pixel in a thousand exceeds the scale."
        "</p></div><p>A pixel shows the largest of its differences in R, G, B and A, in linear light.</p>"
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
        ticks = [wording.number(v, 1) if v >= 1e-2 else wording.power_of_ten(wording.exponent_of(v))
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
