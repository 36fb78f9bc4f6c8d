/* Rays that go on in another direction. */
#ifndef BENT_RAYS_H
#define BENT_RAYS_H

#include "effects.h"
#include "rays.h"
#include "scene.h"
#include "vectors.h"

/* Rays (in edges) from `beyond` edges behind a lattice place on in a direction (local, unit length), to where they leave
 * the volume. depth: of the place, in edges from the eye. `ray` has what does not change. */
INLINE Rays rays_from(const Scene *scene, const Rays *ray, Vectors place, floatN depth, Vectors direction,
                      float beyond)
{
  __constant const Effects *e = scene->effects;
  Rays r = *ray;
  const floatN dx = e->gradient_x.x * direction.x + e->gradient_y.x * direction.y + e->gradient_z.x * direction.z;
  const floatN dy = e->gradient_x.y * direction.x + e->gradient_y.y * direction.y + e->gradient_z.y * direction.z;
  const floatN dz = e->gradient_x.z * direction.x + e->gradient_y.z * direction.y + e->gradient_z.z * direction.z;
  const floatN x = place.x, y = place.y, z = place.z;
  floatN enter = beyond, leave = INFINITY;
  clip_to_slab(x, dx, scene->view->upper.x, &enter, &leave);
  clip_to_slab(y, dy, scene->view->upper.y, &enter, &leave);
  clip_to_slab(z, dz, scene->view->upper.z, &enter, &leave);
  const intN inside = MASK(leave > enter);
  enter = select((floatN)0.0f, enter, inside), leave = select((floatN)-1.0f, leave, inside);
  r.x0 = x + enter * dx, r.y0 = y + enter * dy, r.z0 = z + enter * dz;
  r.dx = dx, r.dy = dy, r.dz = dz;
  r.rx = finite_inverse(r.dx, &r.px), r.ry = finite_inverse(r.dy, &r.py), r.rz = finite_inverse(r.dz, &r.pz);
  r.length = leave - enter;
  r.entry_depth = depth + enter;
  return r;
}

#endif
