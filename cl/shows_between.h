/* Whether a transfer function shows anything of a range of values, for kernels that look at single cells (LANES 1). */
#ifndef SHOWS_BETWEEN_H
#define SHOWS_BETWEEN_H

#include "lanes.h"
#include "view.h"

/* The position of a value among the nodes that tell values apart, 0 .. nodes - 1: linear where nodes are evenly
 * spaced, else piecewise linear (WARPED_CLASSES: a table of equal bins), so that nodes crowd where the transfer
 * function varies. Bins of the warp: warp[b] is the class coordinate of the lower edge of bin b. */
INLINE floatN class_position(floatN value, __global const float *warp, __constant const View *view)
{
  floatN p = (value - view->first_value) * view->nodes_per_value;
#if WARPED_CLASSES
  p = lane_clamp(p, (floatN)0.0f, (floatN)view->warp_bins);
  const intN bin = min(TO_INT(p), (intN)(int)(view->warp_bins - 1.0f));
  const floatN low = AS_FLOAT(gather4(warp, bin)), high = AS_FLOAT(gather4(warp + 1, bin));
  p = low + (p - TO_FLOAT(bin)) * (high - low);
#endif
  return lane_clamp(p, (floatN)0.0f, (floatN)view->last_node);
}

/* Of what is interpolated between `low` and `high` (none where low > high).
 * before  int [nodes]: of the intervals between nodes, how many before this one can show anything
 * at      uchar [nodes]: whether the node itself does */
inline int shows_between(float low, float high, __global const float *warp, __global const int *before,
                         __global const uchar *at,
                         __constant const View *view)
{
  if (!(low <= high)) return 0;
  const float p = class_position(low, warp, view), q = class_position(high, warp, view), last_node = view->last_node;
  if (low == high && p == floor(p)) return at[(int)p]; /* interpolation keeps it, and it falls on a node */
  /* The lowest value of all is node 0 exactly; else rounding may reach the next node. */
  const float margin = 1e-3f;
  const int from = (int)clamp(floor(p - margin), 0.0f, last_node), to = (int)clamp(ceil(q + margin), 0.0f, last_node);
  return before[to] > before[from] || at[from] || at[to];
}

#endif
