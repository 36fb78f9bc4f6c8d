"""PROTOTYPE."""
import numpy as np
from clvol.render.layout import value_map, voxel_switches
class DeviceBlocks:
    def __init__(self, context, source, memory_bytes=None):
        self.context, self.source = context, source
        self.values = value_map(source.volume)
        self.switches = {**voxel_switches(source.volume, self.values), "VOXEL_PAIRS": 0, "SAMPLE_BUFFERS": 1}
    def load(self, levels, means):
        g = self.source.blocks; n = g.count; edge = g.edge
        L = g.levels
        code = np.where(levels == 255, 15, L - levels.astype(int)).astype(np.int64)
        index = np.zeros((n, 2), np.int32)
        index[:, 1] = code | (edge << 8)
        vals = self.values(means).astype(np.float32)
        inline = (code == 1) | (code == 15)
        index[inline, 0] = vals[inline].view(np.int32)
        at = 0; parts = []
        dtype = self.source.dtype
        for l in range(L - 1):
            which = np.flatnonzero(levels == l)
            if not which.size: continue
            s = g.samples(l)
            index[which, 0] = at + np.arange(which.size) * s**3
            d = self.source.read(l, which).reshape(-1)
            if dtype == np.float64: d = self.values(d).astype(np.float32)
            parts.append(d); at += d.size
        if dtype == np.float64:
            self.switches |= {"VOXEL_BITS": 32, "VOXEL_SCALED": 0}; dtype = np.dtype(np.float32)
        flat = np.concatenate([*parts, np.zeros(64, dtype)]) 
        c3 = code.reshape(g.counts)
        corners = np.zeros(tuple(k + 1 for k in g.counts), np.uint32)
        idx = [np.arange(k + 1) for k in g.counts]
        for j in range(8):
            d = (j >> 2, j >> 1 & 1, j & 1)
            ii = [np.clip(a - 1 + b, 0, k - 1) for a, b, k in zip(idx, d, g.counts)]
            corners |= (c3[np.ix_(*ii)] << (4 * j)).astype(np.uint32)
        self.samples = [self.context.upload(flat.view(dtype))]
        self.index, self.corners = self.context.upload(index), self.context.upload(corners)
        self.levels = levels; self.bytes = at * dtype.itemsize
