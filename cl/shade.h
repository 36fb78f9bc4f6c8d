/* Light on samples and surfaces: Blinn's variant of Phong's model (Blinn 1977; Engel and Ertl 2002, section 9), any
 * number of lights.
 *
 *   lit = c (ambient + diffuse sum I max(N.L, 0)) + specular sum I max(N.H, 0)^shininess,   N = -gradient / |gradient|
 *
 * Lights are two items each: direction to the light (directional) or place (point), and in w its kind; colour times
 * intensity, and in w its number in the light volume, or -1. Spots and images have more (aimed_lights.h). A headlight
 * shines from the eye, so that L is V for every ray. Where the gradient has no direction nothing is shaded: c stays as it
 * is.
 */
#ifndef SHADE_H
#define SHADE_H

#include "effects.h"
#include "features.h"
#include "lanes.h"
#include "power.h"
#include "scene.h"
#include "tally.h"

#if LIGHTING

#if GRADIENT
#include "gradient.h"
#endif
#if ENVIRONMENT
#include "environment.h"
#endif
#if AIMED_LIGHTS
#include "aimed_lights.h"
#endif
#if SHADOWS
#include "shadow.h"
#endif
#if AMBIENT_OCCLUSION
#include "ambient_occlusion.h"
#endif

/* Factors of colour and what is added to it: lit = c * diffuse + specular. */
typedef struct {
  Vectors diffuse, specular;
} Illumination;

/* place: lattice; normal, view (to the eye): local, of unit length; weight: what the sample counts for at most, and
 * whether it is on a surface: for shadows. */
INLINE Illumination illuminate(const Scene *scene, Vectors place, Vectors normal, Vectors view, floatN weight,
                               int on_surface,
                               intN active, Tally *counted)
{
  __constant const Effects *e = scene->effects;
  Illumination lit;
  floatN facing = dot3(normal, view);
  const intN turned = MASK(facing < 0.0f) & (e->two_sided ? (intN)-1 : (intN)0);
  normal = select3(normal, scaled3(normal, -1.0f), turned);
  facing = select(facing, -facing, turned);
  const intN lightable = active & MASK(facing >= 0.0f); /* a back face gets no light but the ambient one */
#if AMBIENT_OCCLUSION
  const Vectors open = on_surface ? beyond_surface(e, place, normal, e->occlusion_grid) : place;
  const floatN seen = ambient_share_on(scene, ambient_light(scene, open), normal);
  lit.diffuse.x = lit.diffuse.y = lit.diffuse.z = e->ambient * (AMBIENT_OCCLUSION == DARKENS_AMBIENT ? seen : 1.0f);
#else
  lit.diffuse.x = lit.diffuse.y = lit.diffuse.z = e->ambient;
#endif
  lit.specular.x = lit.specular.y = lit.specular.z = 0.0f;
#if LIGHTS
  const Vectors lit_place = place;
#if SHADOWS == SHADOWS_VOLUME && ISOSURFACES
  if (on_surface) place = beyond_surface(e, place, normal, e->light_grid);
#endif
  _Pragma("unroll 1") for (int k = 0; k < e->light_count; ++k) {
    const int item = e->first_light + LIGHT_ROWS * k;
    const float4 at = scene->items[item], intensity = scene->items[item + 1];
    Vectors towards = broadcast3(at);
    if (light_has_place(at)) {
      const Vectors here = to_local(e, lit_place.x, lit_place.y, lit_place.z);
      const Vectors from = {at.x - here.x, at.y - here.y, at.z - here.z};
      towards = unit3(from);
    }
    if (at.w == LIGHT_HEADLIGHT) towards = view;
    const floatN cosine = lane_max(dot3(normal, towards), (floatN)0.0f);
    intN faces = lightable & MASK(cosine > 0.0f);
    Vectors arriving = broadcast3(intensity);
#if AIMED_LIGHTS
    if (at.w >= LIGHT_SPOT) {
      const Vectors share = aimed_share(scene, item, at.w, towards);
      arriving.x *= share.x, arriving.y *= share.y, arriving.z *= share.z;
      faces &= MASK(share.x + share.y + share.z > 0.0f);
    }
#endif
    if (!any_lane(faces)) continue;
#if SHADOWS
    if (intensity.w >= 0.0f) {
      const Vectors shadow = light_that_arrives(scene, place, towards, at, (int)intensity.w, weight, faces, counted);
      arriving.x *= shadow.x, arriving.y *= shadow.y, arriving.z *= shadow.z;
    }
#endif
    const floatN diffuse = select((floatN)0.0f, e->diffuse * cosine, faces);
    lit.diffuse.x += diffuse * arriving.x, lit.diffuse.y += diffuse * arriving.y, lit.diffuse.z += diffuse * arriving.z;
#if SPECULAR
    /* N.H, with |L + V| = sqrt(2 + 2 L.V) */
    const floatN between = lane_max(2.0f + 2.0f * dot3(towards, view), (floatN)1e-12f);
    const floatN aligned = lane_clamp((cosine + facing) * lane_rsqrt(between), (floatN)0.0f, (floatN)1.0f);
    const floatN shine = select((floatN)0.0f, e->specular * lane_power(aligned, e->shininess), faces);
    lit.specular.x += shine * arriving.x, lit.specular.y += shine * arriving.y, lit.specular.z += shine * arriving.z;
#endif
  }
#endif
#if ENVIRONMENT
  Vectors from_all;
  environment_look_up(scene->environment + e->diffuse_map, e->diffuse_map_size, normal.x, normal.y, normal.z,
                      &from_all.x, &from_all.y,
                      &from_all.z);
#if AMBIENT_OCCLUSION == DARKENS_AMBIENT
  from_all = scaled3(from_all, seen);
#endif
  lit.diffuse = sum3(lit.diffuse, scaled3(from_all, e->diffuse));
#if SPECULAR
  const floatN twice = 2.0f * facing;
  environment_look_up(scene->environment + e->specular_map, e->specular_map_size, twice * normal.x - view.x,
                      twice * normal.y - view.y,
                      twice * normal.z - view.z, &from_all.x, &from_all.y, &from_all.z);
  lit.specular = sum3(lit.specular, scaled3(from_all, e->specular));
#endif
#endif
#if AMBIENT_OCCLUSION == DARKENS_ALL
  lit.diffuse = scaled3(lit.diffuse, seen), lit.specular = scaled3(lit.specular, seen);
#endif
  return lit;
}

