/* cl/transfer_pieces.h alone: segments by the values at their ends, of one value, and of one value over whole steps. */
#include "lanes.h"
#include "transfer_pieces.h"

/* colors [5, n]: premultiplied red, green, blue, opacity and optical depth of segments `units` opacity units long from `front` to
 * `back`, or where `of_one` is 1 of the one value `front`; where it is 2 of that value over `units` (1 .. 8) steps, and
 * where it is 3 over one step, without depth. n is a multiple of LANES. */
__kernel void segment_colors(__global const float *table, __constant const View *view, __global const float *front,
                             __global const float *back, __global const float *units, int of_one, int n, __global float *colors)
{
  const size_t first = get_global_id(0) * LANES;
  const floatN s0 = LOAD_LANES(front + first), s1 = LOAD_LANES(back + first), length = LOAD_LANES(units + first);
  const intN all = ~(intN)0;
  const Pieces f = scene_pieces(table, (intN)0, view);
  SegmentColor s;
  if (of_one >= 2) {
    if (of_one == 2)
      color_of_steps(s0, TO_INT(length), 0, all, f, view, &s.r, &s.g, &s.b, &s.a);
    else
      color_of_steps(s0, (intN)1, 1, all, f, view, &s.r, &s.g, &s.b, &s.a);
    s.r *= s.a, s.g *= s.a, s.b *= s.a, s.depth = 0.0f;
  } else
    s = of_one ? color_of_value(s0, length, f) : color_of_segment(s0, s1, length, all, f);
  const floatN channels[5] = {s.r, s.g, s.b, s.a, s.depth};
  for (int c = 0; c < 5; ++c) {
    float each[LANES];
    STORE_LANES(channels[c], each);
    EACH_LANE(k) colors[c * n + first + k] = each[k];
  }
}
