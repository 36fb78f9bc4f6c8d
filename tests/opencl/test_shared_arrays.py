"""Memory of pictures that devices share, and values that are written once."""

from __future__ import annotations

import numpy as np

from clvol.opencl import context as context_module
from clvol.opencl.context import DeviceContext, shared_array


def test_memory_is_used_again_once_nothing_refers_to_it(monkeypatch):
    monkeypatch.setattr(context_module, "_free", [])
    first = shared_array((301, 7), np.float32)
    address, row = first.ctypes.data, first[5]
    assert address % 4096 == 0 and first.shape == (301, 7) and first.flags.writeable
    del first
    second = shared_array((301, 7), np.float32)
    assert second.ctypes.data != address  # a row of the first is still in use
    row[:] = 3.0
    del row
    assert shared_array((301, 8), np.float32).ctypes.data != address
    assert shared_array((301, 7), np.float32).ctypes.data == address


def test_large_arrays_are_not_kept(monkeypatch):
    monkeypatch.setattr(context_module, "_free", [])
    monkeypatch.setattr(context_module, "_LARGEST_KEPT", 1000)
    del_me = shared_array((1001,), np.uint8)
    del del_me
    assert not context_module._free


def test_the_same_values_are_written_once(device, monkeypatch):
    context = DeviceContext(device)
    array = context.empty(np.int32, (3,))
    written, real = [], context._enqueue_write
    monkeypatch.setattr(context, "_enqueue_write", lambda *given: (written.append(given), real(*given))[1])
    for values in ([1, 2, 3], [1, 2, 3], [1, 2, 4], [1, 2, 3]):
        context.write_once(array, np.array(values, np.int32))
        assert context.read(array).tolist() == values
    assert len(written) == 3
    other = context.empty(np.int32, (3,))
    context.write_once(other, np.array([1, 2, 3], np.int32))
    assert context.read(other).tolist() == [1, 2, 3]
    context.release()
