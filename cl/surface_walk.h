/* Where rays meet iso-surfaces: cell by cell of the lattice, in order, whatever the step that the volume is integrated
 * by.
 *
 * A walk is a ray in edges with the cell that it is in. It leaps to the next cells of 8^3 voxels in which an iso-value
 * can be (`surface_distances`, a map as in skip_empty.h), and crosses them from face to face. In each cell the field
 * along the ray is a function that finds where it takes a value:
 *   cell_cubic.h    linear filter: a cubic
 *   cell_spline.h   filters of 64 voxels: a polynomial of degree 9
 *   cell_step.h     nearest filter: a jump where the ray enters
 *   cell_sampled.h  noise, and kernels that are no spline (kernel_filter.h): samples
 * A place is above a surface where its value is at least the iso-value; a ray meets the surface where it changes
 * sides. The value on a face is the same for both cells, so that a surface in a face is met once.
 */
#ifndef SURFACE_WALK_H
#define SURFACE_WALK_H

#include "rays.h"
#include "scene.h"
#include "skip_empty.h"
#include "surface_levels.h"
#include "tally.h"

/* Cells are sampled. */
#define SAMPLED_CELLS (NOISE || KERNEL_FILTER)
#if SAMPLED_CELLS
#include "cell_sampled.h"
#elif FILTER == FILTER_LINEAR
#include "cell_cubic.h"
#elif FILTER == FILTER_NEAREST
#include "cell_step.h"
#else
#include "cell_spline.h"
#endif

/* Cells that are fetched whole, and a step ahead. */
#define CELLS_AHEAD (!SAMPLED_CELLS && !WIDE_FILTER && !BLOCKS)
/* Cells around voxels, not between them. */
#define CENTRED_CELLS (!SAMPLED_CELLS && FILTER == FILTER_NEAREST)
/* What a cell needs to know of the one before. */
#define VALUE_BEFORE (SAMPLED_CELLS || FILTER == FILTER_NEAREST)

typedef struct {
  Rays ray;           /* in edges */
  /* so far surfaces are known: where the ray enters its cell; infinite where there is nothing more */
  floatN from;
  Vectors low;        /* that place in the cell, 0 .. 1 */
  intN ix, iy, iz;    /* the cell */
  intN placed, going; /* whether the cell is known; whether it is to be looked at, or leapt over first */
  intN piece, rank;   /* where in the cell the search goes on */
  intN found, surface, rising;
  floatN at;          /* the next surface, in edges */
#if VALUE_BEFORE
  floatN before;      /* the value where the ray enters the cell, or in the cell before */
  intN known;         /* whether it is */
#endif
} SurfaceWalk;

/* The walk of rays (in edges) from `from` on. */
INLINE SurfaceWalk walk_along(Rays ray, floatN from)
{
  SurfaceWalk w;
  w.ray = ray, w.from = from, w.at = INFINITY;
  w.low.x = w.low.y = w.low.z = 0.0f;
  w.ix = w.iy = w.iz = w.placed = w.going = w.piece = w.rank = w.found = w.surface = w.rising = 0;
#if VALUE_BEFORE
  w.before = 0.0f, w.known = 0;
#endif
  return w;
}

/* `a`, and `b` in the lanes of the mask: only for walks that begin. */
INLINE SurfaceWalk select_walks(SurfaceWalk a, SurfaceWalk b, intN mask)
{
  a.ray = select_rays(a.ray, b.ray, mask);
  a.from = select(a.from, b.from, mask);
  a.placed &= ~mask, a.going &= ~mask, a.found &= ~mask;
  return a;
}

/* The lattice point of the walk's next surface. */
INLINE Vectors surface_place(const SurfaceWalk *w)
{
  const Vectors at = {w->ray.x0 + w->at * w->ray.dx, w->ray.y0 + w->at * w->ray.dy, w->ray.z0 + w->at * w->ray.dz};
  return at;
}

/* The lattice point whose gradient a surface has: that of the voxel beyond a jump, else its own. */
INLINE Vectors gradient_place(const SurfaceWalk *w, Vectors place)
{
#if CENTRED_CELLS
  const Vectors voxel = {TO_FLOAT(w->ix), TO_FLOAT(w->iy), TO_FLOAT(w->iz)};
  return voxel;
#else
  return place;
#endif
}

/* Whether the 8^3 cells around are without any surface. */
INLINE intN no_surface_around(const Scene *scene, intN ix, intN iy, intN iz)
{
  __constant const View *view = scene->view;
  const int shift = view->cell_shift;
  const intN cx = min(ix >> shift, (intN)(view->cells.x - 1)), cy = min(iy >> shift, (intN)(view->cells.y - 1));
  const intN cz = min(iz >> shift, (intN)(view->cells.z - 1));
  const uintN distance = gather1(scene->surface_distances, (cz * view->cells.y + cy) * view->cells.x + cx) & 255u;
  return MASK(distance != 0u);
}

