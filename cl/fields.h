/* Further volumes on their own grids, looked up by place: colours and labels replace the volume's colours, labels weight
 * the extinction, densities add a medium of their own, masks cut.
 *
 * All voxels are floats in `fields`. The voxels of labels hold the label's place among those that have a colour, from 1
 * on, and 0 for all others; what is not finite is NaN. An axis of one voxel is stored twice. Those of colours
 * are words of square roots of linear light (clvol/device/voxel_colors.py), interpolated linearly as light. Tables are in
 * `factors`:
 * for labels (colour, factor) by their place, for densities the pieces of their function (transfer_pieces.h). Outside
 * its grid a field has no label and no density, and a mask removes everything.
 */
#ifndef FIELDS_H
#define FIELDS_H

#include "effects.h"
#include "emission.h"
#include "features.h"
#include "rays.h"
#include "scene.h"

#define OUTER_MARGIN 1e-3f /* voxels beyond the outermost ones that still count, for rounding */

typedef struct {
  floatN x, y, z; /* lattice point of the field, within it */
  intN inside;
} FieldPlace;

INLINE FieldPlace place_in_field(const Scene *scene, int k, floatN x, floatN y, floatN z)
{
  __constant const Effects *e = scene->effects;
  const float4 ax = e->fields[k].x, ay = e->fields[k].y, az = e->fields[k].z;
  const float4 lower = e->fields[k].lower, upper = e->fields[k].upper;
  const float4 last = convert_float4(e->fields[k].size) - 1.0f;
  FieldPlace p;
  p.x = ax.x * x + ax.y * y + ax.z * z + ax.w;
  p.y = ay.x * x + ay.y * y + ay.z * z + ay.w;
  p.z = az.x * x + az.y * y + az.z * z + az.w;
  p.inside = MASK(p.x >= lower.x - OUTER_MARGIN) & MASK(p.x <= upper.x + OUTER_MARGIN);
  p.inside &= MASK(p.y >= lower.y - OUTER_MARGIN) & MASK(p.y <= upper.y + OUTER_MARGIN);
  p.inside &= MASK(p.z >= lower.z - OUTER_MARGIN) & MASK(p.z <= upper.z + OUTER_MARGIN);
  p.x = lane_clamp(p.x, (floatN)0.0f, (floatN)last.x);
  p.y = lane_clamp(p.y, (floatN)0.0f, (floatN)last.y);
  p.z = lane_clamp(p.z, (floatN)0.0f, (floatN)last.z);
  return p;
}

INLINE floatN nearest_in_field(const Scene *scene, int k, FieldPlace p)
{
  const int4 size = scene->effects->fields[k].size;
  const intN ix = TO_INT(p.x + 0.5f), iy = TO_INT(p.y + 0.5f), iz = TO_INT(p.z + 0.5f);
  return AS_FLOAT(gather4(scene->fields + scene->effects->fields[k].first_voxel, (iz * size.y + iy) * size.x + ix));
}

/* Voxels of no weight do not count: they may be NaN. */
INLINE floatN mix_voxels(floatN a, floatN b, floatN share)
{
  const floatN mixed = select(a + share * (b - a), a, MASK(share == 0.0f));
  return select(mixed, b, MASK(share == 1.0f));
}

/* The first of the eight voxels around `p` in a field of `size`, and the shares of the others along each axis. */
INLINE intN cell_in_field(int4 size, FieldPlace p, floatN *fx, floatN *fy, floatN *fz)
{
  const intN ix = min(TO_INT(p.x), (intN)(size.x - 2)), iy = min(TO_INT(p.y), (intN)(size.y - 2));
  const intN iz = min(TO_INT(p.z), (intN)(size.z - 2));
  *fx = p.x - TO_FLOAT(ix), *fy = p.y - TO_FLOAT(iy), *fz = p.z - TO_FLOAT(iz);
  return (iz * size.y + iy) * size.x + ix;
}

INLINE floatN linear_in_field(const Scene *scene, int k, FieldPlace p)
{
  const int4 size = scene->effects->fields[k].size;
  __global const float *voxels = scene->fields + scene->effects->fields[k].first_voxel;
  floatN fx, fy, fz;
  const intN at = cell_in_field(size, p, &fx, &fy, &fz);
  floatN slices[2];
  _Pragma("unroll 1") for (int z = 0; z < 2; ++z) {
    __global const float *a = voxels + (size_t)z * size.x * size.y, *b = a + size.x;
    const floatN row0 = mix_voxels(AS_FLOAT(gather4(a, at)), AS_FLOAT(gather4(a + 1, at)), fx);
    const floatN row1 = mix_voxels(AS_FLOAT(gather4(b, at)), AS_FLOAT(gather4(b + 1, at)), fx);
    slices[z] = mix_voxels(row0, row1, fy);
  }
  return mix_voxels(slices[0], slices[1], fz);
}

#if FIELDS & FIELD_COLOR

