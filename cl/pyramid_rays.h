/* Rays by slices: a place is origin + k * way, k the slice. Slice k is k steps behind the shell around the eye that
 * touches the view's reference plane (view.h), or behind that plane itself; so an eye that is far away costs float32
 * no digits, near the view's axis.
 */
#ifndef PYRAMID_RAYS_H
#define PYRAMID_RAYS_H

#include "lanes.h"
#include "pyramid.h"
#include "rays.h"
#include "view.h"

typedef struct {
  floatN x0, y0, z0;   /* lattice place at slice 0 */
  floatN dx, dy, dz;   /* way per slice */
  floatN enter, leave; /* slices at which the ray meets the volume's hull */
  intN hits;
} SliceRays;

/* Through the picture at (column, row), in pixels, which need not be whole or inside. `clipped`: with enter, leave and
 * hits. */
INLINE SliceRays slice_rays(__constant const View *view, floatN column, floatN row, int clipped)
{
  SliceRays r;
  const floatN u = column - view->centre.x, v = row - view->centre.y;
  const floatN a = u * view->tangent.x, b = v * view->tangent.y, square = a * a + b * b;
  const floatN length = sqrt(1.0f + square), inverse = 1.0f / length;
  const floatN px = view->plane_origin.x + u * view->plane_du.x + v * view->plane_dv.x;
  const floatN py = view->plane_origin.y + u * view->plane_du.y + v * view->plane_dv.y;
  const floatN pz = view->plane_origin.z + u * view->plane_du.z + v * view->plane_dv.z;
  const floatN dx = (view->ray_forward.x + u * view->ray_du.x + v * view->ray_dv.x) * inverse;
  const floatN dy = (view->ray_forward.y + u * view->ray_du.y + v * view->ray_dv.y) * inverse;
  const floatN dz = (view->ray_forward.z + u * view->ray_du.z + v * view->ray_dv.z) * inverse;
  const floatN back = -view->plane_distance * square / (1.0f + length); /* from the plane to slice 0, along the ray */
  const float h = view->step;
  r.x0 = px + back * dx, r.y0 = py + back * dy, r.z0 = pz + back * dz;
  r.dx = dx * h, r.dy = dy * h, r.dz = dz * h;
  r.enter = r.leave = 0.0f, r.hits = 0;
  if (clipped) {
    floatN enter = -view->plane_distance * length, leave = INFINITY;
    clip_to_slab(px, dx, view->upper.x, &enter, &leave);
    clip_to_slab(py, dy, view->upper.y, &enter, &leave);
    clip_to_slab(pz, dz, view->upper.z, &enter, &leave);
    r.hits = MASK(leave > enter);
    r.enter = select((floatN)0.0f, (enter - back) / h, r.hits),
        r.leave = select((floatN)0.0f, (leave - back) / h, r.hits);
  }
  return r;
}

#define LEAST_CUT_EDGES 1e-3f /* where less of a ray is cut off, no cut face shows (LEAST_CUT of clip.h) */

/* Cuts rays by what clips keep: half-spaces, so that one stretch is left at most. Returns by which of them each ray
 * enters what is kept, or -1. */
INLINE intN clip_to_halves(SliceRays *r, __constant const Pyramid *pyramid, float step)
{
  const floatN least = r->enter + LEAST_CUT_EDGES / step;
  intN cut = -1;
  for (int j = 0; j < pyramid->half_count; ++j) {
    const float4 half_ = pyramid->halves[j];
    const floatN height = r->x0 * half_.x + r->y0 * half_.y + r->z0 * half_.z + half_.w;
    const floatN rises = r->dx * half_.x + r->dy * half_.y + r->dz * half_.z;
    const intN parallel = MASK(fabs(rises) < 1e-12f);
    const floatN at = -height / select(rises, (floatN)1.0f, parallel);
    const intN enters = MASK(rises > 0.0f) & ~parallel, leaves = MASK(rises < 0.0f) & ~parallel;
    cut = select(cut, (intN)j, enters & MASK(at > lane_max(r->enter, least)));
    r->enter = select(r->enter, lane_max(r->enter, at), enters);
    r->leave = select(r->leave, lane_min(r->leave, at), leaves);
    r->hits &= ~(parallel & MASK(height < 0.0f));
  }
  r->hits &= MASK(r->leave > r->enter);
  return cut;
}

#endif
