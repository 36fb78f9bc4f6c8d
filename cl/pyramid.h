/* The method "pyramid": adaptive sampling along rays and across them, after Kraus, Strengert, Klein and Ertl
 * (2007).
 *
 * Slices i = 0, 1, 2 ... are a step apart: planes of an orthographic view, spherical shells around the eye of a
 * perspective one. In each, a pyramid of pixels: level l has a pixel for 2^l by 2^l of the picture's, in their middle.
 * A pixel of a level is
 *   sampled      where the oracle's distance is less than WITHIN of the level's pixels, and on the coarsest level;
 *   synthesised  from the four nearest of the next level elsewhere (weights 9/16, 3/16, 3/16, 1/16: biquadratic
 *                B-splines);
 *   left alone   on slices that the oracle's distance reaches beyond.
 * A pixel above level 0 that is sampled asks the oracle always, and the volume where anything is synthesised from it.
 * On slice i levels up to top(i) = tz(i) + oversampling take part, tz the zero bits at the end of i, at most `levels`;
 * a pixel takes part on slices with 2^(tz + 1) steps above its distance. This is the paper's fig. 4, which its
 * hardware could not run, but for these:
 *
 *   distances    are lengths (smallest voxel edges), compared with a step along the ray and with the distance of
 *                neighbouring rays across it. The paper has both equal, and samples where the distance is less than
 *                two pixels. Where rays lie nearer than steps, by 2^oversampling or so, the pyramid has as many levels
 *                more, and slices in between that the paper would skip are not there at all.
 *   freshness    what is synthesised on a slice must come from samples of that slice, so coarse pixels take part a
 *                little longer: up to the distance plus SLACK of their own spacing, as far as other pixels may be that
 *                are synthesised from them (distances of maps grow by no more than the way, see
 *                clvol/integrators/pyramid/cells.py).
 *   boundary     a level's rays go on beyond the picture and the volume, where values are those at the volume's hull;
 *                a pixel's first and last samples are where its own ray meets the hull, and no segment reaches
 *                farther. Clip planes and boxes cut rays in the same way; what is synthesised near a cut comes from
 *                values on both of its sides.
 *   tiles        work-items share the picture in tiles, with one coarse pixel of each level more all around. What is
 *                computed there depends on coarser levels alone, so that no pixel depends on the tile it is in.
 *   surfaces     are found along each pixel's own ray, and cut what lies between its samples (pyramid_surfaces.h).
 *   empty space  under oracles that allow it columns of pixels sleep where nothing is to be seen, and tiles of
 *                sleeping columns leap (pyramid_leap.h).
 *   opaque rays  stop; and a tile does when all its rays have.
 *
 * A work-group is a tile. CPU devices: one work-item (WORKERS 1) that takes 4 by 4 pixels at a time in vector
 * registers; levels above 0 first, for CHUNK slices, then the picture's pixels, each packet through all of these
 * slices. GPUs: WORKERS work-items, a pixel at a time each, barriers in between.
 *
 * To add an oracle: clvol/integrators/pyramid/oracles/__init__.py says how.
 */
#ifndef PYRAMID_H
#define PYRAMID_H

#include "features.h"
#include "lanes.h"
#include "view.h"
#include "struct_fields.h"
#include "tally.h"
#if EFFECTS
#include "scene.h"
#endif
#if BLOCKS
#include "sample_blocks.h"
#else
#include "sample_volume.h"
#endif

typedef struct {
  /* half-spaces that clips keep: where (x, y, z) times the lattice point, plus w, is 0 or more */
  float4 halves[MOST_HALVES];
  float4 oracle;              /* numbers of the oracle's own */
  float4 edges;               /* x, y, z: edges per lattice unit */
  int4 cells;                 /* x, y, z: cells of the oracle's map */
  int4 free_cells;            /* x, y, z: cells of the map of empty space */
  int cell_shift;             /* log2 of a cell of the oracle's map, lattice units */
  int free_shift;             /* and of a cell of the map of empty space */
  int levels;                 /* of coarsening along rays */
  int oversampling;           /* levels of coarsening across rays beyond those */
  int half_count;             /* half-spaces in `halves` */
  float ray_spacing;          /* edges between neighbouring rays at slice 0, */
  float spacing_growth;       /* and by how much they grow per slice */
  float gate_low;             /* no value at or below this one is visible, */
  float gate_high;            /* nor any at or above that one */
} Pyramid;

/* Reported to the host (struct_fields.h). */
#define PYRAMID_FIELDS  \
  STRUCT(Pyramid), FIELD(Pyramid, halves), FIELD(Pyramid, oracle), FIELD(Pyramid, edges), FIELD(Pyramid, cells), \
  FIELD(Pyramid, free_cells), FIELD(Pyramid, cell_shift), FIELD(Pyramid, free_shift), FIELD(Pyramid, levels), \
  FIELD(Pyramid, oversampling), FIELD(Pyramid, half_count), FIELD(Pyramid, ray_spacing), \
  FIELD(Pyramid, spacing_growth), FIELD(Pyramid, gate_low), FIELD(Pyramid, gate_high)

/* Whether segments are queued for light (pyramid_light.h). */
#if EFFECTS && LANES > 1 && defined(NATIVE_LANES) && SEGMENT_OPACITIES
#define HELD_LIGHT 1
#else
#define HELD_LIGHT 0
#endif

