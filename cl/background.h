/* The environment as a background. */
#ifndef BACKGROUND_H
#define BACKGROUND_H

#include "composite.h"
#include "emission.h"
#include "environment.h"
#include "scene.h"

/* What is left of the rays on the picture sees the environment. */
INLINE void show_environment(const Scene *scene, Vectors forward, intN on_picture, Gathered *acc)
{
  __constant const Effects *e = scene->effects;
  Vectors seen;
  environment_look_up(scene->environment + e->sky_map, e->sky_map_size, forward.x, forward.y, forward.z, &seen.x,
                      &seen.y,
                      &seen.z);
  const floatN left = select((floatN)0.0f, 1.0f - acc->a, on_picture);
  acc->r += left * seen.x, acc->g += left * seen.y, acc->b += left * seen.z;
  acc->a = select(acc->a, (floatN)1.0f, on_picture);
}

#endif
