/* The gradient of the field of blocks: central differences, over a voxel to each side, of the values that
 * blend_blocks.h makes. They are continuous wherever these are, across the faces of blocks of any two resolutions; and
 * where voxels are at full resolution they are the voxels' own differences interpolated, as in gradient.h. Beyond the
 * volume's faces the field goes on in a straight line, f(-d) = 2 f(0) - f(d), which makes the differences one-sided.
 */
#ifndef GRADIENT_BLOCKS_H
#define GRADIENT_BLOCKS_H

#include "block_runs.h"
#include "gradient.h"
#include "lanes.h"

/* One end of a difference along an axis, `at` + `side`: the coordinate that is sampled there; whether it is beyond the
 * face at 0 or `upper`, and what is at it counts mirrored. */
INLINE floatN mirrored_end(floatN at, float side, float upper, intN *beyond)
{
  const floatN there = at + side, zero = 0.0f, far = upper;
  const intN below = MASK(there < zero), above = MASK(there > far);
  *beyond = below | above;
  return select(select(there, zero - there, below), 2.0f * far - there, above);
}

/* Half the difference of two values; one that rounding may have made is none, and has no direction. */
#define LEAST_DIFFERENCE 1.5e-7f
INLINE floatN half_difference(floatN low, floatN high)
{
  const floatN difference = high - low, least = LEAST_DIFFERENCE * (fabs(low) + fabs(high));
  return select(0.5f * difference, (floatN)0.0f, MASK(fabs(difference) < least));
}

/* At a lattice point, per lattice unit; lanes that are not `wanted` get anything. */
INLINE Gradient blocks_gradient(const BlockVolume *v, floatN x, floatN y, floatN z, intN wanted, Tally *tally)
{
  const float4 upper = v->view->upper;
  const floatN zero = 0.0f, half_ = 0.5f;
  x = lane_clamp(x, zero, (floatN)upper.x), y = lane_clamp(y, zero, (floatN)upper.y);
  z = lane_clamp(z, zero, (floatN)upper.z);
  BlockRun run;
  run_begin(&run);
  Record here = record_at(v, x + half_, y + half_, z + half_);
  int kind = alike(v, &here);
  intN beyond[6], any = 0;
  _Pragma("unroll 1") for (int k = 0; k < 6; ++k) {
    const float side = k & 1 ? 1.0f : -1.0f;
    floatN px = x, py = y, pz = z;
    if (k < 2)
      px = mirrored_end(x, side, upper.x, &beyond[k]);
    else if (k < 4)
      py = mirrored_end(y, side, upper.y, &beyond[k]);
    else
      pz = mirrored_end(z, side, upper.z, &beyond[k]);
    any |= beyond[k];
    px += half_, py += half_, pz += half_;
    move_record(v, &here, &kind, px, py, pz);
    run_place(v, &run, k, &here, kind, px, py, pz, wanted, tally);
  }
  run_end(v, &run, 6, tally);
  floatN value[6];
  for (int k = 0; k < 6; ++k) value[k] = run_value(&run, k);
  if (any_lane(any & wanted)) {
    /* The values on the faces. */
    BlockRun faces;
    run_begin(&faces);
    _Pragma("unroll 1") for (int k = 0; k < 6; ++k) {
      const floatN face_x = k & 1 ? upper.x : 0.0f, face_y = k & 1 ? upper.y : 0.0f, face_z = k & 1 ? upper.z : 0.0f;
      const floatN px = (k < 2 ? face_x : x) + half_, py = (k >> 1 == 1 ? face_y : y) + half_;
      const floatN pz = (k > 3 ? face_z : z) + half_;
      move_record(v, &here, &kind, px, py, pz);
      run_place(v, &faces, k, &here, kind, px, py, pz, wanted & beyond[k], tally);
    }
    run_end(v, &faces, 6, tally);
    for (int k = 0; k < 6; ++k) value[k] = select(value[k], 2.0f * run_value(&faces, k) - value[k], beyond[k]);
  }
  const Gradient g = {half_difference(value[0], value[1]), half_difference(value[2], value[3]),
                      half_difference(value[4], value[5])};
  return finite_gradient(g);
}

#endif