#define CHUNK 8       /* slices */
#define SLACK 0.5f
/* of a pixel that is synthesised lie all that it is made from but the farthest, which has 1/16 of the weight */
#define WITHIN 1.6f

#if WORKERS == 1
#define SHARED __private
#define WORKER 0
#define SYNCHRONISE()
#else
#define SHARED __local
#define WORKER ((int)get_local_id(0))
#define SYNCHRONISE() barrier(CLK_LOCAL_MEM_FENCE)
#endif

/* A level's pixels in a tile, and one more all around: [side, side], side a multiple of a packet's. */
#define WIDTH(level) ((TILE >> (level)) + 2)
#define SIDE(level) ((WIDTH(level) + PACKET_W - 1) & ~(PACKET_W - 1))
#define AREA(level) (SIDE(level) * SIDE(level))
/* and what loads of patches reach beyond */
#define ALL_LEVELS (AREA(1) + AREA(2) + AREA(3) + AREA(4) + AREA(5) + 2 * SIDE(1))

INLINE int side_of(int level) { return (WIDTH(level) + PACKET_W - 1) & ~(PACKET_W - 1); }
INLINE int offset_of(int level)
{
  int at = 0;
  for (int l = 1; l < level; ++l) at += side_of(l) * side_of(l);
  return at;
}

#define COLUMNS (TILE * TILE / 16) /* at most, of the coarsest level */

/* State of a tile's levels above 0. Level 1 has a copy for each slice of a chunk, for level 0 to look at afterwards. */
typedef struct {
  float x0[ALL_LEVELS], y0[ALL_LEVELS], z0[ALL_LEVELS]; /* lattice place at slice 0, by patches ... */
  float dx[ALL_LEVELS], dy[ALL_LEVELS], dz[ALL_LEVELS]; /* ... and way per slice */
  float distance[ALL_LEVELS], value[ALL_LEVELS];        /* of levels 2 and above */
  float distance1[CHUNK][AREA(1) + SIDE(1)], value1[CHUNK][AREA(1) + SIDE(1)];
  float nearest[MOST_LEVELS + 1];                       /* the least distance of each level */
  float free_slices[AREA(2) + SIDE(2)];                 /* of the coarsest level (pyramid_leap.h) */
  int wakes[COLUMNS], slices[COLUMNS];                  /* of columns */
  /* of a level that is being updated: patches to sample, and which lanes of them */
  uint sampled[AREA(1) / LANES];
  /* of level 1, for each slice: the one that holds there; the last of all */
  int copy[CHUNK], last_copy;
#if WORKERS > 1
  int least, any; /* of a group's work-items */
#endif
} Levels;

#define COUNT_ORACLE_SAMPLES 0        /* oracle asked */
#define COUNT_SYNTHESES 1     /* pixels of all levels synthesised */
#define COUNT_ACCUMULATIONS 2 /* pixels of the picture that a segment was added to */
#if BLOCKS /* and after them those of block_parameters.h */
#define PYRAMID_COUNTERS (3 + BLOCK_COUNTERS)
#elif EFFECTS /* and those of effects.h */
#define PYRAMID_COUNTERS (3 + EFFECT_COUNTERS)
#define EFFECT_TALLIES(counted) ((counted) + 3)
#else
#define PYRAMID_COUNTERS 3
#endif

/* The least `value` (0 or more) of all work-items of the group. */
INLINE float group_min(SHARED Levels *m, float value)
{
#if WORKERS > 1
  SYNCHRONISE();
  if (WORKER == 0) m->least = as_int(INFINITY);
  SYNCHRONISE();
  atomic_min(&m->least, as_int(value));
  SYNCHRONISE();
  value = as_float(m->least);
#endif
  return value;
}

/* The largest, likewise. */
INLINE float group_max(SHARED Levels *m, float value)
{
#if WORKERS > 1
  SYNCHRONISE();
  if (WORKER == 0) m->least = 0;
  SYNCHRONISE();
  atomic_max(&m->least, as_int(value));
  SYNCHRONISE();
  value = as_float(m->least);
#endif
  return value;
}

INLINE int group_any(SHARED Levels *m, int value)
{
#if WORKERS > 1
  SYNCHRONISE();
  if (WORKER == 0) m->any = 0;
  SYNCHRONISE();
  if (value) atomic_or(&m->any, 1);
  SYNCHRONISE();
  value = m->any;
#endif
  return value;
}

/* What a sample needs. */
typedef struct {
  __global const uchar *volume;
  __constant const View *view;
  __constant const Pyramid *pyramid;
  __global const uchar *map;
#if BLOCKS
  const BlockVolume *blocks;
  Tally *block_counters;
#endif
#if EFFECTS
  const Scene *scene;
#if HELD_LIGHT
  void *queue, *packets; /* of the tile: what segments wait in for their light, and whose they are (pyramid_light.h) */
#endif
#endif
} Source;

INLINE float ray_spacing(const Source *in,
                         int k) { return in->pyramid->ray_spacing + (float)k * in->pyramid->spacing_growth; }

/* How far along the ray samples may be on slice k, as a power of two of steps. */
INLINE int slice_level(const Source *in, int k) { return min((int)popcount(~k & (k - 1)), in->pyramid->levels); }

#endif
