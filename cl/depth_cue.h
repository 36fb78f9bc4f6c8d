/* Depth cueing: colours go over to the cue's colour with their distance from the eye. */
#ifndef DEPTH_CUE_H
#define DEPTH_CUE_H

#include "lanes.h"
#include "scene.h"

/* c (times `depth`) at a distance from the eye (edges), towards the cue's colour. */
INLINE Vectors cued_color(const Scene *scene, Vectors color, floatN depth, floatN distance)
{
  __constant const Effects *e = scene->effects;
  const floatN share = e->cue_strength * lane_clamp((distance - e->cue_start) * e->cue_per_edge, (floatN)0.0f,
                                                    (floatN)1.0f);
  const Vectors cued = {color.x + share * (e->cue_color.x * depth - color.x),
                        color.y + share * (e->cue_color.y * depth - color.y),
                        color.z + share * (e->cue_color.z * depth - color.z)};
  return cued;
}

#endif
