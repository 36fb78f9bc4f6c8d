/* What oracles of the method "pyramid" know beforehand: statistics of cells, which distances of samples they are bad for, and how far
 * every cell is from bad ones (clvol/render/pyramid/cells.py). Cells are cubes of 2^shift lattice cells.
 *
 * Switches (-D): VOXEL_BITS, VOXEL_SIGNED, VOXEL_SCALED; SCALES: distances of samples 1, 2, 4 ... smallest edges.
 */
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

#define VOXEL_AT(i, j, k) VALUE(volume[((size_t)(k) * size.y + (j)) * size.x + (i)])

/* How far the value at a voxel is from what linear interpolation between samples `scale` edges apart, it in the middle, makes of it:
 * the sum over the axes of |v - (v- + v+) / 2|, v- and v+ half of that way before and behind it. Beyond the volume its outermost
 * voxels count. Between voxels the field is nearly straight: at half the distance of two voxels half of that is left.
 *
 * volume      Voxel [size.z, size.y, size.x]
 * halves      int4 [SCALES]: half of each scale, in lattice units along x, y, z, at least 1
 * shares      float4 [SCALES]: what of the difference counts along each axis: less than 1 where half the scale is no whole lattice unit
 * statistics  float [SCALES + 2, z, y, x]: lowest, highest finite value in each cell, its faces included; for each scale the largest
 *             deviation. A cell with a voxel that is not finite has deviation INFINITY, one without any finite one low > high.
 */
__kernel void cell_statistics(__global const Voxel *restrict volume, int4 size, int shift, __constant int4 *halves,
                              __constant float4 *shares MAP_PARAMETERS, __global float *restrict statistics)
{
  const int cx = get_global_id(0), cy = get_global_id(1), cz = get_global_id(2);
  const int edge = 1 << shift, x0 = cx << shift, y0 = cy << shift, z0 = cz << shift;
  const int x1 = min(x0 + edge, size.x - 1), y1 = min(y0 + edge, size.y - 1), z1 = min(z0 + edge, size.z - 1);
  float low = INFINITY, high = -INFINITY, worst[SCALES];
  for (int s = 0; s < SCALES; ++s) worst[s] = 0.0f;
  for (int z = z0; z <= z1; ++z)
    for (int y = y0; y <= y1; ++y)
      for (int x = x0; x <= x1; ++x) {
        const float v = VOXEL_AT(x, y, z);
        low = fmin(low, isfinite(v) ? v : low), high = fmax(high, isfinite(v) ? v : high);
        for (int s = 0; s < SCALES; ++s) {
          const int4 r = halves[s];
          const float dx = fabs(v - 0.5f * (VOXEL_AT(max(x - r.x, 0), y, z) + VOXEL_AT(min(x + r.x, size.x - 1), y, z)));
          const float dy = fabs(v - 0.5f * (VOXEL_AT(x, max(y - r.y, 0), z) + VOXEL_AT(x, min(y + r.y, size.y - 1), z)));
          const float dz = fabs(v - 0.5f * (VOXEL_AT(x, y, max(z - r.z, 0)) + VOXEL_AT(x, y, min(z + r.z, size.z - 1))));
          const float off = dx * shares[s].x + dy * shares[s].y + dz * shares[s].z;
          worst[s] = fmax(worst[s], isfinite(off) ? off : INFINITY);
        }
      }
  const size_t cells = get_global_size(0) * get_global_size(1) * get_global_size(2);
  __global float *out = statistics + ((size_t)cz * get_global_size(1) + cy) * get_global_size(0) + cx;
  out[0] = low, out[cells] = high;
  for (int s = 0; s < SCALES; ++s) out[(s + 2) * cells] = worst[s];
}

/* Largest and smallest of what a segment shows between two of the `n` bins of values: the largest (or smallest) over 2^k bins
 * from each on is in row k. */
inline float4 most_between(__global const float4 *table, int n, int from, int to)
{
  const int k = 31 - clz(to - from + 1);
  return fmax(table[k * n + from], table[k * n + to + 1 - (1 << k)]);
}

/* What an error of interpolation shows, at most, in each cell: between values `low` - deviation and `high` + deviation of it, the
 * steepest change a value times the deviation, or all the change there is.
 *
 * statistics   as above
 * slopes       float4 [SCALES, rows, n]: change of (premultiplied colour, opacity) of a segment as long as the scale, a bin, in each bin
 * tops, minus_bottoms  float4 [SCALES, rows, n]: that colour, and its negative
 * first, per_value     bin 0 begins at `first`; bins a value
 * bad          uchar [z, y, x]: bit s is set where scale s shows more than `epsilon`; with a voxel that is not finite all are
 */
