/* What oracles of the method "pyramid" know beforehand: cells that are bad for samples some distance apart, and how
 * far every cell is from such ones (clvol/integrators/pyramid/cells.py). Cells are cubes of 2^shift lattice cells.
 * Arrays of cells have rows `stride` long, a multiple of 16.
 *
 * Switches (-D): VOXEL_BITS, VOXEL_SIGNED, VOXEL_SCALED; SCALES: distances of samples 1, 2, 4 ... smallest edges.
 */
#include "oracle_layout.h"
#include "voxel_boxes.h"
#include "voxel_type.h"

#if VOXEL_BITS == 64
#pragma OPENCL EXTENSION cl_khr_fp64 : enable
#define VALUE(v) ((float)(((v) - bias) * gain))
#define MAP_PARAMETERS , double bias, double gain
#elif VOXEL_SCALED
#define VALUE(v) ((v) * gain)
#define MAP_PARAMETERS , float bias, float gain
#else
#define VALUE(v) ((float)(v))
#define MAP_PARAMETERS , float bias, float gain
#endif

#define VOXEL_AT(i, j, k) VALUE(volume[BOX_ROW(j, k) + (i)])

/* The largest (or smallest, of negatives) of a table over bins `from` to `to`: row k has that over 2^k bins from each
 * on. */
inline float4 most_between(__global const float4 *table, int n, int from, int to)
{
  const int k = 31 - clz(to - from + 1);
  return fmax(table[k * n + from], table[k * n + to + 1 - (1 << k)]);
}

/* Which scales are bad for a voxel: where samples so far apart may show more than `epsilon` that is wrong.
 *
 * How far its value is from what linear interpolation between samples `scale` edges apart, it in the middle, makes of
 * it is the sum over the axes of |v - (v- + v+) / 2|, v- and v+ half of that way before and behind. Beyond the volume
 * its outermost voxels count. What is shown differs by the steepest change per value nearby times that, or by all the
 * change there is nearby.
 *
 * volume     a box of voxels, with half of the longest scale around its own rows and slices
 * halves     int4 [SCALES]: half of each scale, in lattice units along x, y, z, at least 1
 * shares     float4 [SCALES]: what counts of the difference along each axis: less where half the scale is no whole
 *            lattice unit, since between voxels the field is nearly straight
 * slopes     float4 [SCALES, rows, n]: change of (premultiplied colour, opacity) of a segment as long as the scale, a
 *            bin
 * tops, minus_bottoms  likewise that colour, and its negative
 * steepest   float [SCALES]: largest of all slopes
 * first, per_value  bin 0 begins at `first`; bins a value
 * bad        uchar [size.z, size.y, size.x]: bit s is set where scale s is bad; beside a voxel that is not finite all
 *            are
 */
__kernel void bad_voxels(BOX_PARAMETERS, int4 size, __constant int4 *halves,
                         __constant float4 *shares MAP_PARAMETERS,
                         __global const float4 *restrict slopes, __global const float4 *restrict tops,
                         __global const float4 *restrict minus_bottoms, __constant float *steepest, int n, int rows,
                             float first,
                         float per_value, float epsilon, __global uchar *restrict bad)
{
  const int y = OWN_ROW, z = OWN_SLICE;
  for (int x = 0; x < size.x; ++x) {
    const float v = VOXEL_AT(x, y, z);
    uint bits = 0;
    for (int s = 0; s < SCALES; ++s) {
      const int4 r = halves[s];
      const float dx = fabs(v - 0.5f * (VOXEL_AT(max(x - r.x, 0), y, z) + VOXEL_AT(min(x + r.x, size.x - 1), y, z)));
      const float dy = fabs(v - 0.5f * (VOXEL_AT(x, max(y - r.y, 0), z) + VOXEL_AT(x, min(y + r.y, size.y - 1), z)));
      const float dz = fabs(v - 0.5f * (VOXEL_AT(x, y, max(z - r.z, 0)) + VOXEL_AT(x, y, min(z + r.z, size.z - 1))));
      const float off = dx * shares[s].x + dy * shares[s].y + dz * shares[s].z, bins = off * per_value;
      if (bins * steepest[s] <= epsilon) continue;
      if (!isfinite(off)) {
        bits |= 1u << s;
        continue;
      }
      const int from = clamp((int)floor((v - off - first) * per_value), 0, n - 1);
      const int to = clamp((int)floor((v + off - first) * per_value), 0, n - 1);
      const size_t at = (size_t)s * rows * n;
      const float4 error = fmin(most_between(slopes + at, n, from, to) * bins,
                                most_between(tops + at, n, from, to) + most_between(minus_bottoms + at, n, from, to));
      if (fmax(fmax(error.x, error.y), fmax(error.z, error.w)) > epsilon) bits |= 1u << s;
    }
    bad[((size_t)z * size.y + y) * size.x + x] = (uchar)bits;
  }
}

/* bad  uchar [size.z, size.y, size.x]: 1 where the opacity changes by more than `threshold` a smallest edge (central
 *      differences).
 * opacity  float [n]: by bins of values; edges: smallest edges per lattice unit along x, y, z */
