"""Runs a command and prints its wall time, processor time and peak memory as JSON. A small program of its own:
a process counts the memory of whoever started it until it has replaced itself."""

import json
import os
import subprocess
import sys
import time

start = time.perf_counter()
child = subprocess.Popen(sys.argv[1:], stdout=subprocess.DEVNULL)
_, status, used = os.wait4(child.pid, 0)
seconds = time.perf_counter() - start
unit = 1 if sys.platform == "darwin" else 1024
status = os.waitstatus_to_exitcode(status)
processor = used.ru_utime + used.ru_stime  # of its own children, too
print(json.dumps({"seconds": seconds, "processor": processor, "status": status, "peak_bytes": used.ru_maxrss * unit}))
