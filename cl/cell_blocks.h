/* The cells of surfaces in a volume of blocks: the field's values at the eight lattice points around, of whatever
 * resolution the blocks are there. Between them it is taken to be trilinear, as it is where they are at full
 * resolution; in coarser blocks a cell that samples' planes cut through is bent less than the field is. Cells side by
 * side have the same values on the face between them, so that surfaces have no holes, at faces of blocks of different
 * levels either.
 */
#ifndef CELL_BLOCKS_H
#define CELL_BLOCKS_H

#include "block_runs.h"
#include "lanes.h"
#include "sample_volume.h"

typedef Corners CellVoxels;

/* The corners of the cells (ix, iy, iz); of lanes that are not `open`, anything. */
INLINE Corners fetch_block_cell(const BlockVolume *v, intN ix, intN iy, intN iz, intN open, Tally *tally)
{
  const int log_edge = v->blocks->log_edge, within = (1 << log_edge) - 1;
  const int4 count = v->blocks->count;
  ix &= open, iy &= open, iz &= open;
  const Record r = fetch_record(v, min(ix >> log_edge, (intN)(count.x - 1)), min(iy >> log_edge, (intN)(count.y - 1)),
                                min(iz >> log_edge, (intN)(count.z - 1)));
  const intN x = ix & within, y = iy & within, z = iz & within;
  const intN whole = MASK(code_of(&r) == log_edge + 1) & MASK(x < within) & MASK(y < within) & MASK(z < within);
  if (!any_lane(open & ~whole)) {
    count_lanes(&tally[COUNT_BLOCK_READS], open);
    const intN at = (AS_INT(r.word0) + ((((z << log_edge) + y) << log_edge) + x)) & open;
    return decode_corners(fetch_block_corners(v, AS_INT((r.word1 >> 4u) & 3u) & open, at, (intN)(1 << log_edge),
                                              (intN)(1 << 2 * log_edge)), v->view);
  }
  const float4 upper = v->view->upper;
  BlockRun run;
  run_begin(&run);
  Record here = r;
  int kind = alike(v, &here);
  _Pragma("unroll 1") for (int k = 0; k < 8; ++k) {
    /* An axis of one voxel has it twice. */
    const floatN px = 0.5f + lane_min(TO_FLOAT(ix + (k & 1)), (floatN)upper.x);
    const floatN py = 0.5f + lane_min(TO_FLOAT(iy + (k >> 1 & 1)), (floatN)upper.y);
    const floatN pz = 0.5f + lane_min(TO_FLOAT(iz + (k >> 2)), (floatN)upper.z);
    move_record(v, &here, &kind, px, py, pz);
    run_place(v, &run, k, &here, kind, px, py, pz, open, tally);
  }
  run_end(v, &run, 8, tally);
  const Corners c = {run_value(&run, 0), run_value(&run, 1), run_value(&run, 2), run_value(&run, 3),
                     run_value(&run, 4), run_value(&run, 5), run_value(&run, 6), run_value(&run, 7)};
  return c;
}

#endif
