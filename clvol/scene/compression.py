"""[compression]: voxels held as codes of a vector-quantising codec, and how exact these have to be."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, model_validator

from clvol.scene.sizes import parse_size
from clvol.scene.table import Number, Size, Table, Whole, wrong
from clvol.store.codecs.coded_blocks import RateTarget

TARGETS = ("max_voxel_error", "psnr", "bits_per_voxel")


class Compression(Table):
    """The volume as codes, from which its voxels are decoded before anything else is done with them.

    ``codec``: "rvq" (residual quantisation of 4^3 voxels, to a bound of the error), or one of fixed rate: "vq" (8 : 1
    for bytes), "vq-mean", "hvq"; "labels" is exact, and is for segmentations. "none" leaves the voxels as they are,
    whatever else is stated here.

    At most one of ``max_voxel_error`` (the largest error of any voxel, as a share of the range of values), ``psnr`` (dB
    over that range, at least) and ``bits_per_voxel`` (at most, codebooks included); none: the codec's own default.

    ``decode``: "upload" decodes all voxels when they come to the device; "resident" keeps the codes there, and decodes
    the blocks that a frame needs; "auto" takes "upload" where the decoded voxels fit into ``memory`` (if left out: into
    the device's memory). Both also apply to a volume that is a store of codes, without any ``codec``.

    ``weighting``: with "transfer-function", max_voxel_error is the bound where the picture is most sensitive to values;
    elsewhere voxels may be off by as much as does not show, so that what is transparent costs next to nothing. Codes
    are then made for one transfer function.

    Fields of the role "density" are encoded, too, each to the same target over its own range of values; those of labels
    and masks stay exact. Stats list what became of them.

    ``seed``: of the random choice of the voxels that codebooks are made from.
    """

    codec: Literal["none", "vq", "vq-mean", "hvq", "rvq", "labels"] = Field(
        "none",
        title="Codec of the voxels: vector quantisation, best by 'rvq', or 'labels', which is exact.",
        description="'none', 'vq', 'vq-mean', 'hvq', 'rvq' or 'labels'",
    )
    max_voxel_error: Number | None = Field(
        None, gt=0, le=1,
        title="Largest error of any voxel, as a share of the range of values.",
        description="a number greater than 0, at most 1",
        examples=[0.01],
    )
    psnr: Number | None = Field(
        None, gt=0, le=200,
        title="Least signal-to-noise ratio of the voxels, in dB over the range of values; instead of max_voxel_error.",
        description="a number greater than 0, at most 200",
        examples=[46.0],
    )
    bits_per_voxel: Number | None = Field(
        None, gt=0, le=64,
        title="Most bits per voxel, codebooks included; instead of max_voxel_error.",
        description="a number greater than 0, at most 64",
        examples=[0.5],
    )
    weighting: Literal["even", "transfer-function"] = Field(
        "even",
        title="Whether errors count alike everywhere, or as far as the transfer function shows them.",
        description="'even' or 'transfer-function'",
    )
    decode: Literal["auto", "upload", "resident"] = Field(
        "auto",
        title="Whether all voxels are decoded on their way to the device, or the blocks that a frame needs.",
        description="'auto', 'upload' or 'resident'",
    )
    memory: Size | None = Field(
        None,
        title="Device memory for decoded voxels; without it, what the device has.",
        description="a size such as \"96 MiB\"",
        examples=["96 MiB"],
    )
    seed: Whole = Field(
        0, ge=0, lt=2**31,
        title="Seed of the random choice of the voxels that codebooks are made from.",
        description="a whole number from 0 to 2^31 - 1",
    )

    @classmethod
    def table_name(cls) -> str:
        return "compression"

    @model_validator(mode="after")
    def _one_target(self) -> Compression:
        stated = self.stated
        if len(stated) > 1:
            raise wrong(stated[1], getattr(self, stated[1]), f"either {' or '.join(stated)}, not both")
        if stated and "codec" not in self.model_fields_set:
            raise wrong("codec", None, f"a codec beside {stated[0]}, such as 'rvq'")
        if stated and self.codec == "labels":
            raise wrong(stated[0], getattr(self, stated[0]), "no target beside the codec 'labels', which is exact")
        if self.weighting != "even" and (self.is_lossy and self.codec != "rvq" or stated not in ((), TARGETS[:1])):
            raise wrong("weighting", self.weighting, "'even', or the codec 'rvq' and max_voxel_error")
        return self

    @property
    def stated(self) -> tuple[str, ...]:
        """The keys of the targets that are stated."""
        return tuple(key for key in TARGETS if getattr(self, key) is not None)

    @property
    def is_lossy(self) -> bool:
        """Whether decoded voxels may differ from the original ones."""
        return self.codec not in ("none", "labels")

    @property
    def memory_bytes(self) -> int | None:
        """``memory`` in bytes; None if it is left out."""
        return None if self.memory is None else parse_size(self.memory)

    @property
    def target(self) -> RateTarget:
        """What the encoder keeps to."""
        return RateTarget(**{key: getattr(self, key) for key in TARGETS})


NOT_COMPRESSED = Compression()
