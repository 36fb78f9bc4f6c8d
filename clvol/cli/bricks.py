"""clvol render --bricks: one picture of a volume that no device holds as a whole."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from clvol.cluster.connection import Connection
    from clvol.scene import Scene


def render_bricks(
    cluster: Connection | None,
    path: str,
    overrides: Sequence[str],
    scene: Scene,
    outputs: Sequence[str],
    stats: str | None,
    count: int,
    *,
    quiet: bool,
    devices: list[str] | None,
    memory_cap: int | None,
) -> None:
    """Renders ``scene``, which was loaded from ``path`` with ``overrides``, in ``count`` bricks: on the workers of
    ``cluster``, or here, one after the other."""
    from clvol.bricks.render import bricks_of, render_in_bricks
    from clvol.cli.console import say_path, to_json, working
    from clvol.cli.outputs import check_outputs
    from clvol.cluster.bricks import bricks_on_workers
    from clvol.image import atomic_paths, save_picture
    from clvol.render.frame import make_frame
    from clvol.render.renderer import open_context

    start = time.perf_counter()
    others = [] if stats is None else [stats]
    check_outputs(outputs, others)
    with working(f"loading {scene.origin}", quiet):
        bricks = bricks_of(scene.resolve(memory_cap), count)
    loaded = time.perf_counter()
    with working(f"rendering {count} bricks", quiet) as progress:
        if cluster is not None:
            request: dict[str, Any] = {
                "path": path, "overrides": list(overrides), "count": count, "devices": devices, "memory_cap": memory_cap
            }  # fmt: skip
            rgba, counted = bricks_on_workers(cluster, bricks, request, [path, *scene.input_paths], progress)
            names = ["workers"]
        else:
            context = open_context(devices)
            try:
                rgba, samples = render_in_bricks(context, bricks.resolved, count, progress)
                names = [context.name]
            finally:
                context.release()
            counted = {"samples": samples, "bricks": count}
    rendered = time.perf_counter()
    counted["rays"] = rgba.shape[0] * rgba.shape[1]
    seconds = {"load": loaded - start, "render": rendered - loaded}
    frame = make_frame(bricks.resolved, rgba, None, seconds, counted, names)
    with working("writing", quiet), atomic_paths([*outputs, *others]) as temporaries:
        for name, temporary in zip(outputs, temporaries):
            save_picture(frame, temporary, name)
        if stats is not None:
            seconds = {**frame.stats["seconds"], "total": time.perf_counter() - start}
            temporaries[-1].write_text(to_json({**frame.stats, "seconds": seconds}) + "\n", encoding="utf-8")
    for name in [*outputs, *others]:
        say_path(name)
