/* What the effects of a scene need beside the view: numbers in one struct (clvol/opencl/structs.py holds the same layout), lists
 * (lights, surfaces, clips) in `items`, and what has an array of its own. Compiled only where EFFECTS is set: a plain scene's
 * kernels have none of it.
 *
 * "Local" space: the world's axes, origin in the middle of the volume, smallest voxel edges as the unit.
 */
#ifndef EFFECTS_H
#define EFFECTS_H

#include "lanes.h"
#include "view.h"
#include "features.h"
#include "noise.h"
#include "tally.h"

typedef struct {
  float4 local_x, local_y, local_z;          /* lattice point to local: rows of the matrix, and in w the shift */
  float4 gradient_x, gradient_y, gradient_z; /* derivative per lattice unit to derivative per edge along the local axes */
  float4 gradient_scale;                     /* of precomputed gradients, see gradient.h */
  float4 material;                           /* ambient, diffuse, specular, shininess */
  float4 shading;                            /* 1 / (magnitude per edge below which shading fades), or 0; two-sided; - ; - */
  float4 depth_cue;                          /* distance where it starts, 1 / its length (edges), strength; - */
  float4 depth_color;
  float4 projection;                         /* lowest value of the volume, 1 / range, attenuation a step; score up to which nothing shows */
  float4 shadow;                             /* bound; step (edges); strength of scattering; depth beyond which nothing arrives */
  float4 light_grid;                         /* lattice point to light grid: scale x, y, z; - */
  float4 environment;                        /* intensity of what is seen; - */
  float4 value_bounds;                       /* lowest, highest value that a sample can have; - ; - */
  float4 noise_reach;                        /* half a smallest edge, in lattice units along x, y, z; - */
  int4 counts;                               /* lights, surfaces, clips that keep, clips that remove */
  int4 first;                                /* of the items: first light, surface, clip; - */
  int4 light_size;                           /* points of the light volume x, y, z; lights in it */
  int4 maps;                                 /* of the environment: side of the diffuse, specular, background map; - */
  int4 map_offsets;                          /* where they begin */
  int4 factors;                              /* points of gradient opacity, of directional opacity; layers; - */
  int4 factor_offsets;                       /* where the tables of each begin */
  int4 fields;                               /* how many; - */
  float4 field_x[3], field_y[3], field_z[3]; /* lattice point to the field's: rows of the matrix, and in w the shift */
  float4 field_map[3];                       /* see fields.h: of a density's function; a mask's threshold and side */
  int4 field_size[3];                        /* lattice points x, y, z; role */
  int4 field_at[3];                          /* where its voxels begin in `fields`; its table in `factors`; - ; - */
  int4 noise_counts;                         /* terms that add to values, and after them those that move places; - ; - */
  NoiseTerm noise_terms[NOISE_TERMS];
} Effects;

/* SHADOWS, see shadow.h. */
#define SHADOWS_BY_RAYS 1
#define SHADOWS_BY_VOLUME 2

/* What is counted beside samples: one number each a tile. clvol/device/effects.py names them in this order. */
#define COUNT_GRADIENTS 0        /* gradients reconstructed */
#define COUNT_LIT 1              /* samples lit */
#define COUNT_SURFACE_TESTS 2    /* cells tested for surfaces */
#define COUNT_SURFACE_HITS 3     /* surfaces met */
#define COUNT_SHADOW_RAYS 4
#define COUNT_SHADOW_SAMPLES 5   /* reconstructions on shadow rays; not among `samples` */
#define COUNT_FIELD_SAMPLES 6    /* of further fields */
#define COUNT_BENDS 7            /* rays refracted or reflected */
#define COUNTERS 8

/* TILES_CHOSEN: this launch renders only the tiles marked in `chosen`; another one renders the others, without some effect. */
#if TILES_CHOSEN
#define CHOSEN_PARAMETER , __global const uchar *restrict chosen
#define RETURN_UNLESS_CHOSEN(tile) \
  if (!chosen[tile]) {             \
    EFFECT_STORE_TALLY(tile)       \
    return;                        \
  }
#else
#define CHOSEN_PARAMETER
#define RETURN_UNLESS_CHOSEN(tile)
#endif

#if EFFECTS

