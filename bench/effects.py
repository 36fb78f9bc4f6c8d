"""What each effect costs over the plain scene, in time and in samples; and what effects cost that a
scene states without consequence: nothing.

Each of ``effect_scenes.EFFECTS`` on two of the bench's scenes, step 1: an effect takes turns with
the plain scene, and with the effect it is built on where there is one, so that each ratio is
between frames of the same minutes. Time is frame.stats["seconds"]["render"], samples are
frame.stats["samples"]; what is done before the first frame (gradients, coefficients, light volumes
that do not change) is in neither, and is told as the seconds of preparing.

Effects without consequence: alone and all together, the kernel's hash, the samples and every bit of
the picture are compared with the plain scene's, and all together are timed beside it.
"""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import Any

import numpy as np

from bench.effect_scenes import EFFECTS, UNUSED, EffectScene, Place, all_unused, together
from bench.options import Options
from bench.report import load_average, machine, say, table
from bench.scenes import SCENES, BenchScene, available
from clvol.accuracy.timing import take_turns

SUMMARY = "what each effect costs, called for and not, in time and in samples"
SCENE_NAMES = ("engine-smooth", "aneurism")
SIZE, QUICK_SIZE, QUICK_FRAMES = 512, 48, 1
# Filters beside the linear one: the plain scene, or a lit one.
FILTERS = ("cubic", "cubic, prefiltered", "Catmull-Rom", "cubic, lit", "Catmull-Rom, lit")
FILTER_GOAL = 6.0
ALL = EffectScene("all together", "together", together)


def run(options: Options) -> dict[str, Any] | None:
    from clvol.opencl.devices import open_device

    device = open_device(options.device)
    result: dict[str, Any] = {
        "machine": machine(device), "quick": options.quick, "load_before": load_average(),
        "size": QUICK_SIZE if options.quick else SIZE, "missing": [], "scenes": [],
    }  # fmt: skip
    wanted = [s for s in SCENES if s.name in (options.scenes or SCENE_NAMES)]
    for scene in available(wanted, (), result["missing"]):
        result["scenes"].append(_Costs(scene, result["size"], device, options).measure())
    result["load_after"] = load_average()
    return result if result["scenes"] else None


def ratio_of(times: dict[str, Any], base: dict[str, Any]) -> dict[str, float]:
    """``times`` over ``base`` (both as ``timing.summary``): of the medians, and how far it may lie
    off if each median lies off by half its interquartile range, one up and one down."""
    up = {"times": 1.0 + times["spread"] / 2, "base": 1.0 + base["spread"] / 2}
    ratio = times["median"] / base["median"]
    off = up["times"] * up["base"]
    return {"ratio": ratio, "low": ratio / off, "high": ratio * off}


class _Costs:
    """Measures one scene; the plain scene and those that others are built on stay resident."""

    def __init__(self, scene: BenchScene, size: int, device: Any, options: Options) -> None:
        self.scene, self.size, self.device = scene, size, device
        self.rounds = QUICK_FRAMES if options.quick else options.frames
        self.place = Place(scene.load(), options.folder / "skies")
        self._kept: dict[str, Any] = {}
        self._stack = contextlib.ExitStack()

    def measure(self) -> dict[str, Any]:
        with self._stack:
            plain = self._kept["plain"] = self._stack.enter_context(self._renderer({}))
            frame = plain.render(depth=False)
            rows = [self._cost(effect, frame) for effect in (*EFFECTS, ALL)]
            return {
                "scene": self.scene.name, "classification": self.scene.classification,
                "samples": frame.stats["samples"], "rows": rows, "unused": self._unused(frame),
            }  # fmt: skip

    def _renderer(self, tables: dict[str, Any]) -> Any:
        from clvol.render import Renderer

        asked = self.scene.scene(
            self.place.volume, self.size, tables, classification=self.scene.classification
        )
        return Renderer(asked, [self.device])

    def _base(self, name: str) -> Any:
        """The renderer of the effect that another is built on."""
        if name not in self._kept:
            effect = next(effect for effect in EFFECTS if effect.name == name)
            renderer = self._stack.enter_context(self._renderer(effect.tables(self.place)))
            renderer.render(depth=False)
            self._kept[name] = renderer
        return self._kept[name]

    def _cost(self, effect: EffectScene, plain: Any) -> dict[str, Any]:
        from clvol.errors import ClvolError
        from clvol.explanation import kernel_hash

        row = {"name": effect.name, "group": effect.group, "over_name": effect.over, "over": None}
        try:
            with self._renderer(effect.tables(self.place)) as renderer:
                renderers = {"plain": self._kept["plain"], "effect": renderer}
                if effect.over is not None:
                    renderers["over"] = self._base(effect.over)
                frame = renderer.render(depth=False)
                samples = {
                    name: r.render(depth=False).stats["samples"] for name, r in renderers.items()
                }
                times = self._times(renderers)
                hashes = {name: kernel_hash(r.resolved) for name, r in renderers.items()}
        except ClvolError as error:
            say(f"{self.scene.name}: {effect.name}: {error}")
            return row | {"refused": str(error)}
        row |= {
            "seconds": times["effect"]["median"], "frames": times["effect"]["frames"],
            "prepare": frame.stats["seconds"]["prepare"], "samples": samples["effect"],
            "counters": frame.stats.get("counters", {}),
            "same_kernel": hashes["effect"] == hashes["plain"],
            "same_picture": bool(np.array_equal(frame.rgba, plain.rgba)),
        }  # fmt: skip
        for name in renderers.keys() - {"effect"}:
            row[name] = {
                **ratio_of(times["effect"], times[name]),
                "samples": samples["effect"] / max(samples[name], 1),
            }
        say(f"{self.scene.name}: {effect.name}: {row['plain']['ratio']:.2f} times the plain time,"
            f" {row['plain']['samples']:.2f} times its samples")
        return row

    def _times(self, renderers: dict[str, Any]) -> dict[str, Any]:
        def turn(renderer: Any) -> Any:
            return lambda: renderer.render(depth=False).stats["seconds"]["render"]

        return take_turns({name: turn(r) for name, r in renderers.items()}, self.rounds)

    def _unused(self, plain: Any) -> dict[str, Any]:
        from clvol.errors import ClvolError

        cases = [*((effect.name, effect.tables) for effect in UNUSED),
                 ("all of them together", all_unused)]
        found: dict[str, Any] = {"cases": []}
        for name, tables in cases:
            try:
                with self._renderer(tables(self.place)) as renderer:
                    found["cases"].append({"name": name, **self._same(renderer, plain)})
                    if tables is all_unused:
                        times = self._times({"plain": self._kept["plain"], "unused": renderer})
                        found["time"] = ratio_of(times["unused"], times["plain"])
            except ClvolError as error:
                say(f"{self.scene.name}: {name}: {error}")
                found["cases"].append({"name": name, "refused": str(error)})
        return found

    def _same(self, renderer: Any, plain: Any) -> dict[str, bool]:
        from clvol.explanation import kernel_hash

        frame = renderer.render(depth=False)
        first = kernel_hash(self._kept["plain"].resolved)
        return {
            "kernel": kernel_hash(renderer.resolved) == first,
            "samples": frame.stats["samples"] == plain.stats["samples"],
            "picture": bool(np.array_equal(frame.rgba, plain.rgba)),
        }


