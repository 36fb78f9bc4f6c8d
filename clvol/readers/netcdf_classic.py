"""The size that a classic netCDF file must have; the library reads what is missing from one as zeros.

The format is that of the NetCDF Classic Format Specification (Unidata), versions 1, 2 and 5.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import BinaryIO

_MARKS = {b"CDF\x01": (4, 4), b"CDF\x02": (4, 8), b"CDF\x05": (8, 8)}  # bytes of a count, bytes of an offset
_SIZES = {1: 1, 2: 1, 3: 2, 4: 4, 5: 4, 6: 8, 7: 1, 8: 2, 9: 4, 10: 8, 11: 8}  # bytes of a number, by its type
_DIMENSIONS, _VARIABLES, _ATTRIBUTES = 10, 11, 12
_MOST = 1 << 20  # of anything in a header


def least_size(path: Path) -> int:
    """The offset of the end of the last variable; 0 for a file of another format. ValueError for a damaged header."""
    with path.open("rb") as file:
        widths = _MARKS.get(file.read(4))
        return 0 if widths is None else _Header(file, *widths).end()


class _Header:
    def __init__(self, file: BinaryIO, count: int, offset: int) -> None:
        self._file, self._count, self._offset = file, count, offset

    def end(self) -> int:
        records = self._number(self._count)
        if records == 256**self._count - 1:  # still being written
            records = 0
        self._list(_DIMENSIONS)
        lengths = []
        for _ in range(self._last):
            self._name()
            lengths.append(self._number(self._count))
        self._attributes()
        self._list(_VARIABLES)
        fixed, perpetual = 0, []
        for _ in range(self._last):
            self._name()
            ids = [self._number(self._count) for _ in range(self._at_most(self._number(self._count)))]
            self._attributes()
            size = _SIZES.get(self._number(4), 0)
            self._number(self._count)
            begin = self._number(self._offset)
            if not size or any(i >= len(lengths) for i in ids):
                raise ValueError("a damaged header")
            is_record = bool(ids) and lengths[ids[0]] == 0
            nbytes = size * math.prod(lengths[i] for i in ids[is_record:])
            if is_record:
                perpetual.append((begin, nbytes))
            else:
                fixed = max(fixed, begin + nbytes)
        step = sum(nbytes + -nbytes % 4 for _, nbytes in perpetual)
        if len(perpetual) == 1:  # records of one variable are not padded
            step = perpetual[0][1]
        ends = [begin + (records - 1) * step + nbytes for begin, nbytes in perpetual if records]
        return max([fixed, *ends])

    def _number(self, width: int) -> int:
        raw = self._file.read(width)
        if len(raw) < width:
            raise ValueError("a header that ends early")
        return int.from_bytes(raw, "big")

    def _at_most(self, count: int) -> int:
        if count > _MOST:
            raise ValueError("a damaged header")
        return count

    def _list(self, tag: int) -> None:
        found, count = self._number(4), self._number(self._count)
        if found not in (0, tag) or (found == 0 and count):
            raise ValueError("a damaged header")
        self._last = self._at_most(count)

    def _skip(self, nbytes: int) -> None:
        self._file.seek(self._at_most(nbytes + -nbytes % 4), 1)

    def _name(self) -> None:
        self._skip(self._number(self._count))

    def _attributes(self) -> None:
        self._list(_ATTRIBUTES)
        for _ in range(self._last):
            self._name()
            size = _SIZES.get(self._number(4), 0)
            self._skip(size * self._number(self._count))
