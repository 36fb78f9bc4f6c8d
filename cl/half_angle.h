/* Half-angle slices: the volume is cut into slabs across the vector half way between light and view, or, where light
 * comes towards the eye, between light and the opposite of the view. Both then cross the slabs at no less than 45
 * degrees, so that light can be swept through them slab by slab, over a buffer of texels that are rays of the light,
 * and each slab is shown as it was lit (Kniss, Premoze, Hansen, Shirley, McPherson, A model for volume lighting and
 * modeling, 2003).
 *
 * They blend each slice into the picture as soon as it is lit, and keep two buffers of light. Here the light of all
 * slabs is kept, a texture per slab, so that pixels are rendered in any order, on several devices, and end where they
 * are opaque. The light is the same.
 *
 * The host fills it (clvol/integrators/slicing/half_angle.py); light_slices.cl sweeps the light, march_half_angle.h
 * shows it.
 */
#ifndef HALF_ANGLE_H
#define HALF_ANGLE_H

#include "struct_fields.h"

typedef struct {
  float4 across;                    /* slab k holds the lattice points with k <= across . (x, y, z, 1) < k + 1 */
  float4 light_x, light_y, light_w; /* lattice point, 1, to column w, row w and w of the light's texels */
  int4 size;                        /* texels: columns, rows; slabs */
  float own_share;                  /* of what a slab absorbs, in front of where it is lit: 0 or 1/2 */
  float texels;                     /* per edge across the light; of a point light, at the distance of one edge */
  int is_point;                     /* whether the light is at a point */
} HalfAngle;

#define HALF_ANGLE_FIELDS \
  STRUCT(HalfAngle), FIELD(HalfAngle, across), FIELD(HalfAngle, light_x), FIELD(HalfAngle, light_y), \
  FIELD(HalfAngle, light_w), FIELD(HalfAngle, size), FIELD(HalfAngle, own_share), FIELD(HalfAngle, texels), \
  FIELD(HalfAngle, is_point)

#endif