/* The colour of field `k`, linear light. */
INLINE Vectors color_in_field(const Scene *scene, int k, FieldPlace p)
{
  const int4 size = scene->effects->fields[k].size;
  __global const float *voxels = scene->fields + scene->effects->fields[k].first_voxel;
  floatN fx, fy, fz;
  const intN at = cell_in_field(size, p, &fx, &fy, &fz);
  Vectors sum = {0.0f, 0.0f, 0.0f};
  _Pragma("unroll 1") for (int corner = 0; corner < 8; ++corner) {
    const int x = corner & 1, y = corner >> 1 & 1, z = corner >> 2;
    const floatN weight = (x ? fx : 1.0f - fx) * (y ? fy : 1.0f - fy) * (z ? fz : 1.0f - fz);
    const uintN word = AS_UINT(gather4(voxels + ((size_t)z * size.y + y) * size.x + x, at));
    const floatN r = TO_FLOAT(AS_INT(word & 0x7ffu)) * (1.0f / 2047.0f);
    const floatN g = TO_FLOAT(AS_INT(word >> 11 & 0x7ffu)) * (1.0f / 2047.0f);
    const floatN b = TO_FLOAT(AS_INT(word >> 22)) * (1.0f / 1023.0f);
    sum.x += weight * r * r, sum.y += weight * g * g, sum.z += weight * b * b;
  }
  return sum;
}

#endif

/* What fields make of a segment. */
typedef struct {
  Emission added; /* of a segment of one step, where the masks keep all of it */
  Vectors color;  /* of labels and voxels, in place of the volume's where `labelled` */
  intN labelled;
  floatN factor;  /* on the volume's extinction */
  floatN kept;    /* share that the masks keep */
} FieldLook;

INLINE FieldLook no_fields(void)
{
  FieldLook look;
  look.added = no_emission();
  look.color.x = look.color.y = look.color.z = 0.0f;
  look.labelled = 0, look.factor = 1.0f, look.kept = 1.0f;
  return look;
}

#if FIELDS & FIELD_DENSITY

/* Adds (c D, D) of a step through density `k` where its value is `value`, of the segment of `ray` from t0 to t1. Where
 * the opacity reaches 1 in a slope (has_pole) the extinction has a pole, which is integrated between the segment's
 * ends and its middle, not sampled. */
INLINE void add_density(const Scene *scene, int k, floatN value, const Rays *ray, floatN t0, floatN t1, intN there,
                        Emission *added)
{
  __constant const Effects *e = scene->effects;
  __constant const Field *field = &e->fields[k];
  __global const float *rows = scene->factors + e->fields[k].table;
  const Pieces f = {rows, (intN)0, field->piece_columns, field->piece_count, 0,
                    rows[ROW_ORIGIN * field->piece_columns], 1};
  const floatN units = field->edge_units * scene->view->step;
  there &= finite_lanes(value);
  value = select((floatN)0.0f, value, there);
  Emission own = emission_of_value(value, units, f);
  if (field->has_pole && any_lane(there)) {
    own = no_emission();
    _Pragma("unroll 1") for (int end = 0; end < 2; ++end) {
      const floatN t = end ? t1 : t0;
      const FieldPlace p = place_in_field(scene, k, ray->x0 + t * ray->dx, ray->y0 + t * ray->dy,
                                          ray->z0 + t * ray->dz);
      const floatN other = linear_in_field(scene, k, p);
      const Emission half_ = emission_of_color(color_of_segment(value, select(value, other, finite_lanes(other)),
                                                                0.5f * units, there, f));
      own.r += half_.r, own.g += half_.g, own.b += half_.b, own.d += half_.d;
    }
  }
  const floatN zero = 0.0f;
  added->r += select(zero, own.r, there), added->g += select(zero, own.g, there);
  added->b += select(zero, own.b, there), added->d += select(zero, own.d, there);
}

#endif

#if FIELDS & FIELD_MASK

/* How far above its threshold a mask is on the side that is kept; below 0 outside. `known`: whether there is any
 * mask. */
INLINE floatN above_mask(const Scene *scene, int k, floatN x, floatN y, floatN z, intN *known)
{
  __constant const Field *field = &scene->effects->fields[k];
  const FieldPlace p = place_in_field(scene, k, x, y, z);
  const floatN value = linear_in_field(scene, k, p);
  *known = p.inside & finite_lanes(value);
  return select((floatN)-1.0f, field->side * (value - field->threshold), *known);
}

/* Whether all masks keep a place. */
INLINE intN mask_keeps(const Scene *scene, floatN x, floatN y, floatN z, intN active, Tally *counted)
{
  intN kept = active;
  _Pragma("unroll 1") for (int k = 0; k < scene->effects->field_count; ++k) {
    if (scene->effects->fields[k].role != FIELD_MASK || !any_lane(kept)) continue;
    intN known;
    count_lanes(&counted[COUNT_FIELD_SAMPLES], kept);
    kept &= MASK(above_mask(scene, k, x, y, z, &known) >= 0.0f);
  }
  return kept;
}

