/* The inner loop of the ray caster, taken apart. Each kernel walks the same rays in the same packets as cl/raycast.cl does for
 * pre-integrated classification, without skipping and without stopping: values at 0, 1, ..., n and the exit.
 *
 *   sum_samples  reconstructs the volume there, fetching two steps ahead, and sums; nothing is classified or composited
 *   sum_gathers  only the gathers that a reconstruction needs, from 16 KiB: what the machine can do at best
 *
 * Switches as in cl/raycast.cl.
 */
#include "lanes.h"
#include "view.h"
#include "rays.h"
#include "sample_volume.h"

#ifndef MARCH_STEPS
#define MARCH_STEPS 8
#endif

#if VOXEL_BITS == 8
#define GATHERS 2
#elif VOXEL_BITS == 16
#define GATHERS 4
#elif VOXEL_BITS == 32
#define GATHERS 8
#else
#error "no gathers for this voxel type"
#endif

#define L1_WORDS 1024 /* 4 KiB for each of up to four gathers, 16 KiB in all */

#define RAYS_OF_TILE(BEGIN, BODY, END)                                                                              \
  const int tile_x = (int)get_global_id(0), tile_y = (int)get_global_id(1);                               \
  const int width = view->image.x, height = view->image.y;                                                \
  const int left = tile_x * view->tile.x, top = tile_y * view->tile.y;                                  \
  for (int row = top; row < min(top + view->tile.y, height); row += PACKET_H)                            \
    for (int column = left; column < min(left + view->tile.x, width); column += PACKET_W) {              \
      const intN lane = LANE_INDEX;                                                                       \
      const intN px = column + (lane & (PACKET_W - 1)), py = row + lane / PACKET_W;                       \
      const Rays ray = make_rays(view, TO_FLOAT(px), TO_FLOAT(py));                                       \
      const floatN whole = floor(ray.length), rest = ray.length - whole;                                  \
      const intN hits = MASK(ray.length >= 0.0f) & MASK(px < width) & MASK(py < height);                  \
      const intN last = select((intN)-2, TO_INT(whole), hits);                                            \
      intN i = 0;                                                                                         \
      while (any_lane(MASK(i <= last))) {                                                                 \
        BEGIN                                                                                             \
        for (int step = 0; step < MARCH_STEPS; ++step) {                                                  \
          const intN active = MASK(i <= last);                                                            \
          const floatN t = TO_FLOAT(i);                                                                   \
          BODY                                                                                            \
          taken -= AS_UINT(active);                                                                       \
          i -= active;                                                                                    \
        }                                                                                                 \
      }                                                                                                   \
      const intN active = hits & MASK(rest > 0.0f);                                                       \
      const floatN t = ray.length;                                                                        \
      END                                                                                                 \
      taken -= AS_UINT(active);                                                                           \
    }

#define STORE_TOTALS(sum)                                                                                 \
  {                                                                                                       \
    float total_[LANES];                                                                                  \
    uint taken_[LANES];                                                                                   \
    STORE_LANES(sum, total_), STORE_LANES(taken, taken_);                                                 \
    const size_t tile = (size_t)tile_y * get_global_size(0) + tile_x;                                     \
    sums[tile] = 0.0f, samples[tile] = 0;                                                                 \
    EACH_LANE(k) sums[tile] += total_[k], samples[tile] += taken_[k];                                     \
  }

INLINE FetchedSample fetch_along(__global const uchar *volume, __constant const View *view, const Rays *ray, floatN t)
{
  return fetch_sample(volume, view, ray->x0 + t * ray->dx, ray->y0 + t * ray->dy, ray->z0 + t * ray->dz);
}

__kernel WIDE_VECTORS void sum_samples(__global const uchar *restrict volume, __constant const View *restrict view,
                                       __global float *restrict sums, __global uint *restrict samples)
{
  floatN sum = 0.0f;
  uintN taken = 0;
  RAYS_OF_TILE(
    FetchedSample ahead = fetch_along(volume, view, &ray, TO_FLOAT(i));
    FetchedSample ahead2 = fetch_along(volume, view, &ray, TO_FLOAT(i) + 1.0f);
    , const FetchedSample sample = ahead; ahead = ahead2; ahead2 = fetch_along(volume, view, &ray, t + 2.0f);
    sum += select((floatN)0.0f, sample_value(sample, view), active);
    , sum += select((floatN)0.0f, sample_value(fetch_along(volume, view, &ray, t), view), active);)
  STORE_TOTALS(sum)
}

INLINE uintN gathers(__global const uchar *volume, intN at)
{
  uintN sum = 0;
  for (int g = 0; g < GATHERS; ++g) sum += gather4(volume + 4 * L1_WORDS * (g & 3), at);
  return sum;
}

/* Offsets that differ from lane to lane and from sample to sample, by one addition and one mask. */
__kernel WIDE_VECTORS void sum_gathers(__global const uchar *restrict volume, __constant const View *restrict view,
                                       __global float *restrict sums, __global uint *restrict samples)
{
  uintN sum = 0, taken = 0;
  const intN first = LANE_INDEX * 37;
  RAYS_OF_TILE(, (void)t; sum += gathers(volume, (first + i * 11) & (L1_WORDS - 1));
               , (void)t; sum += gathers(volume, (first + i * 11) & (L1_WORDS - 1));)
  STORE_TOTALS(TO_FLOAT(AS_INT(sum)))
}
