"""A process that renders pictures of a job, and tells its parent about each in lines of JSON on standard output."""

from __future__ import annotations

import json
import os
import sys
import threading
from typing import Any

from clvol.batch.job import load_job, pictures_of
from clvol.batch.run import JobRun, Options
from clvol.errors import ClvolError
from clvol.opencl.devices import pin_threads
from clvol.render.isolation.worker import end_with_parent


def main(request: str) -> None:
    asked = json.loads(request)
    end_with_parent(asked["lifeline"], asked["parent"])
    if asked["cores"] and hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, asked["cores"])
    pin_threads()
    os.chdir(asked["folder"])
    output = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)  # drivers may write on standard output

    lock = threading.Lock()  # results come from the thread that writes pictures

    def tell(message: dict[str, Any]) -> None:
        with lock:
            output.write(json.dumps(message) + "\n")
            output.flush()

    skipped = set(asked["skipped"])
    pictures = [p for p in pictures_of(load_job(asked["path"]), asked["path"]) if p.number not in skipped]
    run = JobRun(
        pictures, Options(**asked["options"]), lambda result: tell({"result": result}),
        begin=lambda picture: tell({"begin": picture.number}),
    )  # fmt: skip
    run.run()
    sys.stderr.flush()
    os._exit(0)  # drivers may crash while they are unloaded


if __name__ == "__main__":
    try:
        main(*sys.argv[1:])
    except ClvolError as error:  # the job has changed
        print(f"clvol: error: {error}", file=sys.stderr)
        os._exit(1)