def show(result: dict[str, Any]) -> str:
    lines = []
    for s in result["scenes"]:
        lines += [
            f"{s['scene']}, {result['size']} x {result['size']}, {s['classification']},"
            f" plain: {s['samples'] / 1e6:.2f} million samples",
            table(
                ["effect", "over", "s", "x plain", "from", "to", "samples x", "x over", "samples x",
                 "prepare s", "counted"],
                [_cells(row) for row in s["rows"]], left=2,
            ),
            *_filters(s), *_unused_lines(s["unused"]), "",
        ]  # fmt: skip
    frames = min((r["frames"] for s in result["scenes"] for r in s["rows"] if "frames" in r),
                 default=0)
    lines.append(f"medians of at least {frames} frames, taking turns; from, to: if both medians"
                 " lie off by half their interquartile range; load average"
                 f" {result['load_before']} to {result['load_after']}")
    if result["missing"]:
        lines.append(f"left out, no volume: {', '.join(result['missing'])}")
    if result["quick"]:
        lines.append("This was a quick run at a small size: no figure of it is a result.")
    return "\n".join(lines)


def _cells(row: dict[str, Any]) -> list[str]:
    if "refused" in row:
        return [row["name"], row["over_name"] or "", *["-"] * 8, "refused"]
    plain, over = row["plain"], row["over"]
    on = [f"{over['ratio']:.2f}", f"{over['samples']:.2f}"] if over else ["", ""]
    counted = [f"{name} {_short(n)}" for name, n in row["counters"].items() if n]
    if row["same_kernel"]:
        counted.append("the plain kernel")
    if row["same_picture"]:
        counted.append("the plain picture")
    return [
        row["name"], row["over_name"] or "", f"{row['seconds']:.4f}", f"{plain['ratio']:.2f}",
        f"{plain['low']:.2f}", f"{plain['high']:.2f}", f"{plain['samples']:.2f}", *on,
        f"{row['prepare']:.2f}", ", ".join(counted),
    ]  # fmt: skip


def _short(count: float) -> str:
    return f"{count / 1e6:.1f} M" if count >= 1e5 else f"{count:g}"


def _filters(scene: dict[str, Any]) -> list[str]:
    costs = filter_costs(scene["rows"])
    if not costs:
        return []
    worst = max(costs.values())
    each = ", ".join(f"{name} {ratio:.2f}" for name, ratio in costs.items())
    met = "met" if worst <= FILTER_GOAL else "NOT met"
    return [f"beside the linear filter, lit beside lit: {each} (goal at most {FILTER_GOAL:g},"
            f" {met})"]


def filter_costs(rows: list[dict[str, Any]]) -> dict[str, float]:
    """Time over that of the linear filter, lit over lit, of each of FILTERS that was measured."""
    return {
        row["name"]: (row["over"] or row["plain"])["ratio"]
        for row in rows
        if row["name"] in FILTERS and "refused" not in row
    }


def _unused_lines(unused: dict[str, Any]) -> list[str]:
    refused = [case["name"] for case in unused["cases"] if "refused" in case]
    tried = [case for case in unused["cases"] if "refused" not in case]
    lines = [
        f"stated without consequence, {len(tried)} cases: "
        + ", ".join(
            f"{what} the same in {sum(case[what] for case in tried)}"
            for what in ("kernel", "samples", "picture")
        )
    ]
    for case in tried:
        differs = [what for what in ("kernel", "samples", "picture") if not case[what]]
        if differs:
            lines.append(f"  {case['name']}: NOT the same {', '.join(differs)}")
    if refused:
        lines.append(f"  refused: {', '.join(refused)}")
    if "time" in unused:
        lines.append("  all of them together take {ratio:.3f} times the plain time"
                     " ({low:.3f} to {high:.3f})".format(**unused["time"]))
    return lines


def draw(result: dict[str, Any], options: Options) -> list:
    from bench.charts import effects_chart

    committed = Path(__file__).resolve().parent / "effects.png"
    path = options.folder / "effects.png" if options.quick or options.scenes else committed
    return [effects_chart(result, path)]