/* The share that mask `k` keeps of the segment from t0 to t1: the mask runs linearly from end to end. */
INLINE floatN kept_share(const Scene *scene, int k, const Rays *ray, floatN t0, floatN t1)
{
  floatN ends[2];
  intN known = -1;
  _Pragma("unroll 1") for (int end = 0; end < 2; ++end) {
    const floatN t = end ? t1 : t0;
    intN known_here;
    ends[end] = above_mask(scene, k, ray->x0 + t * ray->dx, ray->y0 + t * ray->dy, ray->z0 + t * ray->dz, &known_here);
    known &= known_here;
  }
  const floatN none = 0.0f, whole = 1.0f;
  const intN first = MASK(ends[0] >= 0.0f), last = MASK(ends[1] >= 0.0f), crosses = first ^ last;
  const floatN place = ends[0] / select(whole, ends[0] - ends[1], crosses);
  const floatN kept = select(select(none, whole, first & last), select(whole - place, place, first), crosses);
  return select(none, kept, known);
}

/* The share that all masks keep; 0 for rays that are not active. */
INLINE floatN kept_by_masks(const Scene *scene, const Rays *ray, floatN t0, floatN t1, intN active, Tally *counted)
{
  floatN share = select((floatN)0.0f, (floatN)1.0f, active);
  _Pragma("unroll 1") for (int k = 0; k < scene->effects->field_count; ++k) {
    const intN kept = MASK(share > 0.0f);
    if (scene->effects->fields[k].role != FIELD_MASK || !any_lane(kept)) continue;
    count_lanes(&counted[COUNT_FIELD_SAMPLES], kept), count_lanes(&counted[COUNT_FIELD_SAMPLES], kept);
    share *= kept_share(scene, k, ray, t0, t1);
  }
  return share;
}

#endif

/* What the fields make of a segment of `ray` from t0 to t1 with its middle at (x, y, z), where the volume itself may
 * show something (`shows`), for the rays in `active`. */
INLINE FieldLook look_at_fields(const Scene *scene, const Rays *ray, floatN t0, floatN t1, floatN x, floatN y, floatN z,
                                intN shows, intN active, Tally *counted)
{
  __constant const Effects *e = scene->effects;
  FieldLook look = no_fields();
#if FIELDS & FIELD_DENSITY
  _Pragma("unroll 1") for (int k = 0; k < e->field_count; ++k) {
    if (e->fields[k].role != FIELD_DENSITY) continue;
    const FieldPlace p = place_in_field(scene, k, x, y, z);
    const intN there = active & p.inside;
    if (!any_lane(there)) continue;
    count_lanes(&counted[COUNT_FIELD_SAMPLES], there);
    add_density(scene, k, linear_in_field(scene, k, p), ray, t0, t1, there, &look.added);
  }
#endif
#if FIELDS & FIELD_COLOR
  if (any_lane(shows)) {
    _Pragma("unroll 1") for (int k = 0; k < e->field_count; ++k) {
      if (e->fields[k].role != FIELD_COLOR) continue;
      const FieldPlace p = place_in_field(scene, k, x, y, z);
      const intN there = shows & p.inside;
      if (!any_lane(there)) continue;
      count_lanes(&counted[COUNT_FIELD_SAMPLES], there);
      look.color = select3(look.color, color_in_field(scene, k, p), there);
      look.labelled |= there;
    }
  }
#endif
#if FIELDS & FIELD_LABEL
  if (any_lane(shows)) {
    _Pragma("unroll 1") for (int k = 0; k < e->field_count; ++k) {
      if (e->fields[k].role != FIELD_LABEL) continue;
      const FieldPlace p = place_in_field(scene, k, x, y, z);
      const floatN code = nearest_in_field(scene, k, p);
      const intN labelled = shows & p.inside & MASK(code > 0.0f);
      count_lanes(&counted[COUNT_FIELD_SAMPLES], shows & p.inside);
      __global const float *labels = scene->factors + e->fields[k].table;
      const intN entry = 4 * select((intN)0, TO_INT(code), labelled);
      const Vectors color = {AS_FLOAT(gather4(labels, entry)), AS_FLOAT(gather4(labels + 1, entry)),
                             AS_FLOAT(gather4(labels + 2, entry))};
      look.color = select3(look.color, color, labelled);
      look.factor *= AS_FLOAT(gather4(labels + 3, entry));
      look.labelled |= labelled;
    }
  }
#endif
#if FIELDS & FIELD_MASK
  look.kept = kept_by_masks(scene, ray, t0, t1, active & (shows | MASK(look.added.d > 0.0f)), counted);
#endif
  return look;
}

/* The volume's own emission with what the fields make of it. */
INLINE void apply_fields(FieldLook look, Emission *e)
{
  e->d *= look.factor;
  const floatN factor = look.factor;
  e->r = select(e->r * factor, look.color.x * e->d, look.labelled) + look.added.r;
  e->g = select(e->g * factor, look.color.y * e->d, look.labelled) + look.added.g;
  e->b = select(e->b * factor, look.color.z * e->d, look.labelled) + look.added.b;
  e->d += look.added.d;
  e->r *= look.kept, e->g *= look.kept, e->b *= look.kept, e->d *= look.kept;
}

#endif
