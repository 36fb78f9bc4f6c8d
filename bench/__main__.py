"""``python -m bench``: see the package's docstring."""

from __future__ import annotations

import argparse
import importlib
import sys

from bench.options import Options

NAMES = (
    "peers", "shaded", "isosurface", "effects", "sampling", "profile", "scaling", "startup", "convergence",
    "tradeoff", "targets", "multiresolution", "pyramid", "slicing", "compression", "devices", "workers",
    "gallery", "first-pictures", "supersampling", "coherence", "random-peaks",
)  # fmt: skip


def main(arguments: list[str] | None = None) -> int:
    """Runs the suites that are named; the exit status is 1 if one of them could not be measured."""
    words = sys.argv[1:] if arguments is None else arguments
    if words[:1] == ["compare"]:
        from bench.compare import main as compare

        return compare(words[1:])
    parser = argparse.ArgumentParser(
        prog="bench", description="Measures clvol.",
        epilog="bench compare OLD.json NEW.json: what became slower or less exact beyond the spread.",
    )  # fmt: skip
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"{', '.join(NAMES)}; or all")
    parser.add_argument("--list", action="store_true", help="list the suites and scenes; measure nothing")
    parser.add_argument("--quick", action="store_true", help="small and short, to see that everything works")
    parser.add_argument("--device", metavar="NAME", help="device, by its name in `clvol doctor`")
    parser.add_argument("--sizes", metavar="N,N", default="512,1024",
                        help="edges of pictures in pixels, for peers and shaded")  # fmt: skip
    parser.add_argument("--scenes", metavar="A,B", default="", help="only these scenes")
    parser.add_argument("--frames", type=int, default=9, help="frames per median, at least 7")
    parser.add_argument("--classification", choices=("auto", "preintegrated", "post"),
                        help="classification of clvol, for peers and shaded; by default what a user gets: auto")
    parser.add_argument("--large", action="store_true",
                        help="multiresolution: also a volume of 8 GiB, which takes minutes and 8 GiB of disk")
    asked = parser.parse_args(words)

    modules = {name: importlib.import_module(f"bench.{name.replace('-', '_')}") for name in NAMES}
    from bench.gallery import TILES
    from bench.multiresolution_scenes import BLOCK_SCENES
    from bench.scenes import CHEST, SCENES

    if asked.list:
        for name, module in modules.items():
            print(f"{name:16}{module.SUMMARY}")
        print("scenes:         " + ", ".join(scene.name for scene in SCENES))
        return 0
    try:
        sizes = tuple(int(size) for size in asked.sizes.split(","))
    except ValueError:
        sizes = ()
    if not sizes or min(sizes) < 16:
        parser.error(f"--sizes: got {asked.sizes!r}, expected whole numbers from 16, like 512,1024")
    scenes = tuple(filter(None, asked.scenes.split(",")))
    for kind, given, known in (
        ("NAME", asked.names, NAMES), ("--scenes", scenes, [
            *(scene.name for scene in (*SCENES, CHEST, *BLOCK_SCENES[:2])), "demo", "engine", "cthead", "teapot",
            *(tile.scene for tile in TILES),
        ])
    ):  # fmt: skip
        unknown = [name for name in given if name not in known]
        if unknown:
            parser.error(f"{kind}: got {unknown[0]!r}, expected one of {', '.join(known)}")
    if asked.frames < 7:
        parser.error(f"--frames: got {asked.frames}, expected at least 7")
    options = Options(asked.quick, asked.device, sizes, scenes, asked.frames,
                      asked.classification, asked.large)
    return run(options, [n for n in NAMES if n in (asked.names or NAMES)], modules)


def run(options: Options, names: list[str], modules: dict) -> int:
    from bench.report import save, say
    from clvol.errors import ClvolError

    status = 0
    for name in names:
        module = modules[name]
        say(f"== {name}: {module.SUMMARY}")
        try:
            result = module.run(options)
        except ClvolError as error:
            say(f"{name}: {error}")
            result = None
        if result is None:
            status = 1
            continue
        say("")
        say(module.show(result))
        say("")
        for path in [save(options.folder, name, result), *_charts(module, result, options)]:
            say(str(path))
        say("")
    return status


def _charts(module, result, options: Options) -> list:
    from bench.report import say

    try:
        return module.draw(result, options)
    except ImportError as error:
        say(f"no charts: {error} (pip install matplotlib)")
        return []


if __name__ == "__main__":
    sys.exit(main())
