/* Fills a light volume: for each point of a grid over the volume the share of one light that arrives there, by the
 * march of shadow.h.
 *
 * SCATTERING: S = (1 - s) T + s T_cone, with T_cone the mean over CONE directions in a cone about that to the light of
 * exp(-(1 - colour) D). It stands for light that is scattered forward on its way: what a cone of light brings, of
 * which a share `colour` of all that is taken out of each ray scatters on within the cone. Kniss et al. (2003) sweep
 * such a cone through the volume slice by slice (half-angle slicing), light that left one ray going on along others;
 * here each ray goes straight to the light. So this lacks light that turns by more than the cone's angle, and multiple
 * scattering round an opaque obstacle wider than the cone. Energy is not conserved, but never exceeds the light's own.
 *
 * TINTED_SCATTERING: noise is added to the shares 1 - colour, a channel to each (Engel and Ertl 2002, section 10).
 *
 * Switches (-D): those of the picture.
 */
#include "light_cells.h"
#include "render_packet.h"

#if SHADOWS == SHADOWS_VOLUME

/* Unit vectors across `axis`, which is one too. */
INLINE void axes_across(Vectors axis, Vectors *u, Vectors *v)
{
  const intN along_x = MASK(fabs(axis.x) >= 0.9f);
  const floatN zero = 0.0f, one = 1.0f;
  const floatN ox = select(one, zero, along_x), oy = select(zero, one, along_x); /* x or y */
  u->x = oy * axis.z, u->y = -ox * axis.z, u->z = ox * axis.y - oy * axis.x;
  *u = unit3(*u);
  v->x = axis.y * u->z - axis.z * u->y, v->y = axis.z * u->x - axis.x * u->z, v->z = axis.x * u->y - axis.y * u->x;
}

#if TINTED_SCATTERING
/* Shares of the extinction that attenuate red, green and blue at a lattice place, with noise, 0 .. 1. */
INLINE Vectors tinted_shares(const Scene *scene, Vectors place, Vectors less)
{
  __constant const Effects *e = scene->effects;
  const floatN zero = 0.0f, one = 1.0f;
  __constant const NoiseTerm *terms = e->noise_terms + e->added_terms + e->moving_terms;
  _Pragma("unroll 1") for (int k = 0; k < e->tinting_terms; ++k) {
    __constant const NoiseTerm *term = terms + k;
    Vectors sum;
    fractal_noise(scene->noise, term, place.x * term->scale.x, place.y * term->scale.y, place.z * term->scale.z,
                  &sum.x, &sum.y, &sum.z);
    less = sum3(less, scaled3(sum, term->value_amplitude));
  }
  const Vectors within = {lane_clamp(less.x, zero, one), lane_clamp(less.y, zero, one), lane_clamp(less.z, zero, one)};
  return within;
}
#endif

/* cone     float4 [1 + directions]: (1 - colour, directions), then unit vectors about +z, w 0
 * arrives  float [points of all lights, LIGHT_CHANNELS]: rgb, or one number without scattering
 * samples  uint [work-items]: reconstructions of the volume
 * light    which one of all lights; number: which one among those that cast shadows; first: point of this launch
 */
__kernel WIDE_VECTORS void light_volume(SCENE_PARAMETERS, __global const float4 *restrict cone,
                                        int light, int number, int first, __global float *restrict arrives,
                                        __global uint *restrict samples)
{
  const int4 size = effects->light_size;
  const int points = size.x * size.y * size.z, item = get_global_id(0) + first / LANES;
  if (item * LANES >= points) return;
  Tally counted[SCENE_COUNTERS] = {0};
  const Scene scene_ = SCENE;
  const Scene *scene = &scene_;
  const intN point = min(item * LANES + LANE_INDEX, (intN)(points - 1));
  const Vectors place = grid_place(view, size, point);
  const Vectors here = to_local(effects, place.x, place.y, place.z);
  const float4 at = items[effects->first_light + LIGHT_ROWS * light];
  const floatN reach = distance_to_light(at, here);
  Vectors towards = broadcast3(at);
  if (light_has_place(at)) {
    const Vectors way = {at.x - here.x, at.y - here.y, at.z - here.z};
    towards = unit3(way);
  }
  const intN all = MASK(item * LANES + LANE_INDEX < points);
  Vectors u, v;
  axes_across(towards, &u, &v);
  const float4 shares = cone[0];
  Vectors less = broadcast3(shares);
#if TINTED_SCATTERING
  less = tinted_shares(scene, place, less);
#endif
  const int directions = SCATTERING ? (int)shares.w : 0;
  floatN straight = 1.0f;
  Vectors scattered = {0.0f, 0.0f, 0.0f};
  _Pragma("unroll 1") for (int k = 0; k <= directions; ++k) {
    const float4 c = cone[k];
    const Vectors turned = sum3(sum3(scaled3(u, c.x), scaled3(v, c.y)), scaled3(towards, c.z));
    const floatN depth = depth_towards(scene, place, k ? turned : towards, reach, all, counted);
    if (k == 0) {
      straight = 1.0f - opacity_of_depth(depth);
    } else {
      scattered.x += 1.0f - opacity_of_depth(less.x * depth);
      scattered.y += 1.0f - opacity_of_depth(less.y * depth);
      scattered.z += 1.0f - opacity_of_depth(less.z * depth);
    }
  }
  const float s = SCATTERING ? effects->scattering : 0.0f, mean = s / (float)max(directions, 1);
  float r[LANES], g[LANES], b[LANES];
  STORE_LANES((1.0f - s) * straight + mean * scattered.x, r);
  STORE_LANES((1.0f - s) * straight + mean * scattered.y, g);
  STORE_LANES((1.0f - s) * straight + mean * scattered.z, b);
  EACH_LANE_ROLLED(k)
  {
    const int p = item * LANES + k;
    if (p >= points) continue;
    __global float *out = arrives + ((size_t)number * points + p) * LIGHT_CHANNELS;
    out[0] = r[k];
#if SCATTERING
    out[1] = g[k], out[2] = b[k], out[3] = 0.0f;
#endif
  }
  samples[item] = tally_sum(counted[COUNT_SHADOW_SAMPLES]);
}

#endif