__kernel void bad_scales(__global const float *restrict statistics, __global const float4 *restrict slopes,
                         __global const float4 *restrict tops, __global const float4 *restrict minus_bottoms, int n, int rows,
                         float first, float per_value, float epsilon, __global uchar *restrict bad)
{
  const size_t i = get_global_id(0), cells = get_global_size(0);
  const float low = statistics[i], high = statistics[cells + i];
  uint bits = 0;
  for (int s = 0; s < SCALES; ++s) {
    const float off = statistics[(s + 2) * cells + i];
    if (!(low <= high) || isinf(off)) {
      bits |= (low <= high) ? 1u << s : 0u; /* nothing but holes shows nothing */
      continue;
    }
    const int from = clamp((int)floor((low - off - first) * per_value), 0, n - 1);
    const int to = clamp((int)floor((high + off - first) * per_value), 0, n - 1);
    const size_t at = (size_t)s * rows * n;
    const float4 steepest = most_between(slopes + at, n, from, to) * (off * per_value);
    const float4 all = most_between(tops + at, n, from, to) + most_between(minus_bottoms + at, n, from, to);
    const float4 error = fmin(steepest, all);
    if (fmax(fmax(error.x, error.y), fmax(error.z, error.w)) > epsilon) bits |= 1u << s;
  }
  bad[i] = (uchar)bits;
}

/* bad  uchar [z, y, x]: 1 where a voxel of the cell has an opacity gradient above `threshold` a smallest edge (central differences).
 * opacity  float [n]: opacity by bins of values; edges: smallest edges a lattice unit along x, y, z */
__kernel void steep_opacity(__global const Voxel *restrict volume, int4 size, int shift MAP_PARAMETERS,
                            __global const float *restrict opacity, int n, float first, float per_value, float4 edges,
                            float threshold, __global uchar *restrict bad)
{
#define OPACITY_AT(i, j, k) opacity[clamp((int)((VOXEL_AT(i, j, k) - first) * per_value), 0, n - 1)]
  const int cx = get_global_id(0), cy = get_global_id(1), cz = get_global_id(2);
  const int edge = 1 << shift, x0 = cx << shift, y0 = cy << shift, z0 = cz << shift;
  const int x1 = min(x0 + edge, size.x - 1), y1 = min(y0 + edge, size.y - 1), z1 = min(z0 + edge, size.z - 1);
  int steep = 0;
  for (int z = z0; z <= z1; ++z)
    for (int y = y0; y <= y1; ++y)
      for (int x = x0; x <= x1; ++x) {
        const float dx = OPACITY_AT(min(x + 1, size.x - 1), y, z) - OPACITY_AT(max(x - 1, 0), y, z);
        const float dy = OPACITY_AT(x, min(y + 1, size.y - 1), z) - OPACITY_AT(x, max(y - 1, 0), z);
        const float dz = OPACITY_AT(x, y, min(z + 1, size.z - 1)) - OPACITY_AT(x, y, max(z - 1, 0));
        const float gx = 0.5f * dx / edges.x, gy = 0.5f * dy / edges.y, gz = 0.5f * dz / edges.z;
        steep |= gx * gx + gy * gy + gz * gz > threshold * threshold;
      }
  bad[((size_t)cz * get_global_size(1) + cy) * get_global_size(0) + cx] = (uchar)steep;
}

/* One of three passes that find, of every cell, the squared distance to the nearest cell of a set: between the nearest points of both, in
 * smallest edges. Along `axis` cells are `cell` edges long, and no more than `window` of them are looked at either way.
 *
 * in   float [z, y, x]: of the passes before; INFINITY where nothing has been found, 0 in the set before the first
 */
__kernel void near_pass(__global const float *restrict in, __global float *restrict out, int4 cells, int axis, int window, float cell)
{
  const int x = get_global_id(0), y = get_global_id(1), z = get_global_id(2);
  const int stride = axis == 0 ? 1 : axis == 1 ? cells.x : cells.x * cells.y;
  const int place = axis == 0 ? x : axis == 1 ? y : z, count = axis == 0 ? cells.x : axis == 1 ? cells.y : cells.z;
  const size_t at = ((size_t)z * cells.y + y) * cells.x + x;
  float best = in[at];
  const int before = min(window, place), behind = min(window, count - 1 - place);
  for (int k = 1; k <= before; ++k) {
    const float gap = (k - 1) * cell;
    best = fmin(best, in[at - (size_t)k * stride] + gap * gap);
  }
  for (int k = 1; k <= behind; ++k) {
    const float gap = (k - 1) * cell;
    best = fmin(best, in[at + (size_t)k * stride] + gap * gap);
  }
  out[at] = best;
}

/* float [cells]: 0 where any of `bits` is set, else INFINITY. */
__kernel void start_near(__global const uchar *restrict bad, uint bits, __global float *restrict out)
{
  const size_t i = get_global_id(0);
  out[i] = bad[i] & bits ? 0.0f : INFINITY;
}

/* distances = max(distances, min(most, root of `squares`)) */
__kernel void widen_distance(__global const float *restrict squares, float most, __global float *restrict distances)
{
  const size_t i = get_global_id(0);
  distances[i] = fmax(distances[i], fmin(most, sqrt(squares[i])));
}

/* Distances to bytes, rounded down (oracle_map.h). */
__kernel void distance_bytes(__global const float *restrict distances, __global uchar *restrict bytes)
{
  const size_t i = get_global_id(0);
  const int code = (as_int(distances[i]) >> 19) - ((127 - 4) << 4);
  bytes[i] = (uchar)clamp(code, 0, 255);
}