/* All that a function about the scene may read. */
typedef struct {
  __global const uchar *volume;
  __global const float *table, *warp;
  __global const uchar *distances;
  __constant const View *view;
  __constant const Effects *effects;
  __global const float4 *items;
  __global const uint *gradients;
  __global const uchar *surface_distances;
  __global const float4 *environment;
  __global const float4 *light_volume;
  __global const uint *noise;
  __global const float *factors;
  __global const float *fields;
} Scene;

#define EFFECT_PARAMETERS                                                                                              \
  , __constant const Effects *restrict effects, __global const float4 *restrict items,                                 \
    __global const uint *restrict gradients, __global const uchar *restrict surface_distances,                         \
    __global const float4 *restrict environment, __global const float4 *restrict light_volume,                         \
    __global const uint *restrict noise, __global const float *restrict factors, __global const float *restrict fields, \
    __global uint *restrict counts
#define EFFECT_ARGUMENTS \
  , effects, items, gradients, surface_distances, environment, light_volume, noise, factors, fields, counted

/* A kernel's own tally, written to counts[tile, COUNTERS] at its end. */
#define EFFECT_TALLY Tally counted[COUNTERS] = {0};
#define EFFECT_STORE_TALLY(tile)                                                             \
  for (int counter_ = 0; counter_ < COUNTERS; ++counter_)                                    \
    counts[(size_t)(tile) * COUNTERS + counter_] = tally_sum(counted[counter_]);

#elif BLOCKS

#include "block_parameters.h"

#else

#define EFFECT_PARAMETERS
#define EFFECT_ARGUMENTS
#define EFFECT_TALLY
#define EFFECT_STORE_TALLY(tile)

#endif

/* A packet of vectors. */
typedef struct {
  floatN x, y, z;
} Vectors;

INLINE floatN dot3(Vectors a, Vectors b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
INLINE Vectors scaled3(Vectors a, floatN s)
{
  const Vectors r = {a.x * s, a.y * s, a.z * s};
  return r;
}
INLINE Vectors sum3(Vectors a, Vectors b)
{
  const Vectors r = {a.x + b.x, a.y + b.y, a.z + b.z};
  return r;
}
INLINE Vectors select3(Vectors a, Vectors b, intN mask)
{
  const Vectors r = {select(a.x, b.x, mask), select(a.y, b.y, mask), select(a.z, b.z, mask)};
  return r;
}
INLINE Vectors broadcast3(float4 v)
{
  const Vectors r = {v.x, v.y, v.z};
  return r;
}
/* Times a length, of unit length before; 0 stays 0 (and so does what is too short to have a direction). */
INLINE Vectors directed3(Vectors a, float length)
{
  const floatN square = dot3(a, a);
  const intN long_enough = MASK(square > 1e-37f) & MASK(square < 1e38f);
  const floatN inverse = lane_rsqrt(select((floatN)1.0f, square, long_enough));
  return scaled3(a, select((floatN)0.0f, length * inverse, long_enough));
}
INLINE Vectors unit3(Vectors a) { return directed3(a, 1.0f); }

INLINE Vectors to_local(__constant const Effects *e, floatN x, floatN y, floatN z)
{
  const Vectors r = {e->local_x.x * x + e->local_x.y * y + e->local_x.z * z + e->local_x.w,
                     e->local_y.x * x + e->local_y.y * y + e->local_y.z * z + e->local_y.w,
                     e->local_z.x * x + e->local_z.y * y + e->local_z.z * z + e->local_z.w};
  return r;
}
/* The same for directions. */
INLINE Vectors direction_to_local(__constant const Effects *e, floatN x, floatN y, floatN z)
{
  const Vectors r = {e->local_x.x * x + e->local_x.y * y + e->local_x.z * z,
                     e->local_y.x * x + e->local_y.y * y + e->local_y.z * z,
                     e->local_z.x * x + e->local_z.y * y + e->local_z.z * z};
  return r;
}
/* From a derivative per lattice unit to one per edge along the local axes. */
INLINE Vectors gradient_to_local(__constant const Effects *e, floatN x, floatN y, floatN z)
{
  if (e->gradient_x.w != 0.0f) { /* the lattice is along the axes */
    const Vectors along = {e->gradient_x.x * x, e->gradient_y.y * y, e->gradient_z.z * z};
    return along;
  }
  const Vectors r = {e->gradient_x.x * x + e->gradient_x.y * y + e->gradient_x.z * z,
                     e->gradient_y.x * x + e->gradient_y.y * y + e->gradient_y.z * z,
                     e->gradient_z.x * x + e->gradient_z.y * y + e->gradient_z.z * z};
  return r;
}

#endif
