/* How much the field varies in each block that is resident: what bounds the error of a step through it
 * (clvol/transfer/step_bounds.py). Along a unit direction (in voxels) a trilinear field's slope and
 * curvature are at most what its samples' first, second and mixed differences say; across a face the neighbour's
 * outermost value counts, at its distance.
 *
 * Switches (-D): LANES (1), VOXEL_BITS, VOXEL_SIGNED, VOXEL_SCALED, VOXEL_HOLES, INTERBLOCK, SAMPLE_BUFFERS,
 * CLASSIFICATION, FILTER.
 */
#include "lanes.h"
#include "view.h"
#include "block_parameters.h"
#include "blocks.h"
#include "block_samples.h"

inline void raise(float value, float *most)
{
  if (isfinite(value)) *most = fmax(*most, fabs(value));
}

/* Of `n` samples along an axis those that face a neighbour in that direction (0: all). */
inline int2 outermost(int direction, int n)
{
  return (int2)(direction > 0 ? n - 1 : 0, direction < 0 ? 0 : n - 1);
}

/* first   the first block (x, y, z) of the launch
 * bounds  float4 per block: largest curvature (value per voxel^2), largest slope (value per voxel), lowest and highest
 *         value; zeros and lowest > highest for a dropped block or one without a finite value
 */
__kernel void block_bounds(__global const uchar *restrict volume, __constant const View *restrict view,
                           BLOCK_PARAMETERS, int4 first, __global float4 *restrict bounds)
{
  const BlockVolume held = BLOCK_VOLUME;
  const BlockVolume *v = &held;
  const int bx = get_global_id(0) + first.x, by = get_global_id(1) + first.y, bz = get_global_id(2) + first.z;
  __global float4 *out = bounds + ((size_t)bz * blocks->count.y + by) * blocks->count.x + bx;
  *out = (float4)(0.0f, 0.0f, INFINITY, -INFINITY);
  const Record own = fetch_record(v, bx, by, bz);
  const int code = code_of(&own);
  if (code == CODE_DROPPED) return;
  const int s = 1 << (code - 1);
  const float edge = blocks->edge, spacing = edge / s;
  float slope = 0.0f, second = 0.0f, mixed = 0.0f, across = 0.0f, low = INFINITY, high = -INFINITY;
  for (int k = 0; k < s; ++k)
    for (int j = 0; j < s; ++j)
      for (int i = 0; i < s; ++i) {
        const float c = own_sample(v, &own, s, i, j, k);
        widen(c, &low, &high);
        const float px = i + 1 < s ? own_sample(v, &own, s, i + 1, j, k) : c;
        const float mx = i > 0 ? own_sample(v, &own, s, i - 1, j, k) : c;
        const float py = j + 1 < s ? own_sample(v, &own, s, i, j + 1, k) : c;
        const float my = j > 0 ? own_sample(v, &own, s, i, j - 1, k) : c;
        const float pz = k + 1 < s ? own_sample(v, &own, s, i, j, k + 1) : c;
        const float mz = k > 0 ? own_sample(v, &own, s, i, j, k - 1) : c;
        raise((px - c) / spacing, &slope), raise((py - c) / spacing, &slope), raise((pz - c) / spacing, &slope);
        const float per_area = 1.0f / (spacing * spacing);
        if (i > 0 && i + 1 < s) raise((px - 2.0f * c + mx) * per_area, &second);
        if (j > 0 && j + 1 < s) raise((py - 2.0f * c + my) * per_area, &second);
        if (k > 0 && k + 1 < s) raise((pz - 2.0f * c + mz) * per_area, &second);
        if (i + 1 < s && j + 1 < s) raise((own_sample(v, &own, s, i + 1, j + 1, k) - px - py + c) * per_area, &mixed);
        if (j + 1 < s && k + 1 < s) raise((own_sample(v, &own, s, i, j + 1, k + 1) - py - pz + c) * per_area, &mixed);
        if (k + 1 < s && i + 1 < s) raise((own_sample(v, &own, s, i + 1, j, k + 1) - pz - px + c) * per_area, &mixed);
      }
#if INTERBLOCK
  for (int dz = -1; dz <= 1; ++dz)
    for (int dy = -1; dy <= 1; ++dy)
      for (int dx = -1; dx <= 1; ++dx) {
        const int nx = bx + dx, ny = by + dy, nz = bz + dz;
        if (!(dx || dy || dz) || nx < 0 || ny < 0 || nz < 0) continue;
        if (nx >= blocks->count.x || ny >= blocks->count.y || nz >= blocks->count.z) continue;
        const Record other = fetch_record(v, nx, ny, nz);
        const int beyond = code_of(&other);
        const int t = beyond == CODE_DROPPED ? 1 : 1 << (beyond - 1);
        /* The blend is as wide as the finer one's spacing; a dropped block's value is met at the face. */
        const float distance = beyond == CODE_DROPPED ? 0.5f * spacing : fmin(spacing, edge / t);
        /* At the samples of both that are nearest to the face, edge or corner between them, the other's value there. */
        for (int side = 0; side < 2; ++side) {
          const int n = side ? t : s, sign = side ? -1 : 1;
          const int2 is = outermost(sign * dx, n), js = outermost(sign * dy, n), ks = outermost(sign * dz, n);
          const float wide = edge / n, x0 = edge * (side ? nx : bx), y0 = edge * (side ? ny : by);
          const float z0 = edge * (side ? nz : bz);
          for (int k = ks.x; k <= ks.y; ++k)
            for (int j = js.x; j <= js.y; ++j)
              for (int i = is.x; i <= is.y; ++i) {
                const BlockPlace sample = place_in_block(v, side ? &own : &other, x0 + wide * (i + 0.5f),
                                                         y0 + wide * (j + 0.5f),
                                                          z0 + wide * (k + 0.5f));
                const float there = value_in_block(v, &sample);
                const float here = t == 1 && side ? as_float(other.word0)
                    : own_sample(v, side ? &other : &own, n, i, j, k);
                widen(there, &low, &high), widen(here, &low, &high);
                raise((there - here) / distance, &slope);
                if (abs(dx) + abs(dy) + abs(dz) == 1) raise((there - here) / (distance * distance), &across);
              }
        }
      }
#endif
  *out = (float4)(fmax(second, across) + mixed, slope, low, high);
}
