/* Where the rays of a picture may start, by where those of the one before it first contributed (coherence.h; Klein et
 * al. 2005, section 4).
 *
 *   project_kept  every kept place, as the new camera sees it: the nearest of each pixel, by an atomic minimum of the
 *                 floats' bits, whose order does not depend on that of the work-items. Clears the array of the picture
 *                 after this one, too.
 *   find_starts   the nearest within a window around each pixel. A place that is splat on k by k pixels is the nearest
 *                 place within k by k pixels; the window also has the pixels that may have hidden what shows now, which
 *                 is the farther behind them the farther they are (clvol/integrators/raycast/reprojection.py). Where the
 *                 window has no place, nothing is to be seen.
 *
 * kept     float [height, width] of the old picture, which is of the same size
 * nearest  int [rows, stride]: bits of depths >= 0 behind the new reference plane, with MARGIN pixels around the picture
 * next     int [rows, stride]: that of the next picture
 * starts   float [height, width] of the new picture
 * move     the change of camera, as below
 * size     width, height, stride, rows
 * window   of a pixel: columns and rows from .. to, relative to it: x0, x1, y0, y1
 * audit    of so many packets, 4 by 4 pixels, one starts at the hull (coherence.h); which of them; and by how many it
 *          moves from one row of packets to the next
 * inside   uchar per TILE by TILE pixels of the new picture: whether all that its rays can see was in the old view; rays
 *          of other tiles start at the hull
 */
#ifndef MARGIN
#define MARGIN 64
#endif
#define TILE 16
#define NOTHING 0x7f800000 /* the bits of INFINITY */
#define BEHIND_ALL 1e30f   /* edges */

/* move: coefficients of 1, u, v, s, s u, s v (u, v: the old pixel from the old centre; s: depth behind the old reference
 * plane) for the new depth, and for the new pixel, from the new centre, times its depth behind the eye; then */
#define MOVE_DISTANCE 18    /* edges from the new eye to its reference plane; below 0: orthographic */
#define MOVE_OLD_CENTRE 19  /* column, row */
#define MOVE_NEW_CENTRE 21
#define MOVE_SPLAT 23       /* k */
#define MOVE_EMPTY 24       /* whether rays that no place is near see nothing; a splat below 3 pixels leaves holes */
#define MOVE_BEHIND 25      /* edges per column and per row beyond the splat by which something is behind what hid it, */
#define MOVE_BESIDE 27      /* from so many columns or rows on */

__kernel void project_kept(__global const float *restrict kept, __global int *nearest, __global int *restrict next,
                           __global const float *restrict move, const int4 size)
{
  const int row = (int)get_global_id(0), width = size.x;
  if (row < size.w)
    for (int x = 0; x < size.z; x += 16) vstore16((int16)NOTHING, 0, next + (size_t)row * size.z + x);
  if (row >= size.y) return;
  const float v = (float)row - move[MOVE_OLD_CENTRE + 1], distance = move[MOVE_DISTANCE];
  const float left = (float)MARGIN + move[MOVE_NEW_CENTRE] - 0.5f * move[MOVE_SPLAT];
  const float top = (float)MARGIN + move[MOVE_NEW_CENTRE + 1] - 0.5f * move[MOVE_SPLAT];
  const float16 lanes = (float16)(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15);
  for (int column = 0; column < width; column += 16) {
    float places[16];
    int there = 0;
    for (int k = 0; k < 16; ++k) {
      places[k] = column + k < width ? kept[(size_t)row * width + column + k] : INFINITY;
      if (places[k] < 0.0f) places[k] = INFINITY; /* behind these nothing is hidden */
      there |= places[k] < INFINITY;
    }
    if (!there) continue;
    const float16 s = vload16(0, places), u = (float)column + lanes - move[MOVE_OLD_CENTRE];
    float16 at[3];
    for (int k = 0; k < 3; ++k) {
      __global const float *m = move + 6 * k;
      at[k] = (m[0] + u * m[1] + v * m[2]) + s * (m[3] + u * m[4] + v * m[5]);
    }
    const float16 from_eye = distance < 0.0f ? (float16)1.0f : distance + at[0];
    const float16 inverse = 1.0f / from_eye, x = ceil(at[1] * inverse + left), y = ceil(at[2] * inverse + top);
    const int16 seen = (s < INFINITY) & (from_eye > 0.0f) & (x >= 0.0f) & (x < (float)size.z) & (y >= 0.0f) &
      (y < (float)size.w);
    const int16 target = convert_int16(select((float16)0.0f, y, seen)) * size.z +
      convert_int16(select((float16)0.0f, x, seen));
    const int16 depth = as_int16(fmax(at[0], 0.0f));
    int seens[16], targets[16], depths[16];
    vstore16(seen, 0, seens), vstore16(target, 0, targets), vstore16(depth, 0, depths);
    for (int k = 0; k < 16; ++k)
      if (seens[k]) atomic_min(nearest + targets[k], depths[k]);
  }
}

