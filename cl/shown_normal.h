/* The normal by which a sample of the volume is lit. */
#ifndef SHOWN_NORMAL_H
#define SHOWN_NORMAL_H

#include "effects.h"
#include "lanes.h"
#include "scene.h"
#include "vectors.h"

/* The normal of what the gradient belongs to; at a cut face the face's own, going over to the gradient's within one
 * edge. `inside`: edges from the start of the stretch. */
INLINE Vectors shown_normal(const Scene *scene, Vectors gradient, Vectors cut_normal, floatN inside)
{
  Vectors normal = directed3(gradient, -1.0f);
#if CLIP || CUT_FACES
  inside = lane_clamp(inside, (floatN)0.0f, (floatN)1.0f);
  const intN cut = MASK(dot3(cut_normal, cut_normal) > 0.5f) & MASK(inside < 1.0f);
  if (any_lane(cut)) {
    const intN two_sided = scene->effects->two_sided ? (intN)-1 : (intN)0;
    const intN behind = two_sided & MASK(dot3(normal, cut_normal) < 0.0f);
    const Vectors toward = select3(normal, scaled3(normal, -1.0f), behind);
    normal = select3(normal, unit3(sum3(scaled3(toward, inside), scaled3(cut_normal, 1.0f - inside))), cut);
  }
#endif
  return normal;
}

#endif
