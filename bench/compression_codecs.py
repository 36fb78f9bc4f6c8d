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
    """``codes``: a ``CodedVolume``. ``seconds`` of encoding, without those of training."""

    codes: Any
    training: Any
    training_seconds: float
    seconds: float

    @property
    def nbytes(self) -> int:
        """Of blocks, codebooks, and four for the length of each block, as stores have it."""
        return len(self.codes.coded.data) + self.codes.codebooks.nbytes + 4 * len(self.codes.coded)


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


class TimedTrainer:
    """A ``Trainer`` that keeps its last ``training`` and the ``seconds`` that this took; one that is given is used."""

    def __init__(self, trainer: Any, training: Any = None) -> None:
        self.trainer, self.training, self.seconds = trainer, training, 0.0

    def train(self, *about: Any) -> Any:
        if self.training is None:
            start = perf_counter()
            self.training = self.trainer.train(*about)
            self.seconds = perf_counter() - start
        return self.training

    def encoder(self, training: Any) -> Any:
        return self.trainer.encoder(training)


class Coder:
    """The codecs on one volume and one device."""

    def __init__(self, volume: Any, device: Any) -> None:
        from clvol.integrators.decoding import trainer
        from clvol.opencl.context import DeviceContext

        self.volume, self.context = volume, DeviceContext(device)
        self.trainer = trainer(self.context)

    def encode(self, codec: str, target: Target, trained: Coded | None = None) -> Coded:
        """``trained``: whose training is used once more, where the same is asked for."""
        from clvol.encoding.coded_volume import encoded_volume
        from clvol.scene.compression import Compression

        settings = Compression(codec=codec, **target)
        trainer = TimedTrainer(self.trainer, None if trained is None else trained.training)
        start = perf_counter()
        codes = encoded_volume(self.volume, settings, trainer)
        return Coded(codes, trainer.training, trainer.seconds, perf_counter() - start - trainer.seconds)

    def decode(self, coded: Coded, on_host: bool = False) -> np.ndarray:
        """On the device, or in numpy: the same voxels."""
        from clvol.encoding.coded_volume import decode_on_host
        from clvol.integrators.decoding import decode_on

        decode = decode_on_host if on_host else decode_on(self.context)
        return np.concatenate([layer for _, layer in coded.codes.layers(decode)])

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
