"""A process that is a worker of a scheduler on this machine, and tells its parent once it is there."""

from __future__ import annotations

import asyncio
import json
import os
import sys
import warnings
from typing import Any

from clvol.cluster.quiet import silence
from clvol.render.isolation.worker import end_with_parent


def main(request: str) -> None:
    asked = json.loads(request)
    end_with_parent(asked["lifeline"], asked["parent"])
    output = os.dup(1)
    os.dup2(2, 1)  # drivers may write on standard output
    asyncio.run(_serve(asked, output))
    sys.stderr.flush()
    os._exit(0)  # drivers may crash while they are unloaded


async def _serve(asked: dict[str, Any], output: int) -> None:
    from distributed import Worker

    silence()  # once dask has set its logs up, which its import does
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the port of a dashboard that nobody asks for may be taken
        worker = Worker(
            asked["scheduler"], nthreads=1, resources={"opencl": 1}, host="127.0.0.1", memory_limit=0, dashboard=False,
            local_directory=asked["scratch"],
        )  # fmt: skip
        await worker
    os.write(output, b"there\n")
    await worker.finished()


if __name__ == "__main__":
    main(*sys.argv[1:])
