"""What a scene calls for, in words, and what therefore gets compiled."""

from __future__ import annotations

import hashlib
from typing import Any

from clvol.features.analysis import effects, reduced
from clvol.features.refuse import refuse_unknown
from clvol.scene.resolve import ResolvedScene


def explain(resolved: ResolvedScene) -> dict[str, Any]:
    """As ``clvol explain --json``: effects with reasons, and what identifies the compiled
    kernel."""
    refuse_unknown(resolved)
    listed = [
        {"name": e.name, "called_for": e.called_for, "reason": e.reason} for e in effects(resolved)
    ]
    return {"effects": listed, "kernel_hash": kernel_hash(resolved)}


def kernel_hash(resolved: ResolvedScene, lanes: int = 16) -> str:
    """Identifies exactly what gets compiled: sources and switches."""
    from clvol.opencl.context import compile_options
    from clvol.opencl.kernels_path import kernel_folder
    from clvol.render.raycast import raycast_switches, scene_nodes

    resolved = reduced(resolved)
    if resolved.integration.method == "reference":
        names, options = ("reference*",), (resolved.volume.dtype.name, resolved.integration.filter)
    else:
        warped = scene_nodes(resolved).warp is not None
        options = compile_options(raycast_switches(resolved, warped=warped, lanes=lanes))
        names = ("raycast.cl", "*.h")
    digest = hashlib.sha256(" ".join(options).encode())
    for pattern in names:
        for path in sorted(kernel_folder().glob(pattern)):
            digest.update(path.read_bytes())
    return digest.hexdigest()[:16]
