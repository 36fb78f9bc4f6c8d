/* Where the rays of a picture may start, by where those of the one before it first contributed (coherence.h; Klein et
 * al. 2005, section 4).
 *
 *   clear_nearest  nothing is known of any pixel
 *   project_kept   every kept place, as the new camera sees it: the nearest of each pixel, by an atomic minimum of the
 *                  floats' bits, whose order does not depend on that of the work-items
 *   widen_rows, widen_columns
 *                  the nearest within a window around each pixel. A place that is splat on k by k pixels is the nearest
 *                  place within k by k pixels; the window also has the pixels that may have hidden what shows now
 *                  (clvol/integrators/raycast/reprojection.py).
 *
 * kept     float [height, width] of the old picture
 * nearest  int [rows, stride]: bits of depths >= 0 behind the new reference plane, with MARGIN pixels around the picture
 * widened  int [rows, stride]
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

/* move: coefficients of 1, u, v, s, s u, s v (u, v: the old pixel from the old centre; s: depth behind the old reference
 * plane) for the new depth, and for the new pixel, from the new centre, times its depth behind the eye; then */
#define MOVE_DISTANCE 18    /* edges from the new eye to its reference plane; below 0: orthographic */
#define MOVE_OLD_CENTRE 19  /* column, row */
#define MOVE_NEW_CENTRE 21
#define MOVE_SPLAT 23       /* k */
#define MOVE_EXITS 24       /* whether EXIT pixels count: with a splat of less than 3 pixels they hide what is at outlines */

__kernel void clear_nearest(__global int *restrict nearest, const int4 size)
{
  const int row = (int)get_global_id(0);
  for (int x = 0; x < size.z; ++x) nearest[(size_t)row * size.z + x] = NOTHING;
}

__kernel void project_kept(__global const float *restrict kept, __global int *nearest,
                           __global const float *restrict move, const int4 size, const int old_width)
{
  const int row = (int)get_global_id(0);
  const float v = (float)row - move[MOVE_OLD_CENTRE + 1], distance = move[MOVE_DISTANCE];
  const float left = (float)MARGIN + move[MOVE_NEW_CENTRE] - 0.5f * move[MOVE_SPLAT];
  const float top = (float)MARGIN + move[MOVE_NEW_CENTRE + 1] - 0.5f * move[MOVE_SPLAT];
  const float16 lanes = (float16)(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15);
  for (int column = 0; column < old_width; column += 16) {
    float places[16];
    const float least = move[MOVE_EXITS] > 0.0f ? -INFINITY : 0.0f;
    int there = 0;
    for (int k = 0; k < 16; ++k) {
      places[k] = column + k < old_width ? kept[(size_t)row * old_width + column + k] : INFINITY;
      if (places[k] < least) places[k] = INFINITY;
      there |= places[k] < INFINITY;
    }
    if (!there) continue;
    const float16 place = vload16(0, places), u = (float)column + lanes - move[MOVE_OLD_CENTRE];
    const float16 s = select(place, -1.0f - place, place < 0.0f);
    float16 at[3];
    for (int k = 0; k < 3; ++k) {
      __global const float *m = move + 6 * k;
      at[k] = (m[0] + u * m[1] + v * m[2]) + s * (m[3] + u * m[4] + v * m[5]);
    }
    const float16 from_eye = distance < 0.0f ? (float16)1.0f : distance + at[0];
    const float16 inverse = 1.0f / from_eye, x = ceil(at[1] * inverse + left), y = ceil(at[2] * inverse + top);
    const int16 seen = (place < INFINITY) & (from_eye > 0.0f) & (x >= 0.0f) & (x < (float)size.z) & (y >= 0.0f) &
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

/* A row of `widened`, of which the first MARGIN and the last pixels are not needed. */
__kernel void widen_rows(__global const int *restrict nearest, __global int *restrict widened, const int4 size,
                         const int4 window)
{
  const size_t row = (size_t)get_global_id(0) * size.z;
  for (int x = MARGIN; x < MARGIN + size.x; x += 16) {
    int16 least = NOTHING;
    for (int at = x + window.x; at <= x + window.y; ++at) least = min(least, vload16(0, nearest + row + at));
    vstore16(least, 0, widened + row + x);
  }
}

/* `back`: edges before the nearest place at which rays start. */
__kernel void widen_columns(__global const int *restrict widened, __global const uchar *restrict inside,
                            __global float *restrict starts, const int4 size, const int4 window, const float back,
                            const int4 audit)
{
  const int row = (int)get_global_id(0);
  for (int x = 0; x < size.x; x += TILE) {
    int16 least = NOTHING;
    const int seen = inside[row / TILE * ((size.x + TILE - 1) / TILE) + x / TILE];
    for (int at = row + window.z; seen && at <= row + window.w; ++at)
      least = min(least, vload16(0, widened + (size_t)(at + MARGIN) * size.z + x + MARGIN));
    const float16 start = as_float16(least) - back; /* where nothing is known, INFINITY */
    float each[16];
    vstore16(start, 0, each);
    for (int k = 0; k < 16; ++k) {
      const int packet = row / 4 * audit.z + (x + k) / 4;
      if (each[k] < INFINITY) each[k] = as_float((as_int(each[k]) & ~1) | (packet % audit.x == audit.y));
    }
    for (int k = 0; k < min(16, size.x - x); ++k) starts[(size_t)row * size.x + x + k] = each[k];
  }
}
