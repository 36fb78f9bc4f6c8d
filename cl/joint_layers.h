/* Joint transfer functions of the volume's value and those of one or two further fields (Engel and Ertl 2002, section 5;
 * Kniss, Kindlmann and Hansen 2001): functions of the volume's value stand at the points of a grid over the fields'
 * values, and what they emit and absorb is linear between them.
 *
 * The values at which functions stand are in `factors`, those of the first field before those of the second; their tables
 * are in `table`, those along the first field's axis one behind the other, row by row. Where a field has no value its first
 * one counts.
 */
#ifndef JOINT_LAYERS_H
#define JOINT_LAYERS_H

#include "fields.h"
#include "opacity_factors.h"

/* The functions around the place (x, y, z), of `floats` each. */
INLINE TablePlace joint_layers(const Scene *scene, floatN x, floatN y, floatN z, intN active, int floats, Tally *counted)
{
  __constant const Effects *e = scene->effects;
  TablePlace found = {0, 0, 0.0f, 0, 0.0f};
  int axis = 0;
  _Pragma("unroll 1") for (int k = 0; k < e->field_count; ++k) {
    if (e->fields[k].role != FIELD_VALUE) continue;
    const FieldPlace p = place_in_field(scene, k, x, y, z);
    const floatN value = linear_in_field(scene, k, p);
    const intN known = p.inside & finite_lanes(value);
    count_lanes(&counted[COUNT_FIELD_SAMPLES], active & p.inside);
    __global const float *places = scene->factors + e->layer_table + axis * e->layer_count;
    const TablePlace t = place_in_table(places, axis ? e->layer_rows : e->layer_count,
                                        select((floatN)places[0], value, known));
    if (axis == 0) {
      found.low = t.low * floats, found.high = t.high * floats, found.share = t.share;
    } else {
      const int row = e->layer_count * floats;
      found.low += t.low * row, found.high += t.low * row;
      found.next_row = (t.high - t.low) * row, found.row_share = t.share;
    }
    ++axis;
  }
  return found;
}

#endif