/* c (times `depth`) in this light, where there is a normal; fading to the unlit colour where the gradient is short. */
INLINE Vectors in_light(const Scene *scene, Vectors color, Vectors unlit, floatN depth, Vectors gradient,
                        Illumination lit, intN active)
{
  Vectors shaded = {color.x * lit.diffuse.x + depth * lit.specular.x, color.y * lit.diffuse.y + depth * lit.specular.y,
                    color.z * lit.diffuse.z + depth * lit.specular.z};
  if (scene->effects->fade > 0.0f) {
    const floatN share = lane_min(sqrt(dot3(gradient, gradient)) * scene->effects->fade, (floatN)1.0f);
    shaded.x = unlit.x + share * (shaded.x - unlit.x), shaded.y = unlit.y + share * (shaded.y - unlit.y);
    shaded.z = unlit.z + share * (shaded.z - unlit.z);
  }
  return select3(unlit, shaded, active);
}

/* The same, and finds the light. */
INLINE Vectors shaded_color(const Scene *scene, Vectors color, floatN depth, Vectors place, Vectors normal,
                            Vectors gradient, Vectors view, floatN weight, int on_surface, intN active, Tally *counted)
{
#if AMBIENT_OCCLUSION
  const Vectors unlit = occluded_color(scene, color, place);
#else
  const Vectors unlit = color;
#endif
  if (!any_lane(active)) return unlit;
  count_lanes(&counted[COUNT_LIT_SAMPLES], active);
  const Illumination lit = illuminate(scene, place, normal, view, weight, on_surface, active, counted);
  return in_light(scene, color, unlit, depth, gradient, lit, active);
}

#endif

#endif
