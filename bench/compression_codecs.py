"""clvol's own codecs on a volume in memory, everything counted: blocks, the index of blocks, codebooks."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from time import perf_counter
from typing import Any

import numpy as np

from bench.compression_scenes import Target


@dataclass(frozen=True, eq=False)
class Coded:
    """``codes``: a ``CodedVolume``. ``seconds``: of training and encoding."""

    codes: Any
    seconds: float

    @property
    def nbytes(self) -> int:
        return self.codes.nbytes


@dataclass(frozen=True, eq=False)
class Decoder:
    """Codes on a device: ``seconds()`` takes one decoding of the whole volume into a buffer of the device, from codes
    that are there ("codes resident") or from the host ("codes uploaded": checked, copied and decoded)."""

    name: str
    context: Any
    run: Any

    def seconds(self) -> float:
        start = perf_counter()
        self.run()
        self.context.finish()
        return perf_counter() - start


class Coder:
    """The codecs on one volume. ``trainer``: by default that of ``device``."""

    def __init__(self, volume: Any, device: Any, trainer: Any = None) -> None:
        self.volume, self.device = volume, device
        self._trainer = trainer

    @property
    def trainer(self) -> Any:
        if self._trainer is None:
            from clvol.encoding.trainer import VectorTrainer
            from clvol.opencl.context import DeviceContext

            self._trainer = VectorTrainer(DeviceContext(self.device))
        return self._trainer

    def encode(self, codec: str, target: Target) -> Coded:
        from clvol.encoding.coded_volume import encoded_volume
        from clvol.scene.compression import Compression

        trainer, settings = self.trainer, Compression(codec=codec, **target)
        start = perf_counter()
        codes = encoded_volume(self.volume, settings, trainer)
        return Coded(codes, perf_counter() - start)

    def decode(self, coded: Coded) -> np.ndarray:
        """In numpy: the voxels that every device gives."""
        from clvol.store.codecs.decode import decode_blocks

        return coded.codes.decoded(decode_blocks).data

    def decoders(self, coded: Coded, names: Sequence[str]) -> Iterator[Decoder]:
        """Decoding on the devices of these names, as far as they are there."""
        from clvol.device.code_decoder import CodeDecoder
        from clvol.errors import DeviceError
        from clvol.opencl.context import DeviceContext
        from clvol.opencl.devices import open_device

        codes = coded.codes
        grid, edge = codes.blocks, codes.blocks.edge
        numbers = np.arange(grid.count)
        corners = grid.places(numbers) * edge
        for name in names:
            try:
                context = DeviceContext(open_device(name))
            except DeviceError:
                continue
            decoder = CodeDecoder(context, codes.codebooks)
            voxels = context.empty(codes.dtype, grid.shape)
            held = decoder.hold(codes.coded, edge)
            ways = {
                "codes resident": lambda d=decoder, h=held, v=voxels: d.into_volume(h, numbers, v, corners),
                "codes uploaded": lambda d=decoder, v=voxels: d.decode_volume(codes.coded, edge, v, corners),
            }
            for way, run in ways.items():
                yield Decoder(f"{name}, {way}", context, run)