/* Edges to add, of a pixel `beyond` a place's splat by so many columns or rows: below 1 on it. */
float edges_behind(__global const float *restrict move, int axis, int beyond)
{
  return fmax((float)beyond - move[MOVE_BESIDE], 0.0f) * move[MOVE_BEHIND + axis];
}

/* By how much a place that is splat from `offset` on, beside a pixel, is beyond it. */
int beyond_splat(int offset, int splat) { return max(offset, 1 - splat - offset); }

int16 moved_back(int16 nearest, float edges)
{
  return edges > 0.0f ? as_int16(as_float16(nearest) + edges) : nearest; /* of NOTHING, INFINITY */
}

/* A TILE of the picture. `back`: edges before the nearest place at which rays start. */
__kernel void find_starts(__global const int *restrict nearest, __global const uchar *restrict inside,
                          __global float *restrict starts, __global const float *restrict move, const int4 size,
                          const int4 window, const float back, const int4 audit)
{
  const int across = (size.x + TILE - 1) / TILE, tile = (int)get_global_id(0);
  const int left = tile % across * TILE, top = tile / across * TILE, splat = (int)move[MOVE_SPLAT];
  const int seen = inside[tile], height = min(TILE, size.y - top);
  int16 rows[TILE + 2 * MARGIN]; /* the nearest of each row of the window around the tile */
  for (int y = 0; seen && y < height + window.w - window.z; ++y) {
    __global const int *here = nearest + (size_t)(top + y + window.z + MARGIN) * size.z + left + MARGIN;
    int16 least = NOTHING;
    for (int at = window.x; at <= window.y; ++at)
      least = min(least, moved_back(vload16(0, here + at), edges_behind(move, 0, beyond_splat(at, splat))));
    rows[y] = least;
  }
  for (int y = 0; y < height; ++y) {
    const int row = top + y;
    int16 least = NOTHING;
    for (int at = window.z; seen && at <= window.w; ++at)
      least = min(least, moved_back(rows[y + at - window.z], edges_behind(move, 1, beyond_splat(at, splat))));
    const float16 start = as_float16(least) - back;
    int16 marks;
    int marked[4];
    for (int k = 0; k < 4; ++k) marked[k] = (row / 4 * audit.z + left / 4 + k) % audit.x == audit.y;
    marks.s0123 = marked[0], marks.s4567 = marked[1], marks.s89ab = marked[2], marks.scdef = marked[3];
    const float nowhere = seen && move[MOVE_EMPTY] > 0.0f ? BEHIND_ALL : INFINITY;
    const float16 near = select(start, (float16)nowhere, least == NOTHING);
    const float16 each = select(as_float16((as_int16(near) & ~1) | marks), near, near == INFINITY);
    __global float *first = starts + (size_t)row * size.x + left;
    if (left + TILE <= size.x) {
      vstore16(each, 0, first);
    } else {
      float some[16];
      vstore16(each, 0, some);
      for (int k = 0; k < size.x - left; ++k) first[k] = some[k];
    }
  }
}