/* An axis of a cell: whether its index moves up; where the ray leaves the cell along it. */
#define CELL_LOWER (CENTRED_CELLS ? -0.5f : 0.0f)
#define LEAVES_AT(x0, index, up, inverse, never) \
  ((TO_FLOAT(index) + (CELL_LOWER + select((floatN)0.0f, (floatN)1.0f, up) - (x0))) * (inverse) + (never))

/* Lanes of `looks` leap to where a surface can be, or end; they know their cell then. */
INLINE void leap_to_surfaces(const Scene *scene, SurfaceWalk *w, intN looks)
{
  __constant const View *view = scene->view;
  const Rays *ray = &w->ray;
  /* From within the cell: a place on a face is in one of two. */
  const floatN fastest = lane_max(lane_max(fabs(ray->dx), fabs(ray->dy)), fabs(ray->dz));
  const floatN inwards = select((floatN)0.0f, FACE_MARGIN(view) / lane_max(fastest, (floatN)1e-12f), w->placed);
  const floatN from = select((floatN)0.0f, w->from + inwards, looks);
  const floatN next = next_visible(scene->surface_distances, view, from, ray->length, looks, ray, 0);
  const intN leaps = looks & MASK(next > from), ends = looks & MASK(lane_max(next, w->from) >= ray->length);
  w->from = select(w->from, next, leaps), w->placed &= ~leaps;
  w->from = select(w->from, (floatN)INFINITY, ends);
  w->going |= looks;
  const intN begins = looks & ~w->placed & ~ends;
  if (!any_lane(begins)) return;
  const floatN t = select((floatN)0.0f, w->from, begins), zero = 0.0f, one = 1.0f;
  const floatN x = ray->x0 - CELL_LOWER + t * ray->dx, y = ray->y0 - CELL_LOWER + t * ray->dy;
  const floatN z = ray->z0 - CELL_LOWER + t * ray->dz;
  const int last = CENTRED_CELLS ? 1 : 2;
  w->ix = select(w->ix, min(TO_INT(lane_max(x, zero)), (intN)(view->size.x - last)), begins);
  w->iy = select(w->iy, min(TO_INT(lane_max(y, zero)), (intN)(view->size.y - last)), begins);
  w->iz = select(w->iz, min(TO_INT(lane_max(z, zero)), (intN)(view->size.z - last)), begins);
  w->low.x = select(w->low.x, lane_clamp(x - TO_FLOAT(w->ix), zero, one), begins);
  w->low.y = select(w->low.y, lane_clamp(y - TO_FLOAT(w->iy), zero, one), begins);
  w->low.z = select(w->low.z, lane_clamp(z - TO_FLOAT(w->iz), zero, one), begins);
  w->piece = select(w->piece, (intN)0, begins), w->rank = select(w->rank, (intN)0, begins);
  w->placed |= begins;
#if VALUE_BEFORE
  w->known &= ~begins;
#endif
}

/* Finds the next surface of the walks in `wanted` that have none and did not come as far as `until` (edges). `taken`
 * counts cells, and samples of noise. */
