"""The encoder's kernels on one device: cutting blocks, choosing codes, and single stages of vector quantisation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clvol.opencl.arguments import reads, value, writes
from clvol.opencl.context import DeviceArray, DeviceContext
from clvol.store.codecs.coded_blocks import ENTRIES, MOST_STAGES, Codebooks

UNUSED_NORM = float(1 << 23)  # of unused codewords: further than any other
NO_BOUND = 2**31 - 1
_EACH = 64  # sub-blocks of a work-item of `encode_stage`

_CUT = (
    reads("samples", np.uint16),
    value("edge", np.int32),
    value("octants", np.int32),
    value("levels", np.uint32),
    writes("work", np.uint16, "octants", "subs", 64),
    writes("means", np.uint8, "octants"),
    writes("flat", np.uint64, "octants", 2),
    writes("apart", np.uint64, "octants", "subs", 2),
    writes("sums", np.uint64, "octants", 4),
)
_CHOOSE = (
    reads("work", np.uint16, "octants", "subs", 64),
    reads("means", np.uint8, "octants"),
    reads("flat", np.uint64, "octants", 2),
    reads("odd", np.uint8, "octants", "subs"),
    reads("codebook", np.float32, "stages", 64, ENTRIES),
    reads("norms", np.float32, "stages", ENTRIES),
    reads("entries", np.int8, "stages", ENTRIES, 64),
    reads("shifts", np.int32, "stages"),
    reads("lambdas", np.int64, "octants"),
    reads("bounds", np.int32, "octants"),
    value("weight", np.int64),
    value("packed", np.int32),
    value("raw_bits", np.int32),
    value("levels", np.uint32),
    value("octants", np.int32),
    value("stages", np.int32),
    writes("residual", np.int32, "octants", "subs", "beam", 64),
    writes("depths", np.uint8, "octants", "subs"),
    writes("escapes", np.uint8, "octants", "subs"),
    writes("codes", np.uint8, "octants", "subs", MOST_STAGES),
    writes("split", np.uint8, "octants"),
    writes("found", np.uint64, "octants", 3),
)
_STAGE = (
    reads("work", np.uint16),
    writes("residual", np.int32, "count"),
    reads("codebook", np.float32),
    reads("norms", np.float32, ENTRIES),
    reads("entries", np.int8),
    value("shift", np.int32),
    value("count", np.int32),
    value("each", np.int32),
    value("subtracted", np.int32),
    value("levels", np.uint32),
    writes("codes", np.uint8, "count"),
    writes("squares", np.uint64),
    writes("largest", np.int32),
)


@dataclass(frozen=True, eq=False)
class SearchTables:
    """Codebooks as the search reads them: float32 [stages, samples, ENTRIES], norms [stages, ENTRIES], entries int8
    [stages, ENTRIES, samples] and shifts int32 [stages], on the device."""

    codebook: DeviceArray
    norms: DeviceArray
    entries: DeviceArray
    shifts: DeviceArray


def search_arrays(entries: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """``codebook`` and ``norms`` of int8 ``entries`` [stages, ENTRIES, samples]. A codeword of zeros but for code 0
    counts as unused: the first one says the same."""
    wide = entries.astype(np.int64)
    half = 16 if entries.shape[-1] == 8 else 2  # of a step, in the unit of residuals: cl/nearest_code.h
    norms = (half * (wide * wide).sum(-1)).astype(np.float32)
    norms[:, 1:][norms[:, 1:] == 0] = UNUSED_NORM
    return np.ascontiguousarray(entries.transpose(0, 2, 1), np.float32), norms


def search_tables(context: DeviceContext, entries: np.ndarray, shifts: np.ndarray) -> SearchTables:
    codebook, norms = search_arrays(entries)
    return SearchTables(*(context.upload(a) for a in (codebook, norms, entries, np.asarray(shifts, np.int32))))


@dataclass(frozen=True, eq=False)
class CutBlocks:
    """Blocks as sub-blocks on the device, and what is known of their octants.

    ``subs``: sub-blocks per octant. ``means`` uint8 [octants, subs + 1], the octant's last. ``flat`` uint64
    [octants, 2], ``apart`` [octants, subs, 2] and ``sums`` [octants, 4]: see ``cut_blocks`` in cl/encode_codes.cl.
    """

    subs: int
    octants: int
    work: DeviceArray
    on_device: tuple[DeviceArray, DeviceArray]
    means: np.ndarray
    flat: np.ndarray
    apart: np.ndarray
    sums: np.ndarray


@dataclass(frozen=True, eq=False)
class ChosenCodes:
    """What ``choose_codes`` (cl/encode_codes.cl) chose: uint8 ``depths`` and ``escapes`` [octants, subs], ``codes``
    [octants, subs, MOST_STAGES], ``split`` [octants]; ``found`` uint64 [octants, 3]: squared error, bits, largest
    error."""

    depths: np.ndarray
    escapes: np.ndarray
    codes: np.ndarray
    split: np.ndarray
    found: np.ndarray


class EncoderKernels:
    """The kernels on one ``context``."""

    def __init__(self, context: DeviceContext) -> None:
        self.context = context
        self._scratch: dict[str, DeviceArray] = {}

    def cut(self, work: np.ndarray, levels: int) -> CutBlocks:
        """Cuts blocks of working values (uint16 [k, s, s, s], s at least 4). ``levels``: see ``levels_of``."""
        edge = work.shape[1]
        subs = 8 if edge >= 8 else 1
        octants = work.size // (64 * subs)
        kernel = self.context.kernel("encode_codes.cl", "cut_blocks", _CUT, {"SIZE": 64, "SUBS": subs, "BEAM": 1})
        cut = self._kept("work", np.uint16, octants * subs * 64)
        means = self.context.output(np.uint8, (octants, subs + 1))
        flat = self.context.output(np.uint64, (octants, 2))
        apart = self.context.output(np.uint64, (octants, subs, 2))
        sums = self.context.output(np.uint64, (octants, 4))
        kernel(
            self.context.queue, (octants,), (1,), sizes={"subs": subs},
            samples=self.context.share(np.ascontiguousarray(work)), edge=edge, octants=octants, levels=levels,
            work=cut, means=means, flat=flat, apart=apart, sums=sums,
        )  # fmt: skip
        take = self.context.take
        return CutBlocks(subs, octants, cut, (means, flat), take(means), take(flat), take(apart), take(sums))

    def choose(
        self, cut: CutBlocks, odd: np.ndarray, tables: SearchTables, stages: int, lambdas: np.ndarray,
        bounds: np.ndarray, weight: int, packed: int, raw_bits: int, levels: int, beam: int,
    ) -> ChosenCodes:  # fmt: skip
        """Codes of what was cut last; arguments as in cl/encode_codes.cl."""
        n, subs = cut.octants, cut.subs
        context = self.context
        kernel = context.kernel("encode_codes.cl", "choose_codes", _CHOOSE, {"SIZE": 64, "SUBS": subs, "BEAM": beam})
        outputs = {
            "depths": context.output(np.uint8, (n, subs)),
            "escapes": context.output(np.uint8, (n, subs)),
            "codes": context.output(np.uint8, (n, subs, MOST_STAGES)),
            "split": context.output(np.uint8, (n,)),
            "found": context.output(np.uint64, (n, 3)),
        }
        means, flat = cut.on_device
        kernel(
            context.queue, (-(-n // 8),), (1,), sizes={"subs": subs, "beam": beam},
            work=cut.work, means=means, flat=flat, odd=context.share(odd), codebook=tables.codebook,
            norms=tables.norms, entries=tables.entries, shifts=tables.shifts,
            lambdas=context.share(lambdas), bounds=context.share(bounds), weight=weight, packed=packed,
            raw_bits=raw_bits, levels=levels, octants=n, stages=stages,
            residual=self._kept("residual", np.int32, n * subs * beam * 64), **outputs,
        )  # fmt: skip
        return ChosenCodes(**{name: context.take(array) for name, array in outputs.items()})

    def nearest(self, residual: np.ndarray, entries: np.ndarray, shift: int) -> np.ndarray:
        """uint8 [n]: the code of the codeword (int8 ``entries`` [ENTRIES, samples]) nearest to each of ``residual``
        (int32 [n, samples])."""
        tables = search_tables(self.context, entries[None], np.array([shift]))
        return self._stage(None, self.context.share(residual), residual.shape, tables, shift, 1)[0].copy()

    def advance(
        self, work: DeviceArray, residual: DeviceArray, shape: tuple[int, int], entries: np.ndarray, shift: int,
        levels: int,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:  # fmt: skip
        """Subtracts the nearest codewords from ``residual`` (int32 of ``shape`` [n, samples]) of ``work``. Codes
        uint8 [n]; squared errors uint64 [n] and largest errors int32 [n] of decoded voxels."""
        tables = search_tables(self.context, entries[None], np.array([shift]))
        return self._stage(work, residual, shape, tables, shift, levels)

    def _stage(
        self, work: DeviceArray | None, residual: DeviceArray, shape: tuple[int, ...], tables: SearchTables,
        shift: int, levels: int,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:  # fmt: skip
        count, size = shape
        context = self.context
        kernel = context.kernel("encode_stage.cl", "encode_stage", _STAGE, {"SIZE": size})
        codes = context.output(np.uint8, (count,))
        measured, subtracted = (1, 0) if work is None else (count, 1)
        squares, largest = context.output(np.uint64, (measured,)), context.output(np.int32, (measured,))
        if work is None:
            work = self._kept("none", np.uint16, 1)
        kernel(
            context.queue, (-(-count // _EACH),), (1,), work=work, residual=residual, codebook=tables.codebook,
            norms=tables.norms, entries=tables.entries, shift=shift, count=count, each=_EACH,
            subtracted=subtracted, levels=levels, codes=codes, squares=squares, largest=largest,
        )  # fmt: skip
        return context.take(codes), context.take(squares), context.take(largest)

    def _kept(self, name: str, dtype: type, count: int) -> DeviceArray:
        """A scratch array of at least ``count`` elements, kept for the next call."""
        array = self._scratch.get(name)
        if array is None or array.shape[0] < count:
            array = self._scratch[name] = self.context.empty(dtype, (count,))
        return array


def levels_of(codebooks: Codebooks) -> int:
    """In what errors are counted: the integers of the volume's range, or working values of floating-point types."""
    return 65536 if codebooks.values.is_float else codebooks.values.span + 1
