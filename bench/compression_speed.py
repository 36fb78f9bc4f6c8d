"""How long codecs take to encode and to decode, taking turns: clvol's on every CPU device and in numpy, zfp and SZ3 in
their own process. All encode the same voxels to about the same PSNR."""

from __future__ import annotations

from typing import Any

from bench.compression_rates import Subject
from bench.compression_scenes import Ask
from bench.multiresolution_parts import timed
from bench.report import say
from clvol.accuracy.timing import take_turns

DEVICES = ("pocl", "intel")
# What is asked for on each volume: of "rvq" a rate, of zfp and SZ3 what comes near the PSNR of that.
_CURVES = (("rvq", "rate"), ("zfp", "rate"), ("zfp", "accuracy"), ("sz3", "bound"))
_VALUES = {
    "engine": (0.45, 2.0, 1 / 4, 0.016),
    "heptane": (0.18, 2.0, 1 / 4, 0.02),
    "chest": (1.0, 2.0, 1 / 4, 0.04),
    "aneurism": (0.12, 1.0, 1 / 4, 0.04),
}
ASKED = {
    name: tuple(Ask(codec, kind, value) for (codec, kind), value in zip(_CURVES, values))
    for name, values in _VALUES.items()
}
_SLOW = 2.0  # seconds from which three turns must do


def speed(subject: Subject, rounds: int, quick: bool) -> dict[str, Any]:
    """Seconds of encoding and of decoding, by codec and by what decodes."""
    training: dict[str, float] = {}
    encoding: dict[str, Any] = {}
    decoding: dict[str, Any] = {}
    peers, coder = subject.peers, subject.coder
    for ask in ASKED[subject.scene.name]:
        if not ask.is_peer:
            coded = coder.encode(ask.codec, ask.target)
            training[ask.curve] = coded.training_seconds
            encoding[ask.curve] = lambda ask=ask, coded=coded: coder.encode(ask.codec, ask.target, coded).seconds
            decoding[f"{ask.curve}: numpy"] = timed(lambda coded=coded: coder.decode(coded, on_host=True))
            for device in coder.decoders(coded, DEVICES):
                decoding[f"{ask.curve}: {device.name}"] = device.seconds
        elif peers is not None and ask.codec in peers.codecs:
            asked = ask.codec, *subject.peer_ask(ask)
            encoded = peers.encode(*asked)
            encoding[ask.curve] = lambda asked=asked: peers.encode(*asked).seconds
            decoding[ask.curve] = lambda encoded=encoded: peers.decode_seconds(encoded)
    row = {
        "volume": subject.scene.name, "voxels": subject.volume.data.size, "training": training,
        "asked": {ask.curve: ask.value for ask in ASKED[subject.scene.name]},
        "encoding": take_turns(encoding, rounds, slow_seconds=_SLOW),
        "decoding": take_turns(decoding, rounds, slow_seconds=_SLOW),
    }  # fmt: skip
    if peers is not None:
        peers.forget()
    for part in ("encoding", "decoding"):
        told = ", ".join(f"{way} {rate(row, part, way):.0f}" for way in row[part])
        say(f"{subject.scene.name}, {part}, million voxels per second: {told}")
    return row


def rate(row: dict[str, Any], part: str, way: str, of: str = "median") -> float:
    """Million voxels per second, in the median or in the shortest ("min") time."""
    return row["voxels"] / row[part][way][of] / 1e6
