/* Empty space: a map of the distance (in cells, maximum norm) from each cell to the nearest cell in which anything can be
 * visible. 0: visible here. D > 0: everything within D - 1 cells around is transparent, and a ray may leap
 * out of that cube at once. (Distance maps: Zuiderveld et al. 1992; Deakin and Knackstedt 2019 for the Chebyshev form.)
 *
 * What is leapt over contributes exactly nothing, so the image does not change by a bit.
 */
#ifndef SKIP_EMPTY_H_INCLUDED
#define SKIP_EMPTY_H_INCLUDED

#include "rays.h"

/* Margin in steps that absorbs rounding: a leap ends a little before the face of the cube, never after it. */
#define LEAP_MARGIN 2e-3f

/* For each ray at parameter t (in steps): the parameter up to which it runs through cells that are all empty. `empty` tells
 * which lanes stand in an empty cell; the number means nothing for the others. */
inline floatN leap_until(__global const uchar *distances, __constant const View *view, floatN t, const Rays *ray,
                         intN *empty)
{
  const int shift = view->cells.w;
  const intN zero = 0;
  const intN cx = clamp(TO_INT(clamp(ray->x0 + t * ray->dx, (floatN)0.0f, (floatN)view->upper.x)) >> shift, zero, (intN)(view->cells.x - 1));
  const intN cy = clamp(TO_INT(clamp(ray->y0 + t * ray->dy, (floatN)0.0f, (floatN)view->upper.y)) >> shift, zero, (intN)(view->cells.y - 1));
  const intN cz = clamp(TO_INT(clamp(ray->z0 + t * ray->dz, (floatN)0.0f, (floatN)view->upper.z)) >> shift, zero, (intN)(view->cells.z - 1));
  const intN D = AS_INT(gather1(distances, (cz * view->cells.y + cy) * view->cells.x + cx) & 255u);
  *empty = MASK(D > 0);
  const intN fx = select(cx - D + 1, cx + D, MASK(ray->dx > 0.0f)) << shift;
  const intN fy = select(cy - D + 1, cy + D, MASK(ray->dy > 0.0f)) << shift;
  const intN fz = select(cz - D + 1, cz + D, MASK(ray->dz > 0.0f)) << shift;
  const floatN qx = (TO_FLOAT(fx) - ray->x0) * ray->rx, qy = (TO_FLOAT(fy) - ray->y0) * ray->ry, qz = (TO_FLOAT(fz) - ray->z0) * ray->rz;
  return min(min(qx, qy), qz) - LEAP_MARGIN;
}

#endif
