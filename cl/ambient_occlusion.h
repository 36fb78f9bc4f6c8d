/* Ambient occlusion: what light from all around is left at a place, where matter nearby takes some.
 *
 * Along a ray of transmittance T, matter at a distance s takes part in proportion to 1 - s / reach, so that what is
 * just within reach and what is just beyond it look alike: V = 1 - sum of (fall of T) (1 - s / reach) (obscurance,
 * Zhukov et al. 1998; of volumes with their opacities, Hernell et al. 2010). occlusion_volume.cl finds V for rays
 * evenly over the sphere, from the points of a grid, and keeps their mean m and the mean w of V times the direction.
 * These are the first two bands of V in spherical harmonics, and what they say of the light on a surface of normal n,
 * weighed by the cosine, is m + 2 n.w (Ramamoorthi and Hanrahan 2001): 1 before a wall, 0 behind one, which are exact;
 * at most 1/8 off for any V of 0 and 1. Where there is no normal, that of the surface which gets most is taken:
 * m + 2 |w|.
 *
 * AMBIENT_OCCLUSION says what it darkens. In a scene without lights that is its colours.
 */
#ifndef AMBIENT_OCCLUSION_H
#define AMBIENT_OCCLUSION_H

#include "light_cells.h"
#include "scene.h"
#include "vectors.h"

#define OCCLUSION_CHANNELS 4 /* floats per point: m, w */

typedef struct {
  floatN mean;
  Vectors way; /* local */
} AmbientLight;

INLINE AmbientLight ambient_light(const Scene *scene, Vectors place)
{
  __constant const Effects *e = scene->effects;
  const LightCell c = light_cell(place.x, place.y, place.z, e->occlusion_grid, e->occlusion_size, OCCLUSION_CHANNELS);
  __global const float *points = (__global const float *)scene->occlusion;
  AmbientLight light;
  light.mean = light_between(points, c, OCCLUSION_CHANNELS);
  light.way.x = light_between(points + 1, c, OCCLUSION_CHANNELS);
  light.way.y = light_between(points + 2, c, OCCLUSION_CHANNELS);
  light.way.z = light_between(points + 3, c, OCCLUSION_CHANNELS);
  return light;
}

INLINE floatN ambient_share(const Scene *scene, floatN mean, floatN along)
{
  const floatN seen = lane_clamp(mean + 2.0f * along, (floatN)0.0f, (floatN)1.0f);
  return 1.0f - scene->effects->occlusion_grid.w * (1.0f - seen);
}

/* What is left of the light on a surface of this normal (local, of unit length). */
INLINE floatN ambient_share_on(const Scene *scene, AmbientLight light, Vectors normal)
{
  return ambient_share(scene, light.mean, dot3(light.way, normal));
}

/* What is left of it where there is no normal. */
INLINE floatN ambient_share_at(const Scene *scene, AmbientLight light)
{
  return ambient_share(scene, light.mean, sqrt(dot3(light.way, light.way)));
}

/* A colour that nothing else lights; on a surface, of this normal, where there is one. */
INLINE Vectors occluded_color(const Scene *scene, Vectors color, Vectors place)
{
  return scaled3(color, ambient_share_at(scene, ambient_light(scene, place)));
}

INLINE Vectors occluded_surface(const Scene *scene, Vectors color, Vectors place, Vectors normal, intN has_normal)
{
  const Vectors beyond = beyond_surface(scene->effects, place, normal, scene->effects->occlusion_grid);
  const AmbientLight light = ambient_light(scene, select3(place, beyond, has_normal));
  return scaled3(color, select(ambient_share_at(scene, light), ambient_share_on(scene, light, normal), has_normal));
}

#endif
