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

/* For each ray at parameter t (in steps): t itself where its cell is visible, else where it first enters a visible
 * cell (a little before), or infinity if it never does before `end`. All rays of the packet leap together. */
INLINE floatN next_visible(__global const uchar *distances, __constant const View *view, floatN t, floatN end,
                           intN active, const Rays *ray, Tally *counted)
{
  const int shift = view->cell_shift, slice = view->cells.x * view->cells.y;
  const intN zero = 0, last_x = view->cells.x - 1, last_y = view->cells.y - 1, last_z = view->cells.z - 1;
  const floatN x0 = AMONG_CELLS(ray->x0), y0 = AMONG_CELLS(ray->y0), z0 = AMONG_CELLS(ray->z0);
  const intN right = MASK(ray->dx > 0.0f), down = MASK(ray->dy > 0.0f), away = MASK(ray->dz > 0.0f);
  /* In either map the cube ends at the same faces ahead. */
  __global const uchar *maps = distances + view->octant_cells;
  const intN own = ((right & 1) | (down & 2) | (away & 4)) * view->octant_cells;
  const floatN fastest = lane_max(lane_max(fabs(ray->dx), fabs(ray->dy)), fabs(ray->dz));
  const floatN least_margin = FACE_MARGIN(view) / lane_max(fastest, (floatN)1e-12f);
  floatN entered = select(t, (floatN)INFINITY, active & MASK(t >= end));
  active &= MASK(t < end);
  while (any_lane(active)) {
    COUNT_LEAP(counted, active)
    /* Clamped as whole numbers, which takes a quarter of the time: each leap waits for the one before. */
    const intN cx = cell_of(x0 + t * ray->dx, shift, last_x), cy = cell_of(y0 + t * ray->dy, shift, last_y);
    const intN cz = cell_of(z0 + t * ray->dz, shift, last_z);
    const intN D = AS_INT(gather1(maps, own + (cz * slice + (cy * view->cells.x + cx))) & 255u);
    active &= MASK(D > zero);
    if (!any_lane(active)) break;
    const intN fx = select(cx - D + 1, cx + D, right) << shift;
    const intN fy = select(cy - D + 1, cy + D, down) << shift;
    const intN fz = select(cz - D + 1, cz + D, away) << shift;
    const floatN leave = lane_min(lane_min((TO_FLOAT(fx) - x0) * ray->rx + ray->px,
                                           (TO_FLOAT(fy) - y0) * ray->ry + ray->py),
                                  (TO_FLOAT(fz) - z0) * ray->rz + ray->pz);
    const floatN face = lane_max(leave, t), margin = least_margin + SHARE_OF_T * face;
    entered = select(entered, face - margin, active);
    t = select(t, face + margin, active);
    entered = select(entered, (floatN)INFINITY, active & MASK(t >= end));
    active &= MASK(t < end);
  }
  return entered;
}

#endif
