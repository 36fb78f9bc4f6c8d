/* Samples at places along a packet's rays, counted from where they enter, in steps. */
#ifndef ALONG_RAYS_H
#define ALONG_RAYS_H

#include "classify.h"
#include "features.h"
#include "half_opacity.h"
#include "lanes.h"
#include "rays.h"
#include "sample_volume.h"
#include "tally.h"
#include "view.h"

INLINE FetchedSample fetch_along(__global const uchar *volume, __constant const View *view, const Rays *ray, floatN t)
{
  return fetch_sample(volume, view, ray->x0 + t * ray->dx, ray->y0 + t * ray->dy, ray->z0 + t * ray->dz);
}

/* Counts how levels are used by `samples` samples of each ray, from t on, a step apart; none without levels. */
#if MINIFICATION
INLINE void count_levels_along(Tally *counted, __constant const View *view, const Rays *ray, floatN t, intN samples)
{
  const int most = -least_lane(-samples);
  for (int k = 0; k < most; ++k, t += 1.0f)
    count_levels(counted, view, ray->x0 + t * ray->dx, ray->y0 + t * ray->dy, ray->z0 + t * ray->dz, MASK(k < samples));
}
#define COUNT_LEVELS(ray, t, samples) count_levels_along(counted, view, ray, t, samples)
#else
#define COUNT_LEVELS(ray, t, samples)
#endif

#if WITH_DEPTH && MIDPOINTS
/* Classifies both ends of the segment that is noted: midpoints have not seen them. Counts the samples in `taken`. */
INLINE void note_sampled_ends(HalfOpacity *half_, __global const uchar *volume, __global const float *table,
                              __constant const View *view, const Rays *ray, uintN *taken, Tally *counted)
{
  const intN noted = MASK(half_->from < INFINITY);
  if (!any_lane(noted)) return;
  floatN ends[2];
  _Pragma("unroll 1") for (int k = 0; k < 2; ++k) {
    const floatN t = select((floatN)0.0f, half_->from + (k ? half_->length : (floatN)0.0f), noted);
    const FetchedSample sample = fetch_along(volume, view, ray, t);
    *taken -= AS_UINT(noted);
    COUNT_LEVELS(ray, t, noted & 1);
#if CLASSIFICATION == CLASSIFICATION_POST
    const floatN value = sample_value(sample, view);
    ends[k] = depth_between(value, value, noted, (intN)0, table, view);
#else
    ends[k] = classified_emission(sample, view, table).d;
#endif
  }
  note_ends(half_, ends[0], ends[1]);
}
#endif

#endif
