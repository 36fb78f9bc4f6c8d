"""What is measured of the method "pyramid", part by part; figures only, see pyramid_tables.py.

A part compares casters that take turns and share the volume on the device. Seconds are wall time of
a picture without depths, compiled and resident.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from bench.curves import Reach, reach
from bench.effects import ratio_of
from bench.multiresolution_parts import Bench, alike, stepping_row, timed
from bench.multiresolution_scenes import BlockScene
from bench.pyramid_scenes import by_pyramid, by_rays, ray_spacing, resampled
from bench.reference_cache import exact_picture
from bench.report import say
from clvol.accuracy.metrics import rmse
from clvol.scene.pyramid import DEFAULT_ORACLE

REPEATS, QUICK_REPEATS = (0, 1, 2, 4, 8, 16, 32), (0, 4)
EPSILONS, QUICK_EPSILONS = (0.3, 0.1, 0.03, 0.01, 0.003), (0.01,)
SIZES, QUICK_SIZES = (256, 512, 1024, 2048), (48, 96)
# What is held against the paper: oracles, and what they allow.
PAPER_WAYS = ((DEFAULT_ORACLE, 0.01), (DEFAULT_ORACLE, 0.3), ("opacity-gradient", 0.01),
              ("opacity-gradient", 0.025))  # fmt: skip
SSIM_GOAL, DELTA_E_GOAL = 0.985, 1.0
BLOCK_STEPPINGS = ("full", "limited", "naive", "pyramid")
CUBIC = "cubic"  # the level of dearness after the REPEATS
FINE_STEP = 0.125  # voxel edges, of the pictures that errors are measured against


def caster(bench: Bench, resolved: Any, volume: Any = None, **how: Any) -> Any:
    """What renders ``resolved`` by its method, compiled. ``volume``: on the device."""
    made = _made(bench, resolved, volume, **how)
    warm(made)
    return made


def _made(bench: Bench, resolved: Any, volume: Any = None, **how: Any) -> Any:
    if resolved.integration.method == "slicing":
        from clvol.integrators.slicing.caster import SlicingCaster

        slices = SlicingCaster(bench.context, resolved, volume=volume, **how)
        slices.switches["SLAB_SAMPLES"] = 2  # as textures are looked up
        return slices
    if resolved.integration.method == "pyramid":
        from clvol.integrators.pyramid.caster import PyramidCaster as Caster
    else:
        from clvol.integrators.raycast.caster import Raycaster as Caster
    return Caster(bench.context, resolved, volume=volume, **how)


def _size(made: Any) -> tuple[int, int]:
    return made.resolved.image.width, made.resolved.image.height


def warm(made: Any) -> None:
    made.warm_up(*_size(made), depth=False)


def picture(made: Any) -> Any:
    return made.render(made.resolved.camera, *_size(made), depth=False)


def turns(casters: Mapping[Any, Any]) -> dict[Any, Callable[[], float]]:
    return {key: timed(lambda made=made: picture(made)) for key, made in casters.items()}


def both(bench: Bench, scene: BlockScene, volume: Any = None, **integration: Any) -> dict[str, Any]:
    """Casters of ``scene``: "plain", "unskipped" (the same, not leaping over empty space) and
    "pyramid"."""
    voxels = bench.volume(scene)
    asked = by_rays(scene, voxels, bench.size, **integration)
    rays = caster(bench, asked, volume)
    return {
        "plain": rays,
        "unskipped": caster(bench, asked, rays.volume, skip=False),
        "pyramid": caster(bench, by_pyramid(scene, voxels, bench.size, integration), rays.volume),
    }


def fine_picture(bench: Bench, scene: BlockScene, rays: Any) -> Any:
    """What ``rays`` renders with short steps to the end of every ray."""
    asked = by_rays(
        scene, bench.volume(scene), bench.size, filter=rays.resolved.integration.filter,
        step=FINE_STEP, early_termination=0.0,
    )  # fmt: skip
    return picture(rays.for_scene(asked)).rgba


# As in the paper


def way_name(oracle: str, epsilon: float) -> str:
    return f"{oracle} {epsilon:g}"


def paper(
    bench: Bench, scene: BlockScene, edge: int | None = None,
    goals: dict[str, float] | None = None, share: float = 1.0,
) -> dict[str, Any]:
    """Tables 2 and 3 of Kraus et al. (2007): slices as far apart as rays, or that ``share`` of it. ``edge``: voxels to
    resample each axis to. ``goals``: how many times fewer samples ("fewer") and as fast ("faster") as
    with "minimum"."""
    volume = bench.volume(scene) if edge is None else resampled(bench.volume(scene), edge)
    name = scene.name if edge is None else f"{scene.name} {edge}^3"
    name = name if share == 1.0 else f"{name}, steps x {share:g}"
    step = {"step": share * ray_spacing(by_rays(scene, volume, bench.size))}
    asked = by_rays(scene, volume, bench.size, **step)
    exact = exact_picture(
        asked, bench.device, bench.folder, bench.size**2, lambda text: say(f"{name}: {text}")
    )
    rays = caster(bench, asked)
    casters = {"plain": rays, "unskipped": caster(bench, asked, rays.volume, skip=False)}
    casters["texture"] = caster(bench, by_rays(scene, volume, bench.size, method="slicing", **step), rays.volume)
    settings = {"minimum": {"oracle": "minimum"}} | {
        way_name(oracle, epsilon): {"oracle": oracle, "epsilon": epsilon}
        for oracle, epsilon in PAPER_WAYS
    }
    for way, table in settings.items():
        adaptive = by_pyramid(scene, volume, bench.size, step, **table)
        casters[way] = caster(bench, adaptive, rays.volume)
    frames = {way: picture(made) for way, made in casters.items()}
    times = bench.times(turns(casters))
    reference = exact.rgba.reshape(bench.size, bench.size, 4)
    ways = {
        way: {
            **way_row(way, frames, times), "rmse": exact.rmse(frame.rgba),
            **alike(frame.rgba, reference),
        }
        for way, frame in frames.items()
    }  # fmt: skip
    row = {
        "scene": name, "voxels": volume.grid.size, "size": bench.size, **step, "goals": goals,
        "overhead": ratio_of(times["minimum"], times["unskipped"]), "ways": ways,
        "settings": settings, "best": best_way(ways, settings),
    }  # fmt: skip
    found = ways[row["best"]]
    say(f"{name}: by {row['best']} {found['fewer']:.1f} times fewer samples than minimum,"
        f" {found['faster']:.2f} times as fast, SSIM {found['ssim']:.4f}")
    return row


def best_way(ways: Mapping[str, Mapping[str, Any]], adaptive: Iterable[str]) -> str:
    """The one of ``adaptive`` with the fewest samples, of those close enough to the exact picture; the
    closest where none is."""
    names = [name for name in adaptive if name != "minimum"]
    close = [name for name in names if ways[name]["ssim"] >= SSIM_GOAL
             and ways[name]["delta_e"] <= DELTA_E_GOAL]  # fmt: skip
    if close:
        return min(close, key=lambda name: ways[name]["samples"])
    return max(names, key=lambda name: ways[name]["ssim"])


def way_row(
    way: str, frames: Mapping[str, Any], times: Mapping[str, dict[str, Any]]
) -> dict[str, Any]:
    """Of ``way`` beside "minimum". ``faster``, ``fewer``: seconds and samples of "minimum" over the
    way's own. ``fewer_than_p1``: the same with what the paper's algorithm samples with that oracle, which takes the
    data wherever it asks the oracle."""
    frame = frames[way]
    both = frames["minimum"].counters["oracle_samples"]
    return {
        "time": times[way], "samples": frame.samples, "counters": frame.counters,
        "faster": times["minimum"]["median"] / times[way]["median"],
        "fewer": frames["minimum"].samples / max(frame.samples, 1),
        "fewer_than_p1": both / max(frame.samples, 1),
        "of_plain": ratio_of(times[way], times["plain"])["ratio"],
    }  # fmt: skip


# What a sample costs


def dearer(made: Any, repeats: int) -> Any:
    """The same with so many look-ups more for every sample; the picture stays what it is."""
    other = made.for_scene(made.resolved)
    if repeats:
        other.switches = other.switches | {"SAMPLE_REPEATS": repeats}
        warm(other)
    return other


def crossover(bench: Bench, scene: BlockScene, repeats: Sequence[int]) -> dict[str, Any]:
    """The pyramid beside the plain ray caster, as samples become dearer (``repeats`` from 0 on);
    and with the cubic filter."""
    casters = {0: both(bench, scene)}
    casters[CUBIC] = both(bench, scene, casters[0]["plain"].volume, filter="cubic")
    frames = {level: {way: picture(made) for way, made in ways.items()}
              for level, ways in casters.items()}  # fmt: skip
    fine = {level: fine_picture(bench, scene, ways["plain"]) for level, ways in casters.items()}
    dear = {(n, way): dearer(made, n) for n in repeats for way, made in casters[0].items()}
    dear |= {(CUBIC, way): made for way, made in casters[CUBIC].items()}
    times = bench.times(turns(dear))

    def row(level: Any) -> dict[str, Any]:
        pictures = CUBIC if level == CUBIC else 0  # dearer samples change none
        shown = frames[pictures]
        return {
            "level": level, "seconds_a_sample":
            times[level, "unskipped"]["median"] / max(shown["unskipped"].samples, 1),
            "plain": times[level, "plain"], "pyramid": times[level, "pyramid"],
            "faster": ratio_of(times[level, "plain"], times[level, "pyramid"]),
            "samples": {way: frame.samples for way, frame in shown.items()},
            "rmse": {way: rmse(frame.rgba, fine[pictures]) for way, frame in shown.items()},
        }  # fmt: skip

    rows = [row(level) for level in (*repeats, CUBIC)]
    for found in rows:
        found["cost"] = found["seconds_a_sample"] / rows[0]["seconds_a_sample"]
    crossed = crossing([(found["cost"], found["faster"]["ratio"]) for found in rows[:-1]])
    say(f"{scene.name}: the pyramid is faster {crossing_text(crossed)}")
    return {"scene": scene.name, "rows": rows, "crossing": vars(crossed)}


def crossing(points: Iterable[tuple[float, float]]) -> Reach:
    """From which cost on the pyramid stays faster, of ``points`` (cost of a sample, how many times
    as fast): straight lines in the logarithms. ``seconds`` of what is given is that cost."""
    slower = sorted((cost, 1.0 / ratio) for cost, ratio in points)
    last = max((k for k, (_, times) in enumerate(slower) if times > 1.0), default=0)
    return reach(slower[last:], 1.0)


def crossing_text(found: Reach) -> str:
    if found.kind == "at most":
        return "below the cost of a plain sample"
    if found.seconds is None:
        return "at no cost of a sample that was tried"
    return f"from {found.seconds:.2f} times the cost of a plain sample on"


# What is sampled


def oracles(bench: Bench, scene: BlockScene, epsilons: Sequence[float]) -> dict[str, Any]:
    """Every oracle with every epsilon that changes anything."""
    from clvol.integrators.pyramid.oracles import names, oracle_named

    voxels = bench.volume(scene)
    rays = caster(bench, by_rays(scene, voxels, bench.size))
    fine = fine_picture(bench, scene, rays)
    casters, prepared = {}, {}
    for name in names():
        for epsilon in epsilons if oracle_named(name).takes_epsilon else (None,):
            asked = {} if epsilon is None else {"epsilon": epsilon}
            resolved = by_pyramid(scene, voxels, bench.size, oracle=name, **asked)
            casters[name, epsilon] = caster(bench, resolved, rays.volume)
            prepared[name, epsilon] = timed(lambda: _prepare(bench, resolved, rays.volume))()
    frames = {key: picture(made) for key, made in casters.items()}
    times = bench.times(turns({"plain": rays, **casters}))
    least = frames["minimum", None].rgba
    plain = picture(rays)
    say(f"{scene.name}: {len(casters)} oracles and epsilons")
    return {
        "scene": scene.name,
        "plain": {
            "time": times["plain"], "samples": plain.samples, "from_fine": rmse(plain.rgba, fine),
        },
        "rows": [
            {
                "oracle": key[0], "epsilon": key[1], "samples": frame.samples,
                "counters": frame.counters, "time": times[key], "prepare": prepared[key],
                "from_minimum": rmse(frame.rgba, least), "from_fine": rmse(frame.rgba, fine),
            }
            for key, frame in frames.items()
        ],
    }  # fmt: skip


def _prepare(bench: Bench, resolved: Any, volume: Any) -> None:
    _made(bench, resolved, volume)
    bench.context.finish()


# Through blocks


def blocks(bench: Bench, scene: BlockScene, ratio: float) -> dict[str, Any]:
    """Steppings of the method "multiresolution" over "full", at the same blocks: ``ratio`` : 1 of the
    voxels' bytes."""
    voxels = bench.volume(scene)
    tables = {"integration": {"classification": "preintegrated"}}
    asked = scene.asked(voxels, bench.size, int(voxels.nbytes / ratio), tables).resolve()
    with bench.blocks(asked) as held:
        casters = {name: held.caster(stepping=name) for name in BLOCK_STEPPINGS}
        frames = {name: held.picture(made) for name, made in casters.items()}
        times = bench.times({name: held.turn(made) for name, made in casters.items()})
        rows = {name: stepping_row(name, frames, times) for name in casters}
        found = {"scene": scene.name, "ratio": ratio, "blocks": held.described(), "rows": rows}
    say(f"{scene.name} {ratio:g} : 1, stepping \"pyramid\": {rows['pyramid']['faster']:.2f} times"
        f" as fast as \"full\", SSIM {rows['pyramid']['ssim']:.4f}")
    return found


