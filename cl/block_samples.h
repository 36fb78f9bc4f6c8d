/* Single samples of a block, for kernels that look at all of them (LANES 1). */
#ifndef BLOCK_SAMPLES_H
#define BLOCK_SAMPLES_H

#include "blocks.h"
#include "lanes.h"

/* One sample as kernels compute with it. */
inline float sample_of(const BlockVolume *v, const Record *r, int at)
{
  __global const uchar *samples = v->samples[0];
#if SAMPLE_BUFFERS > 1
  samples = v->samples[(r->word1 >> 4) & 3];
#endif
  at += (int)r->word0;
#if VOXEL_BITS == 8 && VOXEL_SIGNED
  return (float)((__global const char *)samples)[at];
#elif VOXEL_BITS == 8
  return (float)samples[at];
#elif VOXEL_BITS == 16 && VOXEL_SIGNED
  return (float)((__global const short *)samples)[at];
#elif VOXEL_BITS == 16
  return (float)((__global const ushort *)samples)[at];
#elif VOXEL_SCALED
  return ((__global const float *)samples)[at] * v->view->voxel_gain;
#else
  return ((__global const float *)samples)[at];
#endif
}

/* Sample (i, j, k) along x, y, z of a block of s^3; a block of one sample has it in the index. */
inline float own_sample(const BlockVolume *v, const Record *r, int s, int i, int j, int k)
{
  return s == 1 ? as_float(r->word0) : sample_of(v, r, (k * s + j) * s + i);
}

/* First and last sample of `s` an axis that interpolation from `low` to `high` (places in the block) uses. */
inline int2 samples_between(float low, float high, int s, float edge)
{
  const float scale = s / edge, top = s - 1;
  return (int2)((int)floor(clamp(low * scale - 0.5f, 0.0f, top)), (int)ceil(clamp(high * scale - 0.5f, 0.0f, top)));
}

inline void widen(float value, float *low, float *high)
{
  if (!isfinite(value)) return;
  *low = fmin(*low, value), *high = fmax(*high, value);
}

#endif
