"""zfp and SZ3 in a process of their own: ``zfpy`` cannot be imported beside numcodecs.

The process is started by compression_peers.py with the Python of an environment that has numpy, zfpy and pysz. It reads
one request (JSON) per line and answers each with one line. Voxels are exchanged as .npy files. Of a request, "do" is:

  versions  the versions of the packages that can be imported
  load      "file": the voxels that all further requests are about
  encode    "codec", "mode", "value": compresses them; answers bytes and seconds. The result is kept under "key".
  decode    "key": answers seconds; if "file" is given, the voxels are written there, rounded and clipped to their type
  forget    all results

Both codecs work on float32; converting voxels to it and rounding them back is not part of any time.
"""

from __future__ import annotations

import json
import math
import sys
import time
from typing import Any

import numpy as np

# A float that lies less than k + 1/2 off an integer voxel is rounded to within k of it. SZ3 may use that: its
# quantisation steps are then 2 k + 1 wide instead of 2 k, at the same largest error.
_ROUNDING = 0.49


class Codecs:
    """The voxels, and what became of them."""

    def __init__(self) -> None:
        self.voxels = np.zeros((0, 0, 0), np.uint8)
        self.floats = np.zeros((0, 0, 0), np.float32)
        self.kept: dict[str, tuple[str, Any]] = {}

    def versions(self, request: dict[str, Any]) -> dict[str, Any]:
        from importlib.metadata import PackageNotFoundError, version

        found = {}
        for package in ("zfpy", "pysz", "numpy"):
            try:
                __import__(package)
                found[package] = version(package)
            except (ImportError, PackageNotFoundError):
                pass
        return {"versions": found}

    def load(self, request: dict[str, Any]) -> dict[str, Any]:
        self.kept.clear()
        self.voxels = np.load(request["file"], allow_pickle=False)
        self.floats = self.voxels.astype(np.float32)
        return {"voxels": self.voxels.size}

    def encode(self, request: dict[str, Any]) -> dict[str, Any]:
        compress = {"zfp": self._zfp, "sz3": self._sz3}[request["codec"]]
        start = time.perf_counter()
        stream = compress(request["mode"], request["value"])
        seconds = time.perf_counter() - start
        self.kept[request["key"]] = (request["codec"], stream)
        return {"bytes": len(stream), "seconds": seconds}

    def decode(self, request: dict[str, Any]) -> dict[str, Any]:
        codec, stream = self.kept[request["key"]]
        start = time.perf_counter()
        if codec == "zfp":
            import zfpy

            found = zfpy.decompress_numpy(stream)
        else:
            from pysz import sz

            found, _ = sz.decompress(stream, np.float32, self.voxels.shape)
        seconds = time.perf_counter() - start
        if request.get("file"):
            np.save(request["file"], as_voxels(found, self.voxels.dtype))
        return {"seconds": seconds}

    def forget(self, request: dict[str, Any]) -> dict[str, Any]:
        self.kept.clear()
        return {}

    def _zfp(self, mode: str, value: float) -> bytes:
        """``mode`` "rate": bits per voxel; "tolerance": the largest error."""
        import zfpy

        return zfpy.compress_numpy(self.floats, **{mode: value})

    def _sz3(self, mode: str, value: float) -> np.ndarray:
        """``mode`` "bound": the largest error of the voxels, in their unit."""
        from pysz import sz, szConfig, szErrorBoundMode

        if mode != "bound":
            raise ValueError(mode)
        config = szConfig(self.floats.shape)
        config.errorBoundMode = szErrorBoundMode.ABS
        config.absErrorBound = math.floor(value) + _ROUNDING if self.voxels.dtype.kind in "iu" else value
        return sz.compress(self.floats, config)[0]


def as_voxels(values: np.ndarray, dtype: np.dtype) -> np.ndarray:
    """``values`` as a volume of ``dtype`` has them."""
    if dtype.kind not in "iu":
        return values.astype(dtype)
    limits = np.iinfo(dtype)
    return np.clip(np.rint(values), limits.min, limits.max).astype(dtype)


def main() -> int:
    codecs = Codecs()
    for line in sys.stdin:
        request = json.loads(line)
        try:
            answer = getattr(codecs, request["do"])(request)
        except Exception as error:  # whatever a codec raises is told; the process stays
            answer = {"error": f"{type(error).__name__}: {error}"}
        print(json.dumps(answer), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
