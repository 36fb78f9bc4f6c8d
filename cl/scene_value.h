/* The field of a scene: its reconstructed value and its gradient, with the noise that perturbs them. */
#ifndef SCENE_VALUE_H
#define SCENE_VALUE_H

#include "effects.h"
#include "features.h"
#include "noise.h"
#include "sample_volume.h"
#include "scene.h"
#if BLOCKS
#include "block_runs.h"
#include "march.h"
#include "rays.h"
#include "sample_blocks.h"
#endif

#if BLOCKS
/* By itself: inlined wherever single samples are taken it takes compilers minutes. Marches take theirs in runs. */
RARE floatN single_block_value(const BlockVolume *v, floatN x, floatN y, floatN z, Tally *tally)
{
  return blocks_value(v, x, y, z, ~(intN)0, tally);
}
#endif

/* The value at a lattice point. Both kinds of noise are taken there; a place that is moved out of the domain is taken
 * back to its face. */
INLINE floatN scene_value(const Scene *scene, floatN x, floatN y, floatN z)
{
#if NOISE
  __constant const Effects *e = scene->effects;
#endif
#if NOISE & NOISE_ADDS
  const floatN added = added_noise(scene->noise, e->noise_terms, e->added_terms, x, y, z);
#endif
#if NOISE & NOISE_MOVES
  displace(scene->noise, e->noise_terms + e->added_terms, e->moving_terms, &x, &y, &z);
#endif
#if BLOCKS
  const floatN value = single_block_value(&scene->blocks, x, y, z, BLOCK_TALLIES(scene->tallies));
#else
  const floatN value = sample_value(fetch_sample(scene->volume, scene->view, x, y, z), scene->view);
#endif
#if NOISE & NOISE_ADDS
  return value + added;
#else
  return value;
#endif
}

#if BLOCKS && !NOISE
/* The values at MARCH_STEPS places of the rays from segment `start` on: at the ends of segments (`ends`) or in their
 * middles. Lanes of `active` need those of segments up to `last`. */
INLINE void values_of_segments(const Scene *scene, const Rays *ray, intN start, intN last, int ends, intN active,
                               floatN *values)
{
  const BlockVolume *v = &scene->blocks;
  const float4 upper = v->view->upper;
  const floatN half_ = 0.5f, zero = 0.0f;
  BlockRun run;
  run_begin(&run);
  Record here = record_at(v, half_, half_, half_);
  int kind = alike(v, &here);
  _Pragma("unroll 1") for (int step = 0; step < MARCH_STEPS; ++step) {
    const floatN t0 = TO_FLOAT(start + step), far = lane_min(t0 + 1.0f, ray->length);
    const floatN t = ends ? far : t0 + 0.5f * (far - t0);
    const floatN x = half_ + lane_clamp(ray->x0 + t * ray->dx, zero, (floatN)upper.x);
    const floatN y = half_ + lane_clamp(ray->y0 + t * ray->dy, zero, (floatN)upper.y);
    const floatN z = half_ + lane_clamp(ray->z0 + t * ray->dz, zero, (floatN)upper.z);
    move_record(v, &here, &kind, x, y, z);
    run_place(v, &run, step, &here, kind, x, y, z, active & MASK(start + step <= last), BLOCK_TALLIES(scene->tallies));
  }
  run_end(v, &run, MARCH_STEPS, BLOCK_TALLIES(scene->tallies));
  _Pragma("unroll 1") for (int step = 0; step < MARCH_STEPS; ++step) values[step] = run_value(&run, step);
}
#endif

#if GRADIENT
#include "gradient.h"
#if BLOCKS
#include "gradient_queue.h"
#elif MINIFICATION
#include "gradient_levels.h"
#endif

/* Its gradient, per edge along the local axes. With noise: differences of values over a smallest edge along the
 * lattice axes, one-sided at the volume's faces. */
INLINE Vectors scene_gradient(const Scene *scene, floatN x, floatN y, floatN z)
{
#if NOISE
  const float4 reach = scene->effects->noise_reach;
  const floatN zero = 0.0f;
  floatN slope[3] = {0.0f, 0.0f, 0.0f}, before = 0.0f;
  _Pragma("unroll 1") for (int k = 0; k < 6; ++k) {
    const float side = k & 1 ? 1.0f : -1.0f;
    const float sx = k < 2 ? side * reach.x : 0.0f, sy = k >> 1 == 1 ? side * reach.y : 0.0f;
    const float sz = k > 3 ? side * reach.z : 0.0f;
    const floatN ax = lane_clamp(x + sx, zero, (floatN)scene->view->upper.x);
    const floatN ay = lane_clamp(y + sy, zero, (floatN)scene->view->upper.y);
    const floatN az = lane_clamp(z + sz, zero, (floatN)scene->view->upper.z);
    const floatN value = scene_value(scene, ax, ay, az);
    if (k & 1) {
      const floatN at = k == 1 ? x : k == 3 ? y : z;
      const float far = k == 1 ? reach.x : k == 3 ? reach.y : reach.z;
      const float upper = k == 1 ? scene->view->upper.x : k == 3 ? scene->view->upper.y : scene->view->upper.z;
      const floatN length = lane_clamp(at + far, zero, (floatN)upper) - lane_clamp(at - far, zero, (floatN)upper);
      slope[k >> 1] = (value - before) / lane_max(length, (floatN)1e-12f);
    }
    before = value;
  }
  Gradient g = {slope[0], slope[1], slope[2]};
  g = finite_gradient(g);
#elif BLOCKS
  const Gradient g = blocks_gradient(&scene->blocks, x, y, z, ~(intN)0, BLOCK_TALLIES(scene->tallies));
#elif MINIFICATION
  const Gradient g = levels_gradient(scene->volume, scene->view, x, y, z);
#else
  const Gradient g = gradient_at(scene->volume, scene->gradients, scene->view, scene->effects->gradient_scale, x, y, z);
#endif
  return gradient_to_local(scene->effects, g.x, g.y, g.z);
}
#endif

#endif
