/* A packet's rays against the volume's domain.
 *
 * Positions along a ray are origin + t * step with t counted from the entry, never accumulated.
 */
#ifndef RAYS_H
#define RAYS_H

#include "lanes.h"
#include "view.h"

typedef struct {
  floatN x0, y0, z0;   /* lattice point of entry */
  floatN dx, dy, dz;   /* lattice units per step */
  floatN rx, ry, rz;   /* their inverses, finite */
  floatN px, py, pz;   /* infinite along an axis that the ray does not move on, else 0: no face is met there */
  floatN length;       /* from entry to exit, in steps; below 0: the ray misses */
  floatN entry_depth;  /* distance from the eye (or camera plane) to the entry, in smallest voxel edges */
} Rays;

/* Below this a direction's component counts as parallel to the faces: the ray is in the slab, or never is. */
#define PARALLEL 1e-20f

INLINE void clip_to_slab(floatN origin, floatN direction, float upper, floatN *enter, floatN *leave)
{
  const intN parallel = MASK(fabs(direction) < PARALLEL);
  const intN inside = MASK(origin >= 0.0f) & MASK(origin <= upper);
  const floatN inverse = 1.0f / select(direction, (floatN)1.0f, parallel);
  const floatN a = -origin * inverse, b = (upper - origin) * inverse;
  const floatN never = select((floatN)INFINITY, -(floatN)INFINITY, inside);
  *enter = lane_max(select(lane_min(a, b), never, parallel), *enter);
  *leave = lane_min(select(lane_max(a, b), -never, parallel), *leave);
}

INLINE floatN finite_inverse(floatN d, floatN *never)
{
  const intN still = MASK(fabs(d) < 1e-12f);
  *never = select((floatN)0.0f, (floatN)INFINITY, still);
  return 1.0f / select(d, (floatN)1e-12f, still);
}

/* Rays through the centres of the pixels (column, row), row 0 on top, with steps of h edges. */
INLINE Rays make_rays_of_step(__constant const View *view, floatN column, floatN row, float h)
{
  Rays r;
  const floatN u = column - view->centre.x, v = row - view->centre.y;
  const floatN a = u * view->tangent.x, b = v * view->tangent.y;
  const floatN length = sqrt(1.0f + a * a + b * b), inverse = 1.0f / length;
  const floatN px = view->plane_origin.x + u * view->plane_du.x + v * view->plane_dv.x;
  const floatN py = view->plane_origin.y + u * view->plane_du.y + v * view->plane_dv.y;
  const floatN pz = view->plane_origin.z + u * view->plane_du.z + v * view->plane_dv.z;
  const floatN dx = (view->ray_forward.x + u * view->ray_du.x + v * view->ray_dv.x) * inverse;
  const floatN dy = (view->ray_forward.y + u * view->ray_du.y + v * view->ray_dv.y) * inverse;
  const floatN dz = (view->ray_forward.z + u * view->ray_du.z + v * view->ray_dv.z) * inverse;
  const floatN to_plane = view->plane_distance * length;
  floatN enter = -to_plane, leave = INFINITY;
  clip_to_slab(px, dx, view->upper.x, &enter, &leave);
  clip_to_slab(py, dy, view->upper.y, &enter, &leave);
  clip_to_slab(pz, dz, view->upper.z, &enter, &leave);
  const intN hits = MASK(leave > enter);
  enter = select((floatN)0.0f, enter, hits);
  leave = select((floatN)-h, leave, hits);
  r.x0 = px + enter * dx, r.y0 = py + enter * dy, r.z0 = pz + enter * dz;
  r.dx = dx * h, r.dy = dy * h, r.dz = dz * h;
  r.rx = finite_inverse(r.dx, &r.px), r.ry = finite_inverse(r.dy, &r.py), r.rz = finite_inverse(r.dz, &r.pz);
  r.length = (leave - enter) / h;
  r.entry_depth = enter + to_plane;
  return r;
}

INLINE Rays make_rays(__constant const View *view, floatN column, floatN row)
{
  return make_rays_of_step(view, column, row, view->step);
}

/* Rays whose unit of length is `h` times as long. */
INLINE Rays rays_in_steps(Rays r, float h)
{
  const float shorter = 1.0f / h;
  r.dx *= h, r.dy *= h, r.dz *= h;
  r.rx *= shorter, r.ry *= shorter, r.rz *= shorter;
  r.length = r.length / h;
  return r;
}

INLINE Rays select_rays(Rays a, Rays b, intN mask)
{
  a.x0 = select(a.x0, b.x0, mask), a.y0 = select(a.y0, b.y0, mask), a.z0 = select(a.z0, b.z0, mask);
  a.dx = select(a.dx, b.dx, mask), a.dy = select(a.dy, b.dy, mask), a.dz = select(a.dz, b.dz, mask);
  a.rx = select(a.rx, b.rx, mask), a.ry = select(a.ry, b.ry, mask), a.rz = select(a.rz, b.rz, mask);
  a.px = select(a.px, b.px, mask), a.py = select(a.py, b.py, mask), a.pz = select(a.pz, b.pz, mask);
  a.length = select(a.length, b.length, mask), a.entry_depth = select(a.entry_depth, b.entry_depth, mask);
  return a;
}

#endif
