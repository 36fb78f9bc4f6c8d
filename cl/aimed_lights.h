/* Lights that depend on the angle to their direction: spots, and images that are projected as by a slide projector
 * (Segal et al. 1992; Engel and Ertl 2002, section 5.4, have both in the light buffer of half-angle slices).
 *
 * In scenes with such a light all lights have LIGHT_ROWS items (clvol/device/aimed_lights.py); those of others are 0:
 *   2  direction (local, of unit length); of a spot in w the edge of its cone, q
 *   3  of an image its right, divided by the tangent of half its width; of a spot in w 1 / (what q fades over)
 *   4  of an image its downwards, divided by the tangent of half its height; in w its first texel in `environment`
 *   5  of an image its width and height in texels
 *
 * q is 4 sin^2(angle / 2), the square of the chord between two unit vectors: unlike a cosine it resolves small angles
 * in single precision. A spot's light is a smooth step of q.
 */
#ifndef AIMED_LIGHTS_H
#define AIMED_LIGHTS_H

#include "effects.h"
#include "features.h"
#include "lanes.h"
#include "scene.h"

#if AIMED_LIGHTS

INLINE floatN spot_share(Vectors along, float4 direction, float inverse)
{
  const Vectors chord = {along.x - direction.x, along.y - direction.y, along.z - direction.z};
  const floatN t = lane_clamp((direction.w - dot3(chord, chord)) * inverse, (floatN)0.0f, (floatN)1.0f);
  return t * t * (3.0f - 2.0f * t);
}

INLINE floatN image_channel(__global const float *texels, intN a, intN b, intN c, intN d, floatN fx, floatN fy)
{
  const floatN va = AS_FLOAT(gather4(texels, a)), vc = AS_FLOAT(gather4(texels, c));
  const floatN upper = va + fx * (AS_FLOAT(gather4(texels, b)) - va);
  const floatN lower = vc + fx * (AS_FLOAT(gather4(texels, d)) - vc);
  return upper + fy * (lower - upper);
}

INLINE Vectors image_share(const Scene *scene, int item, Vectors along)
{
  const float4 right = scene->items[item + 3], down = scene->items[item + 4], size = scene->items[item + 5];
  const floatN ahead = dot3(along, broadcast3(scene->items[item + 2]));
  const intN before = MASK(ahead > 0.0f);
  const floatN inverse = 1.0f / select((floatN)1.0f, ahead, before), zero = 0.0f;
  const floatN u = dot3(along, broadcast3(right)) * inverse, v = dot3(along, broadcast3(down)) * inverse;
  const intN lit = before & MASK(fabs(u) <= 1.0f) & MASK(fabs(v) <= 1.0f);
  const floatN x = lane_clamp((u * 0.5f + 0.5f) * size.x - 0.5f, zero, (floatN)(size.x - 1.0f));
  const floatN y = lane_clamp((v * 0.5f + 0.5f) * size.y - 0.5f, zero, (floatN)(size.y - 1.0f));
  const int width = (int)size.x, height = (int)size.y;
  /* What is not lit is not used, but has to be fetched from somewhere. */
  const intN i = select((intN)0, TO_INT(x), lit), j = select((intN)0, TO_INT(y), lit);
  const intN beside = min(i + 1, (intN)(width - 1)), beneath = min(j + 1, (intN)(height - 1)) * width;
  const floatN fx = x - TO_FLOAT(i), fy = y - TO_FLOAT(j);
  const intN a = 4 * (j * width + i), b = 4 * (j * width + beside), c = 4 * (beneath + i), d = 4 * (beneath + beside);
  __global const float *texels = (__global const float *)(scene->environment + (int)down.w);
  Vectors share = {image_channel(texels, a, b, c, d, fx, fy), image_channel(texels + 1, a, b, c, d, fx, fy),
                   image_channel(texels + 2, a, b, c, d, fx, fy)};
  const Vectors none = {0.0f, 0.0f, 0.0f};
  return select3(none, share, lit);
}

/* The share of a light, colour by colour, that its direction leaves. item: its first one; towards: unit vector to the
 * light, or of length 0 at the light itself, which gets none of an image and little of a spot. */
INLINE Vectors aimed_share(const Scene *scene, int item, float kind, Vectors towards)
{
  Vectors share = {1.0f, 1.0f, 1.0f};
  const Vectors along = scaled3(towards, -1.0f);
  if (kind == LIGHT_SPOT) {
    share.x = spot_share(along, scene->items[item + 2], scene->items[item + 3].w);
    share.y = share.z = share.x;
  }
  if (kind == LIGHT_IMAGE) share = image_share(scene, item, along);
  return share;
}

#endif

#endif
