/* Which stretches of a ray are kept: clip planes, boxes, spheres and closed meshes, exactly along the ray.
 *
 * A clip but for a mesh (mesh_clip.h) keeps or removes a convex set, so that a ray is inside it along one stretch. Each
 * is three items: (kind, -, -, radius); point or centre or lower corner; normal or upper corner; all local. The first
 * `kept_clips` keep what is inside, the next `removed_clips` remove it. Within a stretch nothing is clipped, and so no
 * sample, segment or shadow knows of it.
 */
#ifndef CLIP_H
#define CLIP_H

#include "effects.h"
#include "features.h"
#include "rays.h"
#include "scene.h"
#if MESH_CLIPS
#include "mesh_clip.h"
#endif

#define LEAST_CUT 1e-3f /* edges: where less of a ray is cut off, no cut face shows */

typedef struct {
  floatN enter, leave;    /* in steps from the ray's entry into the volume; leave <= enter: nothing more is kept */
  /* of the clip that the stretch begins at, outwards of what is kept; 0 where it begins at none */
  Vectors normal;
} Stretch;

/* One axis of a box. */
INLINE void clip_axis(floatN origin, floatN direction, float low, float high, int axis, floatN *enter, floatN *leave,
                      intN *face)
{
  const intN parallel = MASK(fabs(direction) < 1e-12f);
  const intN inside = MASK(origin >= low) & MASK(origin <= high);
  const floatN inverse = 1.0f / select(direction, (floatN)1.0f, parallel);
  const floatN a = (low - origin) * inverse, b = (high - origin) * inverse;
  const floatN never = select((floatN)1e30f, (floatN)-1e30f, inside);
  const floatN from = select(lane_min(a, b), never, parallel), to = select(lane_max(a, b), -never, parallel);
  *face = select(*face, (intN)axis, MASK(from > *enter));
  *enter = lane_max(*enter, from), *leave = lane_min(*leave, to);
}

/* Where the ray origin + t direction (local) is inside clip `k`; enter > leave: nowhere. `normal` outwards, where it
 * enters. */
INLINE void inside_clip(const Scene *scene, int k, Vectors origin, Vectors direction, floatN *enter, floatN *leave,
                        Vectors *normal)
{
  __global const float4 *item = scene->items + scene->effects->first_clip + 3 * k;
  const float4 kind = item[0], a = item[1], b = item[2];
  *enter = -1e30f, *leave = 1e30f;
  if (kind.x == CLIP_PLANE) {
    const Vectors n = broadcast3(b);
    const Vectors from = {origin.x - a.x, origin.y - a.y, origin.z - a.z};
    const floatN height = dot3(from, n), rises = dot3(direction, n);
    const intN parallel = MASK(fabs(rises) < 1e-12f);
    const floatN t = -height / select(rises, (floatN)1.0f, parallel);
    const floatN none = select((floatN)1e30f, (floatN)-1e30f, MASK(height >= 0.0f));
    *enter = select(select((floatN)-1e30f, t, MASK(rises > 0.0f)), none, parallel);
    *leave = select(select((floatN)1e30f, t, MASK(rises < 0.0f)), (floatN)1e30f, parallel);
    *normal = scaled3(n, -1.0f);
  } else if (kind.x == CLIP_BOX) {
    intN face = 0;
    clip_axis(origin.x, direction.x, a.x, b.x, 0, enter, leave, &face);
    clip_axis(origin.y, direction.y, a.y, b.y, 1, enter, leave, &face);
    clip_axis(origin.z, direction.z, a.z, b.z, 2, enter, leave, &face);
    const floatN zero = 0.0f, one = 1.0f;
    normal->x = select(zero, select(one, -one, MASK(direction.x > 0.0f)), MASK(face == 0));
    normal->y = select(zero, select(one, -one, MASK(direction.y > 0.0f)), MASK(face == 1));
    normal->z = select(zero, select(one, -one, MASK(direction.z > 0.0f)), MASK(face == 2));
  } else {
    /* The nearest point of the ray first: the difference of two large squares would lose the digits. */
    const Vectors from = {origin.x - a.x, origin.y - a.y, origin.z - a.z};
    const floatN square = dot3(direction, direction), nearest = -dot3(from, direction) / square;
    const Vectors foot = sum3(from, scaled3(direction, nearest));
    const floatN room = kind.w * kind.w - dot3(foot, foot);
    const intN meets = MASK(room > 0.0f);
    const floatN reach = sqrt(select((floatN)0.0f, room, meets) / square);
    *enter = select((floatN)1e30f, nearest - reach, meets), *leave = select((floatN)-1e30f, nearest + reach, meets);
    *normal = scaled3(sum3(foot, scaled3(direction, -reach)), 1.0f / kind.w);
  }
}

