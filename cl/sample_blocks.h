/* Samples of a volume of blocks one packet at a time, for marches that do not take them in runs (the method "pyramid";
 * runs: march_blocks.h). */
#ifndef SAMPLE_BLOCKS_H
#define SAMPLE_BLOCKS_H

#include "blend_blocks.h"
#include "blocks.h"
#include "tally.h"

#if INTERBLOCK && LANES > 1
/* As blend_blocks() for one lane: the lanes `between` blocks, whose own block `r` gives `value`. */
INLINE floatN blend_lanes(const BlockVolume *v, const Record *r, floatN px, floatN py, floatN pz, floatN value,
                          intN between, Tally *tally)
{
  const Around a = blocks_around(v, r->x, r->y, r->z, px, py, pz, between);
  const int4 count = v->blocks->count;
  const intN ax = across(r->x, &a.x, count.x), ay = across(r->y, &a.y, count.y), az = across(r->z, &a.z, count.z);
  const floatN zero = 0.0f;
  floatN weight[8], sum = 0.0f, total, others = 0.0f;
  blend_weights(&a, between, weight);
  total = weight[0];
  _Pragma("unroll 1") for (int f = 1; f < 8; ++f) {
    const intN blends = between & MASK(weight[f] > zero);
    if (!any_lane(blends)) continue;
    const Record other = fetch_record(v, f & 1 ? ax : r->x, f & 2 ? ay : r->y, f & 4 ? az : r->z);
    const BlockPlace s = place_in_block(v, &other, px, py, pz);
    const floatN own = select(zero, weight[f], blends);
    sum += select(zero, own * (value_in_block(v, &s) - value), blends), others += own;
    count_lanes(&tally[COUNT_BLOCK_READS], blends);
  }
  const intN blended = between & MASK(others > zero);
  count_lanes(&tally[COUNT_BLENDED_SAMPLES], blended);
  return select(value, value + sum / select((floatN)1.0f, total + others, blended), blended);
}
#endif

/* The value at a lattice place, of the lanes that are `wanted`. */
INLINE floatN blocks_value(const BlockVolume *v, floatN x, floatN y, floatN z, intN wanted, Tally *tally)
{
  const float4 upper = v->view->upper;
  const floatN half_ = 0.5f;
  const floatN px = half_ + lane_clamp(x, (floatN)0.0f, (floatN)upper.x);
  const floatN py = half_ + lane_clamp(y, (floatN)0.0f, (floatN)upper.y);
  const floatN pz = half_ + lane_clamp(z, (floatN)0.0f, (floatN)upper.z);
  const Record r = record_at(v, px, py, pz);
  const BlockPlace p = place_in_block(v, &r, px, py, pz);
  floatN value = value_in_block(v, &p);
  count_lanes(&tally[COUNT_BLOCK_READS], wanted);
#if INTERBLOCK
  const intN between = wanted & p.outside;
#if LANES > 1
  if (any_lane(between)) value = blend_lanes(v, &r, px, py, pz, value, between, tally);
#else
  if (between) value = blend_blocks(v, &r, px, py, pz, value, tally);
#endif
#endif
  return value;
}

#endif
