/* Empty space: a map of the distance (in cells, maximum norm) from each cell to the nearest cell in which anything can
 * be visible. 0: visible here. D > 0: everything within D - 1 cells around is transparent, and a ray may leap out of
 * that cube at once. (Distance maps: Zuiderveld et al. 1992; Deakin and Knackstedt 2019 for the Chebyshev form.)
 *
 * Where view->octant_cells is set, eight maps of as many cells follow, one for each octant of directions (bit 0: to
 * larger x, 1: y, 2: z). In these only what lies ahead counts, in no coordinate behind the cell: D > 0 says that the cube
 * of D cells is transparent whose corner towards the ray's origin is the cell. A ray that leaves something visible behind
 * leaps far at once. (Deakin and Knackstedt's anisotropic distances.)
 *
 * What is leapt over contributes exactly nothing, so the image does not change by a bit.
 */
#ifndef SKIP_EMPTY_H
#define SKIP_EMPTY_H

#include "lanes.h"
#include "rays.h"
#include "tally.h"
#include "view.h"

#if COUNT_LEAPS
#define COUNT_LEAP(counted, mask) count_lanes(counted, mask);
#else
#define COUNT_LEAP(counted, mask)
#endif

/* Leaps stop a little short of a face, and look beyond it from a little behind it: lattice units, far more than
 * rounding, far less than shows. The share of t keeps t + margin above t where a ray has so many steps that rounding
 * would swallow it. */
#define FACE_MARGIN(view) (1e-3f + 2e-7f * max(max(view->upper.x, view->upper.y), view->upper.z))
#define SHARE_OF_T 5e-7f

/* A lattice coordinate among the cells: those of blocks lie in their places (blocks.h), half a unit further on. Rays of
 * march_blocks.h are in these places themselves. */
#if BLOCKS && EFFECTS
#define AMONG_CELLS(x) ((x) + 0.5f)
#else
#define AMONG_CELLS(x) (x)
#endif

INLINE intN cell_of(floatN place, int shift, intN last) { return min(max(TO_INT(place) >> shift, (intN)0), last); }

/* The cells that rays are in at parameter t (in steps), and the distances that the maps of their octants have there. */
typedef struct {
  intN x, y, z, distance;
} Cells;

INLINE Cells cells_at(__global const uchar *distances, __constant const View *view, floatN t, const Rays *ray)
{
  Cells at;
  const int shift = view->cell_shift, slice = view->cells.x * view->cells.y;
  const intN right = MASK(ray->dx > 0.0f), down = MASK(ray->dy > 0.0f), away = MASK(ray->dz > 0.0f);
  __global const uchar *maps = distances + view->octant_cells;
  const intN own = ((right & 1) | (down & 2) | (away & 4)) * view->octant_cells;
  /* Clamped as whole numbers, which takes a quarter of the time: each leap waits for the one before. */
  at.x = cell_of(AMONG_CELLS(ray->x0) + t * ray->dx, shift, view->cells.x - 1);
  at.y = cell_of(AMONG_CELLS(ray->y0) + t * ray->dy, shift, view->cells.y - 1);
  at.z = cell_of(AMONG_CELLS(ray->z0) + t * ray->dz, shift, view->cells.z - 1);
  at.distance = AS_INT(gather1(maps, own + (at.z * slice + (at.y * view->cells.x + at.x))) & 255u);
  return at;
}

/* For each ray at parameter t (in steps), in the cells `at`: t itself where its cell is visible, else where it first
 * enters a visible cell (a little before), or infinity if it never does before `end`. All rays of the packet leap
 * together. */
INLINE floatN next_visible_from(Cells at, __global const uchar *distances, __constant const View *view, floatN t,
                                floatN end, intN active, const Rays *ray, Tally *counted)
{
  const int shift = view->cell_shift;
  const floatN x0 = AMONG_CELLS(ray->x0), y0 = AMONG_CELLS(ray->y0), z0 = AMONG_CELLS(ray->z0);
  const intN right = MASK(ray->dx > 0.0f), down = MASK(ray->dy > 0.0f), away = MASK(ray->dz > 0.0f);
  const floatN fastest = lane_max(lane_max(fabs(ray->dx), fabs(ray->dy)), fabs(ray->dz));
  const floatN least_margin = FACE_MARGIN(view) / lane_max(fastest, (floatN)1e-12f);
  floatN entered = select(t, (floatN)INFINITY, active & MASK(t >= end));
  active &= MASK(t < end);
  while (any_lane(active)) {
    COUNT_LEAP(counted, active)
    active &= MASK(at.distance > 0);
    if (!any_lane(active)) break;
    /* In either map the cube ends at the same faces ahead. */
    const intN fx = select(at.x - at.distance + 1, at.x + at.distance, right) << shift;
    const intN fy = select(at.y - at.distance + 1, at.y + at.distance, down) << shift;
    const intN fz = select(at.z - at.distance + 1, at.z + at.distance, away) << shift;
    const floatN leave = lane_min(lane_min((TO_FLOAT(fx) - x0) * ray->rx + ray->px,
                                           (TO_FLOAT(fy) - y0) * ray->ry + ray->py),
                                  (TO_FLOAT(fz) - z0) * ray->rz + ray->pz);
    const floatN face = lane_max(leave, t), margin = least_margin + SHARE_OF_T * face;
    entered = select(entered, face - margin, active);
    t = select(t, face + margin, active);
    entered = select(entered, (floatN)INFINITY, active & MASK(t >= end));
    active &= MASK(t < end);
    if (!any_lane(active)) break;
    at = cells_at(distances, view, t, ray);
  }
  return entered;
}

/* As next_visible_from, of rays whose cells have not been looked up. */
INLINE floatN next_visible(__global const uchar *distances, __constant const View *view, floatN t, floatN end,
                           intN active, const Rays *ray, Tally *counted)
{
  return next_visible_from(cells_at(distances, view, t, ray), distances, view, t, end, active, ray, counted);
}

#endif