# How it grows


def sizes(bench: Bench, scene: BlockScene, edges: Sequence[int]) -> list[dict[str, Any]]:
    """Pictures of more and more pixels: the slices stay, rays come to lie nearer than they."""
    from clvol.integrators.pyramid.slices import slice_plan

    voxels, casters, volume = bench.volume(scene), {}, None
    for edge in edges:
        rays = caster(bench, by_rays(scene, voxels, edge), volume)
        volume = rays.volume
        casters[edge, "plain"] = rays
        casters[edge, "pyramid"] = caster(bench, by_pyramid(scene, voxels, edge), volume)
    frames = {key: picture(made) for key, made in casters.items()}
    times = bench.times(turns(casters))
    rows = []
    for edge in edges:
        asked = casters[edge, "pyramid"].resolved
        rows.append({
            "scene": scene.name, "size": edge,
            "oversampling": slice_plan(asked, asked.camera, edge, edge).oversampling,
            "faster": ratio_of(times[edge, "plain"], times[edge, "pyramid"]),
            "rmse": rmse(frames[edge, "pyramid"].rgba, frames[edge, "plain"].rgba),
            **{
                way: {"time": times[edge, way], "samples": frames[edge, way].samples}
                for way in ("plain", "pyramid")
            },
        })  # fmt: skip
        faster = rows[-1]["faster"]["ratio"]
        say(f"{scene.name} {edge}: {faster:.2f} times as fast as the plain ray caster")
    return rows