/* Moves the start of stretches out of what clips remove. */
INLINE void leave_holes(const Scene *scene, Vectors origin, Vectors direction, Stretch *s)
{
  __constant const Effects *e = scene->effects;
  Vectors normal;
  floatN enter, leave;
  const int holes = e->removed_clips;
  /* Out of one hole may be into another: each pass leaves at least one for good. */
  _Pragma("unroll 1") for (int pass = 0; pass < holes; ++pass) {
    intN moved = 0;
    _Pragma("unroll 1") for (int k = 0; k < holes; ++k) {
      inside_clip(scene, e->kept_clips + k, origin, direction, &enter, &leave, &normal);
      const intN within = MASK(enter <= s->enter) & MASK(s->enter < leave);
      /* Where the ray leaves a convex set its face looks along the ray, and what is kept lies beyond. */
      const Vectors at = sum3(origin, scaled3(direction, leave));
      Vectors outwards;
      floatN back_enter, back_leave;
      inside_clip(scene, e->kept_clips + k, at, scaled3(direction, -1.0f), &back_enter, &back_leave, &outwards);
      s->normal = select3(s->normal, scaled3(outwards, -1.0f), within);
      s->enter = select(s->enter, leave, within);
      moved |= within;
    }
    if (!any_lane(moved)) break;
  }
}

#if MESH_CLIPS
/* Moves the start of stretches to where every mesh keeps what follows, and finds where the first one no longer does.
 * Returns the rays that were moved. */
INLINE intN enter_meshes(const Scene *scene, const MeshRays *ray, Stretch *s, floatN *until)
{
  __constant const Effects *e = scene->effects;
  __global const float4 *item = scene->items + e->first_clip + 3 * (e->kept_clips + e->removed_clips);
  intN moved = 0;
  *until = INFINITY;
  _Pragma("unroll 1") for (int k = 0; k < e->mesh_clips; ++k, item += 3) {
    const intN there = MASK(s->enter < s->leave);
    if (!any_lane(there)) break;
    const MeshAhead ahead = mesh_ahead(scene, (int)item[1].x, (int)item[1].y, ray, s->enter, there);
    const intN removed = there & (item[0].y != 0.0f ? ~ahead.inside : ahead.inside);
    s->normal = select3(s->normal, ahead.normal, removed);
    s->enter = select(s->enter, lane_min(ahead.next, s->leave), removed);
    *until = lane_min(*until, ahead.next);
    moved |= removed;
  }
  return moved;
}
#endif

/* The next stretch of the ray at or after `from` (in steps of `step` edges). */
INLINE Stretch next_stretch(const Scene *scene, const Rays *ray, floatN from, float step)
{
  __constant const Effects *e = scene->effects;
  const Vectors origin = to_local(e, ray->x0, ray->y0, ray->z0);
  const Vectors direction = direction_to_local(e, ray->dx, ray->dy, ray->dz);
  Stretch s;
  Vectors normal;
  floatN enter, leave;
  s.enter = from, s.leave = ray->length;
  s.normal.x = s.normal.y = s.normal.z = 0.0f;
  _Pragma("unroll 1") for (int k = 0; k < e->kept_clips; ++k) {
    inside_clip(scene, k, origin, direction, &enter, &leave, &normal);
    const intN later = MASK(enter > s.enter);
    s.normal = select3(s.normal, normal, later);
    s.enter = select(s.enter, enter, later), s.leave = lane_min(s.leave, leave);
  }
  const int holes = e->removed_clips;
#if MESH_CLIPS
  /* Out of a mesh may be into a hole, or another mesh. */
  const MeshRays of_meshes = mesh_rays(origin, direction);
  floatN until;
  for (;;) {
    leave_holes(scene, origin, direction, &s);
    if (!any_lane(enter_meshes(scene, &of_meshes, &s, &until))) break;
  }
  s.leave = lane_min(s.leave, until);
#else
  leave_holes(scene, origin, direction, &s);
#endif
  _Pragma("unroll 1") for (int k = 0; k < holes; ++k) {
    inside_clip(scene, e->kept_clips + k, origin, direction, &enter, &leave, &normal);
    s.leave = select(s.leave, lane_min(s.leave, enter), MASK(leave > enter) & MASK(enter > s.enter));
  }
  /* A clip through the domain's own face cuts nothing off: rounding may not tell. */
  const Vectors none = {0.0f, 0.0f, 0.0f};
  s.normal = select3(none, s.normal, MASK(s.enter > from + LEAST_CUT / step));
  return s;
}

/* The ray from `enter` to `leave` alone. */
INLINE Rays ray_along(const Rays *ray, floatN enter, floatN leave, intN kept, float step)
{
  Rays r = *ray;
  const floatN start = select((floatN)0.0f, enter, kept);
  r.x0 += start * r.dx, r.y0 += start * r.dy, r.z0 += start * r.dz;
  r.length = select((floatN)-1.0f, leave - enter, kept);
  r.entry_depth += start * step;
  return r;
}

#endif
