"""clvol render --bricks: one picture of a volume that no device holds as a whole."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from clvol.errors import UsageError

if TYPE_CHECKING:
    from clvol.cli.console import ShowProgress
    from clvol.cli.render_still import RenderElsewhere
    from clvol.cluster.connection import Connection
    from clvol.render.frame import Frame
    from clvol.scene import Scene


def picture_in_bricks(
    cluster: Connection | None, path: str, overrides: Sequence[str], scene: Scene, count: int,
    devices: list[str] | None, memory_cap: int | None,
) -> RenderElsewhere:  # fmt: skip
    """What renders the picture of ``scene``, loaded from ``path`` with ``overrides``, in ``count`` bricks: on the
    workers of ``cluster``, or here, one after the other."""

    def render(progress: ShowProgress | None, depth: bool) -> Frame:
        from clvol.bricks.render import bricks_of, render_in_bricks
        from clvol.cluster.bricks import bricks_on_workers
        from clvol.render.frame import make_frame
        from clvol.render.renderer import open_context

        resolved, start = scene.resolve(memory_cap), time.perf_counter()
        if (moment := scene.moment) is not None:
            if cluster is not None:
                expected = "its scene (.toml), or this process"
                raise UsageError(path, "workers do not render pictures again that carry their scene", expected)
            resolved = resolved if moment.time is None else resolved.at(moment.time)
            if moment.camera is not None:
                volume = resolved.volume
                camera = moment.camera.complete(volume.grid, resolved.image, resolved.origin, volume.frame)
                resolved = replace(resolved, camera=camera)
        bricks = bricks_of(resolved, count)
        if cluster is not None:
            request: dict[str, Any] = {
                "path": path, "overrides": list(overrides), "count": count, "devices": devices, "memory_cap": memory_cap
            }  # fmt: skip
            rgba, depths, counted = bricks_on_workers(
                cluster, bricks, request, [path, *scene.input_paths], progress, depth
            )
            names = ["workers"]
        else:
            context = open_context(devices)
            try:
                rgba, depths, samples = render_in_bricks(context, bricks.resolved, count, progress, depth)
                names = [context.name]
            finally:
                context.release()
            counted = {"samples": samples, "bricks": count}
        counted["rays"] = rgba.shape[0] * rgba.shape[1]
        return make_frame(bricks.resolved, rgba, depths, {"render": time.perf_counter() - start}, counted, names)

    return render
