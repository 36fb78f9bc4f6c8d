/* All that a kernel may read of its scene, as one struct: the volume, its transfer function and what the variant adds,
 * EFFECTS (effects.h; with SLICES half_angle.h, with BLOCKS block_parameters.h, too), BLOCKS or SLICES (slices.h).
 * Functions about the scene take `const Scene *`.
 *
 *   SCENE_PARAMETERS   the parameters of a kernel that the struct is made of; clvol/device/arguments.py declares the
 *                      same
 *   SCENE              their names as an initialiser: const Scene scene = SCENE; after DECLARE_TALLIES
 *   COUNTS_PARAMETER   the last parameter of a kernel that counts what the variant does, or nothing
 *
 * volume     voxels in their own type, laid out as fetch_voxel.h says; of a volume of blocks, the first buffer of
 *            samples
 * table      pieces of the transfer function (transfer_pieces.h)
 * distances  uchar per cell of empty space (skip_empty.h); read only where SKIP_EMPTY is set
 * counts     uint [tiles, SCENE_COUNTERS]
 */
#ifndef SCENE_H
#define SCENE_H

#include "tally.h"
#include "view.h"
#if EFFECTS
#include "effects.h"
#if SLICES
#include "half_angle.h"
#endif
#elif SLICES
#include "slices.h"
#endif
#if BLOCKS
#include "block_parameters.h"
#endif
#if MINIFICATION
#include "volume_levels.h"
#endif

typedef struct {
  __global const uchar *volume;
  __global const float *table;
  __global const uchar *distances;
  __constant const View *view;
#if EFFECTS
  __constant const Effects *effects;
  __global const float4 *items;
  __global const uint *gradients;
  __global const uchar *surface_distances;
  __global const uchar *constant_distances;
  __global const float4 *environment;
  __global const float4 *light_volume;
  __global const uint *noise;
  __global const float *factors;
  __global const float *fields;
  __global const float4 *occlusion;
#if SLICES
  __constant const HalfAngle *half_angle;
#endif
#if BLOCKS
  BlockVolume blocks;
  Tally *tallies; /* of the work-item: values of blocks are counted where they are taken */
#endif
#elif BLOCKS
  BlockVolume blocks;
#elif SLICES
  __constant const Slices *slices;
#elif STEP_CELLS
  __global const uchar *steps;
#endif
} Scene;

#if EFFECTS && SLICES
#define HALF_ANGLE_PARAMETER , __constant const HalfAngle *restrict half_angle
#define HALF_ANGLE_ARGUMENT , half_angle
#else
#define HALF_ANGLE_PARAMETER
#define HALF_ANGLE_ARGUMENT
#endif

#if EFFECTS && BLOCKS
#define BLOCK_VARIANT_PARAMETERS , BLOCK_PARAMETERS
#define BLOCK_VARIANT , BLOCK_VOLUME, counted
#define BLOCK_TALLIES(counted) ((counted) + EFFECT_COUNTERS)
#define SCENE_COUNTERS (EFFECT_COUNTERS + BLOCK_COUNTERS)
#elif EFFECTS
#define BLOCK_VARIANT_PARAMETERS
#define BLOCK_VARIANT
#define SCENE_COUNTERS EFFECT_COUNTERS
#endif

#if EFFECTS
#define VARIANT_PARAMETERS                                                                               \
  , __constant const Effects *restrict effects, __global const float4 *restrict items,                   \
    __global const uint *restrict gradients, __global const uchar *restrict surface_distances,           \
    __global const uchar *restrict constant_distances,                                                   \
    __global const float4 *restrict environment, __global const float4 *restrict light_volume,           \
    __global const uint *restrict noise, __global const float *restrict factors, __global const float *restrict fields, \
    __global const float4 *restrict occlusion \
    HALF_ANGLE_PARAMETER BLOCK_VARIANT_PARAMETERS
#define VARIANT \
  , effects, items, gradients, surface_distances, constant_distances, environment, light_volume, noise, factors, fields, \
    occlusion \
    HALF_ANGLE_ARGUMENT BLOCK_VARIANT
#elif BLOCKS
#define VARIANT_PARAMETERS , BLOCK_PARAMETERS
#define VARIANT , BLOCK_VOLUME
#define SCENE_COUNTERS BLOCK_COUNTERS
#elif SLICES
#define VARIANT_PARAMETERS , __constant const Slices *restrict slices
#define VARIANT , slices
#define SCENE_COUNTERS 0
#elif STEP_CELLS
#define VARIANT_PARAMETERS , __global const uchar *restrict steps
#define VARIANT , steps
#define SCENE_COUNTERS COUNT_LEAPS
#else
#define VARIANT_PARAMETERS
#define VARIANT
#if MINIFICATION
#define SCENE_COUNTERS LEVEL_COUNTERS
#else
#define SCENE_COUNTERS COUNT_LEAPS
#endif
#endif
#if COUNT_LEAPS && (EFFECTS || BLOCKS || SLICES || MINIFICATION)
#error "COUNT_LEAPS counts those of plain scenes"
#endif

#define SCENE_PARAMETERS                                                              \
  __global const uchar *restrict volume, __global const float *restrict table,        \
    __global const uchar *restrict distances, __constant const View *restrict view VARIANT_PARAMETERS
#define SCENE {volume, table, distances, view VARIANT}

/* A work-item's own tallies, `counted`, and how they get to row `row` of `counts` when it ends. */
#if SCENE_COUNTERS
#define COUNTS_PARAMETER , __global uint *restrict counts
#define DECLARE_TALLIES Tally counted[SCENE_COUNTERS] = {0};
#define STORE_TALLIES(row)                                        \
  for (int counter_ = 0; counter_ < SCENE_COUNTERS; ++counter_)   \
    counts[(size_t)(row) * SCENE_COUNTERS + counter_] = tally_sum(counted[counter_]);
#else
#define COUNTS_PARAMETER
#define DECLARE_TALLIES Tally *const counted = 0;
#define STORE_TALLIES(row)
#endif

#endif
