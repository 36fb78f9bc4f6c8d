/* The light of half-angle slabs (half_angle.h): what of it arrives at a place, and where a ray crosses the slabs.
 *
 * light_volume  float [texels / 16, slabs, 16, LIGHT_CHANNELS], texels row by row: the share of the light in each slab,
 *               linear between texels. A slab has one value along each ray of the light: that in its middle, or in
 *               front of it. What a ray of the light or of the eye goes through lies together.
 */
#ifndef SLICE_LIGHT_H
#define SLICE_LIGHT_H

#include "half_angle.h"
#include "lanes.h"
#include "sample_volume.h"
#include "scene.h"
#include "vectors.h"

/* Of a row of `(x, y, z, 1)` with a lattice point. */
INLINE floatN of_point(float4 row, Vectors p) { return row.x * p.x + row.y * p.y + row.z * p.z + row.w; }

/* A ray's way through the slabs, in its own unit of length, from its entry on. */
typedef struct {
  floatN start;   /* number of the slab that the ray enters in, */
  floatN forward; /* and whether numbers go up along it: 1 or -1 */
  floatN end;     /* where it leaves that slab, */
  floatN gap;     /* and how long it is in each of those that follow */
} RaySlabs;

/* Slabs that a ray is in for longer than this many units are one to it. */
#define LONGEST_GAP 1e9f

INLINE RaySlabs slabs_of(__constant const HalfAngle *half_angle, Vectors from, Vectors direction)
{
  const float4 across = half_angle->across;
  const floatN at = of_point(across, from), last = (float)(half_angle->size.z - 1);
  const floatN speed = across.x * direction.x + across.y * direction.y + across.z * direction.z;
  const intN crosses = MASK(fabs(speed) > 1.0f / LONGEST_GAP), up = MASK(speed > 0.0f);
  RaySlabs s;
  s.start = lane_clamp(floor(at), (floatN)0.0f, last);
  s.forward = select((floatN)-1.0f, (floatN)1.0f, up);
  s.gap = select((floatN)LONGEST_GAP, 1.0f / fabs(select((floatN)1.0f, speed, crosses)), crosses);
  const floatN ahead = select(at - s.start, s.start + 1.0f - at, up);
  s.end = select((floatN)LONGEST_GAP, lane_max(ahead, (floatN)0.0f) * s.gap, crosses);
  return s;
}

#if SHADOWS == SHADOWS_HALF_ANGLE

/* Where a texel's light in a slab begins in the light volume. */
INLINE intN slab_texel(intN texel, intN slab, int slabs)
{
  return LIGHT_CHANNELS * (((((texel >> 4) * slabs) + slab) << 4) + (texel & 15));
}

/* One channel, between four texels, which begin at these floats. */
INLINE floatN light_of_texels(__global const float *light, intN at00, intN at10, intN at01, intN at11, floatN fx,
                              floatN fy)
{
  const floatN a = AS_FLOAT(gather4(light, at00)), b = AS_FLOAT(gather4(light, at10));
  const floatN c = AS_FLOAT(gather4(light, at01)), d = AS_FLOAT(gather4(light, at11));
  const floatN near = a + fx * (b - a), far = c + fx * (d - c);
  return near + fy * (far - near);
}

INLINE Vectors light_of_slab(const Scene *scene, Vectors place)
{
  __constant const HalfAngle *half_angle = scene->half_angle;
  const int4 size = half_angle->size;
  const floatN zero = 0.0f, w = 1.0f / of_point(half_angle->light_w, place);
  const floatN x = lane_clamp(of_point(half_angle->light_x, place) * w, zero, (floatN)(float)(size.x - 1));
  const floatN y = lane_clamp(of_point(half_angle->light_y, place) * w, zero, (floatN)(float)(size.y - 1));
  const floatN slab = floor(lane_clamp(of_point(half_angle->across, place), zero, (floatN)(float)(size.z - 1)));
  const intN ix = cell_index(x, size.x), iy = cell_index(y, size.y);
  const floatN fx = x - TO_FLOAT(ix), fy = y - TO_FLOAT(iy);
  const intN texel = iy * size.x + ix, k = TO_INT(slab);
  const intN at00 = slab_texel(texel, k, size.z), at10 = slab_texel(texel + 1, k, size.z);
  const intN at01 = slab_texel(texel + size.x, k, size.z), at11 = slab_texel(texel + size.x + 1, k, size.z);
  __global const float *light = (__global const float *)scene->light_volume;
  Vectors share;
  share.x = light_of_texels(light, at00, at10, at01, at11, fx, fy);
#if SCATTERING
  share.y = light_of_texels(light + 1, at00, at10, at01, at11, fx, fy);
  share.z = light_of_texels(light + 2, at00, at10, at01, at11, fx, fy);
#else
  share.y = share.z = share.x;
#endif
  return share;
}

#endif

#endif
