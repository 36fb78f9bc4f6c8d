/* Sweeps the light through the slabs of half-angle slices (half_angle.h). A work-item has a packet of texels, each a
 * ray of the light, and goes from slab to slab along it: what a slab absorbs is classified as the eye's rays are.
 *
 * SCATTERING: S = (1 - s) T + s I. I is light that each slab hands on to the next one: the mean of what CONE
 * directions bring from the slab before, of which a slab lets exp(-(1 - colour) D) through (Kniss et al. 2003: a blur
 * of the light buffer per slice). What every slab spreads anew adds up as a random walk does, so that light spreads
 * with the root of the number of slabs, less the closer they lie.
 *
 * Switches (-D): those of the picture.
 */
#include "render_packet.h"

#if SHADOWS == SHADOWS_HALF_ANGLE

/* What is known of a texel's ray before a slab: the optical depth, and with SCATTERING I of three channels. */
#define CARRIED LIGHT_CHANNELS

/* Optical depth of the ray from t0 to t1 (edges) in one kept stretch. `known`: the value at t0, of the lanes in
 * `joined`; then that at t1. */
INLINE floatN depth_of_piece(const Scene *scene, const Rays *ray, Vectors direction, floatN t0, floatN t1, intN active,
                             floatN *known, intN *joined, Tally *counted)
{
#if CLASSIFICATION == CLASSIFICATION_PRE
  const floatN value = 0.0f;
  const SegmentValues v = {value, value};
#elif SHADOW_ENDS
  const intN unknown = active & ~*joined;
  if (any_lane(unknown)) {
    *known = select(*known, value_along(scene, ray, t0), unknown);
    count_lanes(&counted[COUNT_SHADOW_SAMPLES], unknown);
  }
  const SegmentValues v = {*known, value_along(scene, ray, t1)};
  *known = select(*known, v.back, active), *joined |= active;
#else
  const floatN value = value_along(scene, ray, 0.5f * (t0 + t1));
  const SegmentValues v = {value, value};
#endif
  count_lanes(&counted[COUNT_SHADOW_SAMPLES], active);
  const floatN length = select((floatN)0.0f, t1 - t0, active);
  return length * extinction_along(scene, ray, t0, t1, v, direction, active, counted);
}

/* view     the light's: its picture has the texels
 * cone     float4 [1 + directions]: (1 - colour, directions), then unit vectors about the way to the light, w 0
 * begin, end   the slabs of this launch; with SCATTERING one
 * first    texel of this launch
 * before   float [rows, columns, CARRIED]: what is known before slab `begin`, and `after` slab `end` - 1
 * lit      the light volume of slice_light.h
 * samples  uint [work-items]: reconstructions of the volume are added
 */
