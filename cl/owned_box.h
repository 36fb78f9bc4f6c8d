/* OWNED_BOX: this device has a part of the volume, and renders a part of each ray (sort-last; Molnar et al. 1994).
 *
 * Boxes fill the volume without gaps and overlaps. Rays are those of the whole volume, and so are their steps; a segment
 * is composited by the one device whose box holds its front: at or beyond `owned_from`, before `owned_to`. Every
 * device computes the place of a front by the same operations on the same numbers, so that of two boxes beside each other
 * exactly one has it, whatever rounding does. What a segment looks at beyond the box is stored, too (ghost voxels). Of a
 * projection the samples count whose segments the box owns.
 */
#ifndef OWNED_BOX_H
#define OWNED_BOX_H

#include "lanes.h"
#include "rays.h"
#include "view.h"

#if OWNED_BOX
INLINE intN owns_front(__constant const View *view, const Rays *ray, floatN t)
{
  const floatN x = ray->x0 + t * ray->dx, y = ray->y0 + t * ray->dy, z = ray->z0 + t * ray->dz;
  return MASK(x >= view->owned_from.x) & MASK(x < view->owned_to.x) & MASK(y >= view->owned_from.y) &
      MASK(y < view->owned_to.y) & MASK(z >= view->owned_from.z) & MASK(z < view->owned_to.z);
}
#else
#define owns_front(view, ray, t) ((intN)(-1))
#endif

/* Where opacity reaches one half depends on what is in front of the box: rays begin with that opacity, which the host
 * knows once all pictures are there, and puts where depths are written. Colours are of no use then. */
#if OWNED_BOX && WITH_DEPTH
#define BEGIN_OPACITY(acc, depth) acc.a = LOAD_LANES(depth);
#else
#define BEGIN_OPACITY(acc, depth)
#endif

#endif
