/* Closed meshes as clips: where a ray is inside, by how often it crosses triangles.
 *
 * A ray is inside where an odd number of crossings lies ahead. That holds without a gap only if a ray through an edge or
 * a vertex crosses one of the triangles there, not none and not two. Vertices are projected along the ray, onto the
 * same two numbers in each triangle that has them, and on which side of an edge the ray passes is found exactly, by
 * products with their rounding errors (fma). Where the ray meets an edge it passes as if it were moved by (e, e^2) for a
 * tiny e (Edelsbrunner and Muecke 1990). Woop, Benthin and Wald (2013) shear along the ray and go over to double
 * precision for that. Which side decides alone; where along the ray is rounded, and moves no crossing in or out.
 *
 * Boxes (clvol/device/mesh_clips.py) are in the order in which they are visited, each with the place behind all that it
 * holds, so no stack is needed. They are wider than what rounding moves a projected vertex by.
 */
#ifndef MESH_CLIP_H
#define MESH_CLIP_H

#include "lanes.h"
#include "scene.h"
#include "vectors.h"

typedef struct {
  Vectors origin, direction, inverse; /* local; how far is in the length of `direction` */
  Vectors u, v;                       /* across it */
  floatN per_square;
} MeshRays;

/* What lies ahead of a place on a ray. */
typedef struct {
  intN inside;
  floatN next;    /* the nearest crossing; infinite: there is none */
  Vectors normal; /* there, towards where the ray comes from */
} MeshAhead;

INLINE Vectors crossed(Vectors a, Vectors b)
{
  const Vectors r = {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
  return r;
}

INLINE floatN bounded_inverse(floatN d)
{
  return 1.0f / select(d, select((floatN)1e-20f, (floatN)-1e-20f, MASK(d < 0.0f)), MASK(fabs(d) < 1e-20f));
}

INLINE MeshRays mesh_rays(Vectors origin, Vectors direction)
{
  MeshRays r;
  r.origin = origin, r.direction = direction;
  r.inverse.x = bounded_inverse(direction.x);
  r.inverse.y = bounded_inverse(direction.y);
  r.inverse.z = bounded_inverse(direction.z);
  const floatN zero = 0.0f, one = 1.0f, square = dot3(direction, direction);
  const intN along_x = MASK(fabs(direction.x) > 0.8f * sqrt(square));
  const Vectors other = {select(one, zero, along_x), select(zero, one, along_x), zero};
  r.u = unit3(crossed(direction, other));
  r.v = unit3(crossed(direction, r.u));
  r.per_square = 1.0f / square;
  return r;
}

/* A vertex seen along the ray: the same numbers wherever it occurs. */
INLINE Vectors along_mesh_ray(const MeshRays *ray, float4 vertex)
{
  const Vectors from = {vertex.x - ray->origin.x, vertex.y - ray->origin.y, vertex.z - ray->origin.z};
  const Vectors r = {fma(from.x, ray->u.x, fma(from.y, ray->u.y, from.z * ray->u.z)),
                     fma(from.x, ray->v.x, fma(from.y, ray->v.y, from.z * ray->v.z)),
                     fma(from.x, ray->direction.x, fma(from.y, ray->direction.y, from.z * ray->direction.z)) *
                         ray->per_square};
  return r;
}

/* Whether the ray passes on the left of the edge from a to b; the opposite of that from b to a, unless they are one
 * point. `area`: twice that of the triangle between them and the ray. */
INLINE intN passes_left(Vectors a, Vectors b, floatN *area)
{
  const floatN p = a.x * b.y, q = a.y * b.x;
  const floatN p_error = fma(a.x, b.y, -p), q_error = fma(a.y, b.x, -q);
  *area = (p - q) + (p_error - q_error);
  const intN level = MASK(p == q), meets = level & MASK(p_error == q_error);
  const intN beside = MASK(p > q) | (level & MASK(p_error > q_error));
  const intN moved = MASK(a.y > b.y) | (MASK(a.y == b.y) & MASK(b.x > a.x));
  return select(beside, moved, meets);
}

/* Crossings beyond `from`, of rays in `wanted`, with the mesh in the items from `at` to `end`. */
INLINE MeshAhead mesh_ahead(const Scene *scene, int at, int end, const MeshRays *ray, floatN from, intN wanted)
{
  __global const float4 *items = scene->items;
  MeshAhead ahead;
  ahead.inside = 0, ahead.next = INFINITY;
  ahead.normal.x = ahead.normal.y = ahead.normal.z = 0.0f;
  while (at < end) {
    const float4 low = items[at], high = items[at + 1];
    const floatN ax = (low.x - ray->origin.x) * ray->inverse.x, bx = (high.x - ray->origin.x) * ray->inverse.x;
    const floatN ay = (low.y - ray->origin.y) * ray->inverse.y, by = (high.y - ray->origin.y) * ray->inverse.y;
    const floatN az = (low.z - ray->origin.z) * ray->inverse.z, bz = (high.z - ray->origin.z) * ray->inverse.z;
    const floatN near = lane_max(lane_max(lane_min(ax, bx), lane_min(ay, by)), lane_min(az, bz));
    const floatN far = lane_min(lane_min(lane_max(ax, bx), lane_max(ay, by)), lane_max(az, bz));
    if (!any_lane(wanted & MASK(far >= near) & MASK(far >= from))) {
      at = (int)low.w;
      continue;
    }
    const int count = (int)high.w;
    at += 2;
    _Pragma("unroll 1") for (int k = 0; k < count; ++k, at += 3) {
      const float4 first = items[at], second = items[at + 1], third = items[at + 2];
      const Vectors a = along_mesh_ray(ray, first), b = along_mesh_ray(ray, second), c = along_mesh_ray(ray, third);
      floatN of_a, of_b, of_c;
      const intN left_c = passes_left(a, b, &of_c), left_a = passes_left(b, c, &of_a), left_b = passes_left(c, a, &of_b);
      intN crosses = wanted & ((left_a & left_b & left_c) | ~(left_a | left_b | left_c));
      if (!any_lane(crosses)) continue;
      const floatN area = of_a + of_b + of_c;
      const intN flat = MASK(area == 0.0f);
      const floatN t = (of_a * a.z + of_b * b.z + of_c * c.z) / select(area, (floatN)1.0f, flat);
      const floatN low_t = lane_min(lane_min(a.z, b.z), c.z), high_t = lane_max(lane_max(a.z, b.z), c.z);
      const floatN place = lane_clamp(select(t, a.z, flat), low_t, high_t);
      crosses &= MASK(place > from);
      ahead.inside ^= crosses;
      const intN nearer = crosses & MASK(place < ahead.next);
      if (!any_lane(nearer)) continue;
      const Vectors one = broadcast3(second - first), other = broadcast3(third - first);
      const Vectors normal = crossed(one, other);
      const intN away = MASK(dot3(normal, ray->direction) > 0.0f);
      ahead.next = select(ahead.next, place, nearer);
      ahead.normal = select3(ahead.normal, select3(normal, scaled3(normal, -1.0f), away), nearer);
    }
  }
  ahead.normal = directed3(ahead.normal, 1.0f);
  return ahead;
}

#endif