__kernel WIDE_VECTORS void light_slices(SCENE_PARAMETERS, __global const float4 *restrict cone, int begin, int end,
                                        int first, __global const float *restrict before,
                                        __global float *restrict after, __global float *restrict lit,
                                        __global uint *restrict samples)
{
  const int4 size = half_angle->size;
  const int texels = size.x * size.y, item = get_global_id(0) + first / LANES;
  if (item * LANES >= texels) return;
  const Scene scene_ = SCENE;
  const Scene *scene = &scene_;
  Tally counted[SCENE_COUNTERS] = {0};
  const intN texel = min(item * LANES + LANE_INDEX, (intN)(texels - 1));
  const intN row = texel / size.x, column = texel - row * size.x;
  const intN all = MASK(item * LANES + LANE_INDEX < texels);
  const Rays ray = make_rays_of_step(view, TO_FLOAT(column), TO_FLOAT(row), 1.0f);
  const Vectors entry = {ray.x0, ray.y0, ray.z0}, along = {ray.dx, ray.dy, ray.dz};
  const Vectors direction = scaled3(direction_to_local(effects, ray.dx, ray.dy, ray.dz), -1.0f);
  const intN hits = all & MASK(ray.length > 0.0f);
  const float4 across = half_angle->across;
  const floatN at = of_point(across, entry), one = 1.0f;
  const floatN speed = across.x * along.x + across.y * along.y + across.z * along.z;
  const floatN gap = 1.0f / select(one, speed, hits);
  /* The packet's, slab by slab. */
  __global float *out = lit + (size_t)LIGHT_CHANNELS * 16 * size.z * (item * LANES / 16);
  floatN depth = AS_FLOAT(gather4(before, CARRIED * texel));
#if SCATTERING
  const float4 less = cone[0];
  const int directions = (int)less.w, row_ = CARRIED * size.x;
  const floatN u = TO_FLOAT(column) - view->centre.x, v = TO_FLOAT(row) - view->centre.y;
  const floatN a = u * view->tangent.x, b = v * view->tangent.y, longer = sqrt(1.0f + a * a + b * b);
#endif
  floatN known = 0.0f; /* the value at `from`, of the lanes in joined */
  intN joined = 0;
#if SKIP_EMPTY
  floatN clear_to = -1.0f; /* nothing absorbs before */
#endif
#if LANES > 1 && !SCATTERING
  floatN through = 1.0f; /* what is left of the light */
#endif
#if CLIP
  Stretch kept;
  kept.enter = -1.0f, kept.leave = 0.0f;
  intN more = hits;
#endif
  _Pragma("unroll 1") for (int k = begin; k < end; ++k) {
    const floatN whole_from = ((float)k - at) * gap, whole_to = ((float)(k + 1) - at) * gap;
    const floatN zero = 0.0f, last = ray.length;
    floatN from = k == 0 ? zero : lane_clamp(whole_from, zero, lane_max(last, zero));
    const floatN to = k == size.z - 1 ? last : lane_min(whole_to, last);
    floatN own = 0.0f;
    intN open = hits & MASK(from < to) & MASK(depth < effects->shadow_depth);
#if SKIP_EMPTY
    open &= MASK(clear_to < to), joined &= MASK(clear_to < to);
#if LANES > 1 && !SCATTERING
    if (!any_lane(open)) { /* all goes on as it is */
      vstore16(through, 0, out + 16 * (size_t)k);
      continue;
    }
#endif
#endif
    while (any_lane(open)) {
#if CLIP
      const intN behind = open & MASK(kept.leave <= from);
      if (any_lane(behind)) {
        const Stretch next = next_stretch(scene, &ray, lane_max(kept.leave, zero), 1.0f);
        const intN found = behind & more & MASK(next.enter < next.leave);
        kept.enter = select(kept.enter, next.enter, found), kept.leave = select(kept.leave, next.leave, found);
        more &= found | ~behind, open &= more, joined &= ~behind;
        if (!any_lane(open)) break;
      }
      from = select(from, lane_max(from, kept.enter), open);
      const floatN b = lane_min(to, kept.leave);
#else
      const floatN b = to;
#endif
      intN active = open & MASK(from < b);
#if SKIP_EMPTY
      const intN look = active & MASK(clear_to <= from);
      if (any_lane(look))
        clear_to = select(clear_to, next_visible(distances, view, from, last, look, &ray, counted), look);
      const intN empty = active & MASK(clear_to >= b);
      active &= ~empty, joined &= ~empty;
#endif
      if (any_lane(active))
        own += depth_of_piece(scene, &ray, direction, from, b, active, &known, &joined, counted);
      from = select(from, lane_max(from, b), open);
      open &= MASK(from < to);
    }
    const floatN straight = 1.0f - opacity_of_depth(depth + half_angle->own_share * own);
    floatN share[3] = {straight, straight, straight};
#if SCATTERING
    /* Edges that the slab is deep along the ray, times texels per edge across it. */
    const floatN middle = ray.entry_depth + 0.5f * lane_clamp(whole_from + whole_to, zero, 2.0f * lane_max(last, zero));
    const floatN texels_per_edge = half_angle->is_point ? half_angle->texels * longer / lane_max(middle, (floatN)1e-6f)
                                                        : (floatN)half_angle->texels;
    const floatN reach = select(zero, fabs(gap) * texels_per_edge, hits);
    floatN mean[3] = {0.0f, 0.0f, 0.0f};
    _Pragma("unroll 1") for (int j = 1; j <= directions; ++j) {
      const float4 c = cone[j];
      const floatN x = lane_clamp(TO_FLOAT(column) + reach * (c.x / c.z), zero, (floatN)(float)(size.x - 1));
      const floatN y = lane_clamp(TO_FLOAT(row) + reach * (c.y / c.z), zero, (floatN)(float)(size.y - 1));
      const intN ix = cell_index(x, size.x), iy = cell_index(y, size.y), from_texel = CARRIED * (iy * size.x + ix);
      for (int channel = 0; channel < 3; ++channel)
        mean[channel] += light_of_texels(before + 1 + channel, from_texel, from_texel + CARRIED, from_texel + row_,
                                         from_texel + row_ + CARRIED, x - TO_FLOAT(ix), y - TO_FLOAT(iy));
    }
    const floatN losses[3] = {less.x * own, less.y * own, less.z * own};
    floatN hands_on[3];
    for (int channel = 0; channel < 3; ++channel) {
      mean[channel] *= 1.0f / (float)directions;
      const floatN here = mean[channel] * (1.0f - opacity_of_depth(half_angle->own_share * losses[channel]));
      share[channel] = (1.0f - effects->scattering) * straight + effects->scattering * here;
      hands_on[channel] = mean[channel] * (1.0f - opacity_of_depth(losses[channel]));
    }
#endif
    depth += own;
#if LANES > 1 && !SCATTERING
    if (any_lane(MASK(own > 0.0f))) through = 1.0f - opacity_of_depth(depth);
    vstore16(straight, 0, out + 16 * (size_t)k);
    continue;
#endif
    float stored[3][LANES];
    STORE_LANES(share[0], stored[0]), STORE_LANES(share[1], stored[1]), STORE_LANES(share[2], stored[2]);
#if SCATTERING
    float handed[4][LANES];
    STORE_LANES(depth, handed[0]), STORE_LANES(hands_on[0], handed[1]);
    STORE_LANES(hands_on[1], handed[2]), STORE_LANES(hands_on[2], handed[3]);
#endif
    EACH_LANE_ROLLED(n)
    {
      const int t = item * LANES + n;
      if (t >= texels) continue;
      __global float *texel_out = out + LIGHT_CHANNELS * (16 * (size_t)k + (t & 15));
      texel_out[0] = stored[0][n];
#if SCATTERING
      texel_out[1] = stored[1][n], texel_out[2] = stored[2][n], texel_out[3] = 0.0f;
      for (int channel = 0; channel < CARRIED; ++channel) after[CARRIED * t + channel] = handed[channel][n];
#endif
    }
  }
  samples[item] += tally_sum(counted[COUNT_SHADOW_SAMPLES]);
}

#endif
