/* The slices of a picture (march_slices.h): slice k is at first + k spacing. The host fills it
 * (clvol/integrators/slicing/slices.py). */
#ifndef SLICES_H
#define SLICES_H

#include "struct_fields.h"

typedef struct {
  float first;     /* along an axis: lattice coordinate of slice 0. Else in steps behind the reference plane (view.h) */
  float spacing;   /* along an axis: lattice units between slices. Else steps */
  float thickness; /* steps of a slice that is seen from the front */
  int axis;        /* that the slices are perpendicular to: 0, 1, 2 for x, y, z */
  int count;       /* slices along an axis; the others are as many as a ray meets */
} Slices;

#define SLICES_FIELDS \
  STRUCT(Slices), FIELD(Slices, first), FIELD(Slices, spacing), FIELD(Slices, thickness), FIELD(Slices, axis), \
  FIELD(Slices, count)

#endif