__kernel void steep_voxels(BOX_PARAMETERS, int4 size MAP_PARAMETERS,
                           __global const float *restrict opacity, int n,
                           float first, float per_value, float4 edges, float threshold, __global uchar *restrict bad)
{
#define OPACITY_AT(i, j, k) opacity[clamp((int)((VOXEL_AT(i, j, k) - first) * per_value), 0, n - 1)]
  const int y = OWN_ROW, z = OWN_SLICE;
  for (int x = 0; x < size.x; ++x) {
    const float dx = OPACITY_AT(min(x + 1, size.x - 1), y, z) - OPACITY_AT(max(x - 1, 0), y, z);
    const float dy = OPACITY_AT(x, min(y + 1, size.y - 1), z) - OPACITY_AT(x, max(y - 1, 0), z);
    const float dz = OPACITY_AT(x, y, min(z + 1, size.z - 1)) - OPACITY_AT(x, y, max(z - 1, 0));
    const float gx = 0.5f * dx / edges.x, gy = 0.5f * dy / edges.y, gz = 0.5f * dz / edges.z;
    const int hole = !isfinite(VOXEL_AT(x, y, z));
    bad[((size_t)z * size.y + y) * size.x + x] = hole || gx * gx + gy * gy + gz * gz > threshold * threshold;
  }
}

/* cells  uchar [cells.z, cells.y, stride]: bits of any voxel of the cell, its upper faces included; 0 beyond cells.x */
__kernel void bad_cells(__global const uchar *restrict voxels, int4 size, int shift, int4 cells, int stride,
                        __global uchar *restrict bad)
{
  const int cy = get_global_id(0), cz = get_global_id(1), edge = 1 << shift;
  const int y0 = cy << shift, z0 = cz << shift, y1 = min(y0 + edge, size.y - 1), z1 = min(z0 + edge, size.z - 1);
  __global uchar *out = bad + ((size_t)cz * cells.y + cy) * stride;
  for (int cx = 0; cx < stride; ++cx) {
    const int x0 = cx << shift, x1 = min(x0 + edge, size.x - 1);
    uint bits = 0;
    if (cx < cells.x)
      for (int z = z0; z <= z1; ++z)
        for (int y = y0; y <= y1; ++y)
          for (int x = x0; x <= x1; ++x) bits |= voxels[((size_t)z * size.y + y) * size.x + x];
    out[cx] = (uchar)bits;
  }
}

/* Squared distances are whole numbers of some unit, at most FAR. */
#define FAR 65535

/* near  ushort [rows, stride]: 0 where any of `bits` is set, else FAR. A row per work-item. */
__kernel void start_near(__global const uchar *restrict bad, uint bits, int stride, __global ushort *restrict near)
{
  const size_t first = get_global_id(0) * (size_t)(stride / 16);
  for (size_t i = first; i < first + stride / 16; ++i) {
    const uchar16 b = vload16(i, bad) & (uchar16)(uchar)bits;
    vstore16(select((ushort16)0, (ushort16)FAR, convert_ushort16(b) == (ushort16)0), i, near);
  }
}

/* The smallest of `best` and of 16 cells of a row from x on, seen from cells of the same row. */
ushort16 near_in_row(ushort16 best, __global const ushort *row, int x, int stride, int window, __constant ushort *gaps)
{
  for (int k = 1; k <= window; ++k) {
    const ushort16 gap = gaps[k];
    ushort16 before, behind;
    if (x >= k)
      before = vload16(0, row + x - k);
    else {
      ushort each[16];
      for (int j = 0; j < 16; ++j) each[j] = x + j >= k ? row[x + j - k] : FAR;
      before = vload16(0, each);
    }
    if (x + 15 + k < stride)
      behind = vload16(0, row + x + k);
    else {
      ushort each[16];
      for (int j = 0; j < 16; ++j) each[j] = x + j + k < stride ? row[x + j + k] : FAR;
      behind = vload16(0, each);
    }
    best = min(best, add_sat(min(before, behind), gap));
  }
  return best;
}

/* One of three passes that find, of every cell, the squared distance to the nearest cell of a set: between the nearest
 * points of both. A row per work-item.
 * gaps  ushort [window + 1]: squares of what lies between two cells so many cells apart along `axis` */
__kernel void near_pass(__global const ushort *restrict in, __global ushort *restrict out, int4 cells, int stride,
                        int axis, int window,
                        __constant ushort *gaps)
{
  const int y = get_global_id(0), z = get_global_id(1);
  const size_t first = ((size_t)z * cells.y + y) * stride, apart = axis == 1 ? stride : (size_t)stride * cells.y;
  const int place = axis == 1 ? y : z, count = axis == 1 ? cells.y : cells.z;
  for (int x = 0; x < stride; x += 16) {
    __global const ushort *cell = in + first + x;
    ushort16 best = vload16(0, cell);
    if (axis == 0) {
      best = near_in_row(best, in + first, x, stride, window, gaps);
    } else {
      for (int k = 1; k <= min(window, place); ++k)
        best = min(best, add_sat(vload16(0, cell - k * apart), (ushort16)gaps[k]));
      for (int k = 1; k <= min(window, count - 1 - place); ++k)
        best = min(best, add_sat(vload16(0, cell + k * apart), (ushort16)gaps[k]));
    }
    vstore16(best, 0, out + first + x);
  }
}

/* map  uchar, as in oracle_layout.h: raised or lowered to `base` + the distance `near` stands for, at most `most`, as
 *      a byte (oracle.h), rounded down. `unit`: the length in edges whose square is the unit */
__kernel void move_distances(__global const ushort *restrict near, int4 cells, int stride, float base, float most,
                             float unit, int raises,
                             __global uchar *restrict map)
{
  const int y = get_global_id(0), z = get_global_id(1);
  for (int x = 0; x < cells.x; ++x) {
    const ushort square = near[((size_t)z * cells.y + y) * stride + x];
    const float distance = square == FAR ? most : fmin(most, base + unit * sqrt((float)square));
    const uchar code = (uchar)clamp((as_int(distance) >> 19) - ((127 - 4) << 4), 0, 255);
    __global uchar *out = map + MAP_AT(cells, x, y, z);
    *out = raises ? max(*out, code) : min(*out, code);
  }
}
