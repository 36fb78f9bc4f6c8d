"""Colour tables of VisIt (.ct): XML with control points from 0 to 1."""

from __future__ import annotations

import numpy as np

from clvol.errors import SceneError
from clvol.transfer.exchange.imported import Imported
from clvol.transfer.exchange.text_files import in_unit, parse_numbers
from clvol.transfer.exchange.vtk_nodes import Nodes, color_knots, opacity_knots

EXPECTED = "a colour table of VisIt (XML)"


def read_color_table(text: str, where: str) -> Imported:
    """The colour table, linear in sRGB between its points; a discrete one as steps half-way between them.

    Alpha below 255 is opacity. SceneError for a file that is none, or that declares entities.
    """
    import xml.etree.ElementTree as Tree

    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise SceneError(where, "declares a document type or entities", EXPECTED)
    try:
        root = Tree.fromstring(text)
    except (Tree.ParseError, RecursionError, ValueError) as error:
        raise SceneError(where, f"no XML ({error})"[:120], EXPECTED) from None
    if root.get("name") != "ColorTable":
        raise SceneError(where, f"<{root.tag} name={root.get('name')!r}>"[:80], EXPECTED)
    rows = []
    for k, point in enumerate(root.iter("Object")):
        if point.get("name") != "ColorControlPoint":
            continue
        fields = {field.get("name"): (field.text or "").split() for field in point.iter("Field")}
        if not {"colors", "position"} <= fields.keys() or len(fields["colors"]) not in (3, 4):
            raise SceneError(f"{where}: point {k - 1}", "no position with three or four colours", EXPECTED)
        numbers = parse_numbers([*fields["position"][:1], *fields["colors"]], f"{where}: point {k - 1}")
        rows.append([numbers[0], *(np.array(numbers[1:]) / 255), *([1.0] if len(numbers) == 4 else [])])
    if not rows:
        raise SceneError(where, "no control points", EXPECTED)
    table = np.array(rows)
    in_unit(table[:, :1], where, "position")
    in_unit(table[:, 1:], where, "component")
    colors, alphas = Nodes.ordered(table[:, :4], 3), Nodes.ordered(table[:, [0, 4]], 1)
    if _is_discrete(root):
        steps = np.ones(len(colors.values))
        colors = Nodes(colors.values, colors.table, colors.midpoints, steps)
        alphas = Nodes(alphas.values, alphas.table, alphas.midpoints, steps)
    has_opacity = bool((table[:, 4] < 1.0).any())
    opacities = opacity_knots(alphas) if has_opacity else None
    return Imported(where, color_knots(colors), opacities, is_relative=True)


def _is_discrete(root) -> bool:
    return any(
        field.get("name") in ("discrete", "discreteFlag") and (field.text or "").strip() in ("true", "1")
        for field in root.iter("Field")
    )