INLINE void find_surfaces(const Scene *scene, SurfaceWalk *w, intN wanted, floatN until, uintN *taken, Tally *tests)
{
  __constant const View *view = scene->view;
  const Rays *ray = &w->ray;
  const intN zero = 0, right = MASK(ray->rx > 0.0f), down = MASK(ray->ry > 0.0f), away = MASK(ray->rz > 0.0f);
  const intN step_x = select((intN)-1, (intN)1, right), step_y = select((intN)-1, (intN)1, down);
  const intN step_z = select((intN)-1, (intN)1, away);
  const floatN entry_x = select((floatN)1.0f, (floatN)0.0f, right), entry_y = select((floatN)1.0f, (floatN)0.0f, down);
  const floatN entry_z = select((floatN)1.0f, (floatN)0.0f, away), none = 0.0f, whole = 1.0f;
  const int last = CENTRED_CELLS ? 1 : 2;
  const intN last_x = view->size.x - last, last_y = view->size.y - last, last_z = view->size.z - last;
  for (;;) {
    intN open = wanted & ~w->found & MASK(w->from < until);
    if (!any_lane(open)) return;
    const intN looks = open & ~w->going;
    if (any_lane(looks)) {
      leap_to_surfaces(scene, w, looks);
      open &= MASK(w->from < until);
    }
#if CELLS_AHEAD
    CellVoxels ahead = fetch_cell(scene->volume, view, w->ix, w->iy, w->iz);
#endif
    while (any_lane(open)) {
      const floatN tx = LEAVES_AT(ray->x0, w->ix, right, ray->rx, ray->px);
      const floatN ty = LEAVES_AT(ray->y0, w->iy, down, ray->ry, ray->py);
      const floatN tz = LEAVES_AT(ray->z0, w->iz, away, ray->rz, ray->pz), leave = lane_min(lane_min(tx, ty), tz);
      const floatN from = select(none, w->from, open), t1 = lane_max(lane_min(leave, ray->length), from);
      const intN through = MASK(leave <= ray->length);
      const intN over_x = through & MASK(tx <= leave), over_y = through & MASK(ty <= leave);
      const intN over_z = through & MASK(tz <= leave);
      /* At least one index moves on, or the ray ends: the walk is finite. */
      const intN nx = w->ix + (step_x & over_x), ny = w->iy + (step_y & over_y), nz = w->iz + (step_z & over_z);
      const intN inside = MASK(nx >= zero) & MASK(nx <= last_x) & MASK(ny >= zero) & MASK(ny <= last_y) &
          MASK(nz >= zero) & MASK(nz <= last_z);
      const intN goes_on = open & inside & through;
      Vectors high;
      high.x = select(lane_clamp(ray->x0 - CELL_LOWER - TO_FLOAT(w->ix) + t1 * ray->dx, none, whole), whole - entry_x,
                      over_x);
      high.y = select(lane_clamp(ray->y0 - CELL_LOWER - TO_FLOAT(w->iy) + t1 * ray->dy, none, whole), whole - entry_y,
                      over_y);
      high.z = select(lane_clamp(ray->z0 - CELL_LOWER - TO_FLOAT(w->iz) + t1 * ray->dz, none, whole), whole - entry_z,
                      over_z);
      *taken -= AS_UINT(open);
      count_lanes(tests, open);
#if CELLS_AHEAD
      const CellVoxels voxels = ahead;
      ahead = fetch_cell(scene->volume, view, select(w->ix, nx, goes_on), select(w->iy, ny, goes_on),
                         select(w->iz, nz, goes_on));
#endif
#if SAMPLED_CELLS
      if (any_lane(open & ~w->known)) w->before = select(w->before, value_on_ray(scene, ray, from), open & ~w->known);
      w->known |= open;
      const floatN value = value_on_ray(scene, ray, t1);
      const CellHit hit = look_in_cell(scene, ray, from, t1, w->before, value, w->piece, w->rank, open, taken);
#elif CENTRED_CELLS
      const floatN value = sample_value(voxels, view);
      const CellHit hit = look_in_cell(scene, w->before, value, w->rank, open & w->known);
#elif BLOCKS
      const CellVoxels voxels = fetch_block_cell(&scene->blocks, w->ix, w->iy, w->iz, open,
                                                 BLOCK_TALLIES(scene->tallies));
      const CellHit hit = look_in_cell(scene, voxels, w->low, high, w->piece, w->rank, open);
#elif WIDE_FILTER
      const CellHit hit = look_in_cell(scene, w->ix, w->iy, w->iz, w->low, high, w->piece, w->rank, open);
#else
      const CellHit hit = look_in_cell(scene, voxels, w->low, high, w->piece, w->rank, open);
#endif
      w->found |= hit.found;
      w->surface = select(w->surface, hit.surface, hit.found), w->rising = select(w->rising, hit.rising, hit.found);
      w->piece = select(w->piece, hit.piece, hit.found), w->rank = select(w->rank, hit.rank, hit.found);
      w->at = select(w->at, from + hit.share * (t1 - from), hit.found);
      const intN moves = goes_on & ~hit.found, ends = open & ~goes_on & ~hit.found;
      const intN next_block = MASK((((nx ^ w->ix) | (ny ^ w->iy) | (nz ^ w->iz)) >> view->cell_shift) != 0) & moves;
      w->ix = select(w->ix, nx, moves), w->iy = select(w->iy, ny, moves), w->iz = select(w->iz, nz, moves);
      w->low.x = select(w->low.x, select(high.x, entry_x, over_x), moves);
      w->low.y = select(w->low.y, select(high.y, entry_y, over_y), moves);
      w->low.z = select(w->low.z, select(high.z, entry_z, over_z), moves);
      w->piece = select(w->piece, zero, moves), w->rank = select(w->rank, zero, moves);
      w->from = select(select(w->from, t1, moves), (floatN)INFINITY, ends);
#if VALUE_BEFORE
      w->before = select(w->before, value, moves), w->known |= moves;
#endif
      if (any_lane(next_block)) w->going &= ~(next_block & no_surface_around(scene, w->ix, w->iy, w->iz));
      open &= moves & w->going & MASK(w->from < until);
    }
  }
}

#endif
