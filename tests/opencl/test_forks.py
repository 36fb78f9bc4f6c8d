"""OpenCL in a forked child is refused at once, wherever it would be used."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="this system does not fork")

_START = """
import json, multiprocessing, os, signal, sys, time
import numpy as np
import clvol

VOLUME = clvol.Volume(np.arange(512, dtype=np.uint16).reshape(8, 8, 8))

def scene(method="raycast", **more):
    return clvol.Scene(volume=VOLUME, image={"width": 16, "height": 16}, integration={"method": method}, **more)

def new(method="raycast"):
    with clvol.Renderer(scene(method), devices=[sys.argv[1]]) as renderer:
        return renderer.render()

def child(function, leave=os._exit):
    # What a forked child gets from `function`, within 20 seconds.
    reading, writing = os.pipe()
    pid = os.fork()
    if pid == 0:
        try:
            function()
            said = "fine"
        except BaseException as error:
            said = f"{type(error).__name__} {getattr(error, 'exit_status', '')} {error}"
        os.write(writing, said.encode())
        leave(0)
    end = time.monotonic() + 20
    while time.monotonic() < end:
        if os.waitpid(pid, os.WNOHANG)[0]:
            return os.read(reading, 10000).decode()
        time.sleep(0.01)
    os.kill(pid, signal.SIGKILL)
    os.waitpid(pid, 0)
    return "hangs"
"""
_USED = _START + """
used = clvol.Renderer(scene(), devices=[sys.argv[1]])
used.render()
unused = clvol.Renderer(scene(), devices=[sys.argv[1]])
exact = clvol.Renderer(scene("reference"), devices=[sys.argv[1]])
blocks = clvol.Renderer(scene("multiresolution"), devices=[sys.argv[1]])
told = {
    "used": child(used.render), "unused": child(unused.render), "exact": child(exact.render),
    "blocks": child(blocks.render), "new": child(new), "new exact": child(lambda: new("reference")),
    "to an error": child(lambda: clvol.render_to_error(scene(), 1e-2)),
    "closed": child(used.close), "left": child(unused.render, sys.exit),
}
import threading
turn, done = threading.Event(), threading.Event()
def hold():
    with used._turn():
        turn.set()
        done.wait(60)
holder = threading.Thread(target=hold)
holder.start()
turn.wait()
told["in another thread's turn"] = child(used.render)
done.set()
holder.join()
used.render()  # the parent's works as before
print(json.dumps(told))
"""
_UNUSED = _START + """
from clvol.opencl.devices import list_devices
list_devices()
with multiprocessing.get_context("fork").Pool(2) as pool:
    pictures = pool.map(work, range(3))
print(json.dumps({"pictures": len(pictures), "parent": new().rgba.shape[0], "child": child(new)}))
"""


def run(code: str, name: str) -> dict:
    import json

    done = subprocess.run([sys.executable, "-c", code, name], capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


def test_a_forked_child_is_told_at_once(device):
    from clvol.opencl.devices import report_of

    told = run(_USED, report_of(device).name)
    assert told.pop("closed") == "fine"
    for how, said in told.items():
        assert said.startswith("DeviceError 3 OpenCL: ") and '"spawn"' in said, (how, said)


def test_children_may_use_it_where_the_parent_did_not(device):
    from clvol.opencl.devices import report_of

    code = _UNUSED.replace("with multi", "def work(number):\n    return new().rgba.shape\n\nwith multi")
    told = run(code, report_of(device).name)
    assert (told["pictures"], told["parent"]) == (3, 16)
    assert told["child"].startswith("DeviceError 3 OpenCL: ")
