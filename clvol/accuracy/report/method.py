"""The section of the report on how errors and times were measured, as HTML."""

from __future__ import annotations

import statistics
from html import escape

from clvol.accuracy.report import wording
from clvol.accuracy.report.sweep import Sweep


def method(sweep: Sweep) -> str:
    result = sweep.result
    scene, machine = result["scene"], result["machine"]
    clock, reference = result["method"], result["reference"]
    spreads = [p["seconds"]["spread"] for p in sweep.points
               if p["seconds"].get("spread") is not None]
    judged_by = wording.judged_by(sweep.result)
    failed = reference.get("failed_rays") or 0
    rounds = clock.get("rounds")
    frames = wording.several(clock["frames"], "frame") + " per setting"
    if isinstance(rounds, int):
        frames += f", in {wording.several(rounds, 'round')}"
    rows = [
        ("Error", f"RMSE: root of the mean squared difference from the {judged_by}, over all "
                  "pixels and R, G, B, A, in linear light, premultiplied. PSNR, SSIM and CIEDE2000 "
                  "(ΔE): of the displayed picture."),
        (judged_by.capitalize(), _how_found(reference, failed)),
        ("Time", f"{clock['clock']}; median of {frames}"),
    ]
    if spreads:
        rows.append(("Spread of times", f"interquartile range over median: "
                     f"{wording.percent(statistics.median(spreads))} at a typical setting, "
                     f"{wording.percent(max(spreads))} at the worst. Times that differ by less "
                     "are not distinguished."))
    rows += [
        ("Device", f"{machine['device_name']} ({', '.join(map(str, machine['devices']))}), "
                   f"{machine['cores']} cores, clvol {machine['clvol']}"),
        ("Picture", f"{scene['width']} × {scene['height']} pixels"),
        ("Not on the front", "settings for which another one is at least as fast and at least as "
                             "exact"),
    ]
    items = "".join(f"<dt>{escape(name)}</dt><dd>{escape(text)}</dd>" for name, text in rows)
    warning = _warning(sweep, failed)
    source = ""
    if scene.get("source"):
        source = (f"<details><summary>The scene</summary><pre>{escape(str(scene['source']))}</pre>"
                  "</details>")
    return f"<section>\n<h2>How it was measured</h2>\n{warning}<dl>{items}</dl>\n{source}</section>"


def _how_found(reference: dict, failed: int) -> str:
    """Describes how the reference was computed."""
    estimate = wording.number(reference.get("error_estimate"), 2)
    if reference.get("step"):
        return (f"effects have no exact integral; the reference is the ray caster's own picture at a step of "
                f"{wording.number(reference['step'])} voxel edges, which differs from that at twice the "
                f"step by {estimate}")
    return (f"adaptive quadrature in double precision, tolerance "
            f"{wording.number(reference['tolerance'])}, estimated error {estimate}, "
            f"{wording.seconds(reference.get('seconds'))}; rays that missed the tolerance: {failed}")


def _warning(sweep: Sweep, failed: int) -> str:
    """A warning if the reference is not known well enough for the smallest errors; "" otherwise."""
    estimate = sweep.result["reference"].get("error_estimate")
    errors = [p["rmse"] for p in sweep.front if p["rmse"]]
    sentences = []
    if failed:
        sentences.append(f"{wording.several(failed, 'ray')} of the exact integral missed the tolerance.")
    if estimate and errors and min(errors) < 10 * estimate:
        sentences.append(f"The smallest errors are close to the {wording.judged_by(sweep.result)}'s own error: take "
                         "them as upper bounds.")
    return f'<p class="warning">{escape(" ".join(sentences))}</p>\n' if sentences else ""
