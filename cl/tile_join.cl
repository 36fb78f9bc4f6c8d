/* The picture between the rays of its tiles, in place: intertile interpolation (Ljung 2006, section 4.2).
 *
 * A tile's rays stand on the crossings of its lines (clvol/integrators/tiles/geometry.py). Within a tile the picture
 * is piecewise linear along either axis, and beyond the outermost lines it stays as it is there. Tiles are blended
 * from the outermost ray of one to that of the next: delta_i is the distance of tile i's outermost line from the
 * border between them, and
 *
 *   e_ij = clamp((rho + delta_i) / (delta_i + delta_j), 0, 1)                                     (Ljung 2006, eq. 5)
 *
 * how much tile j counts against i at distance rho beyond the border. Here a tile's two sides have each their own
 * delta.
 *
 * Of the four tiles around a corner let A be the pixel's own, B beside it, C above or below, and D across. Ljung (eq.
 * 6) weighs them by
 *
 *   w_A = (1 - e_AB) (1 - e_AC)    w_B = e_AB (1 - e_BD)    w_C = (1 - e_CD) e_AC    w_D = e_CD e_BD
 *
 * and D, if it is coarse, then counts inside A's outermost rays, where e_AB = e_AC = 0: A's own rays are not shown as
 * they are. Here a tile is also reached only over one of the tiles beside it, from the tile across from it:
 *
 *   w_D = min(e_CD e_BD, max(e_AB e_BD, e_AC e_CD))
 *
 * and alike for the others, with 1 - e where an edge is crossed the other way. With deltas that agree on either side
 * of each border all three products are the same and so is the blend (bilinear); else it stays continuous, but every
 * ray is shown as it was cast. The weights are divided by their sum, which is never 0: w_A > 0, as all e < 1 on A's
 * side of the borders.
 *
 * Depth is that of the nearest ray of the tiles that count: between something and nothing there is no mean.
 *
 * lines       uchar2: for each pixel of an axis the lines (low, high) that it lies between, LineTable in geometry.py
 * tile_lines  int2 [tiles]: where in `lines` a tile's columns begin, and its rows
 * chosen      int [n]: the tiles to join
 * shape       width, height of the picture; edge of a tile in pixels; rows of a tile that a work-item takes
 */
#ifndef WITH_DEPTH
#define WITH_DEPTH 1
#endif

/* A tile along one axis. */
typedef struct {
  int start, length;               /* its pixels */
  __global const uchar2 *lines;    /* an entry for each of them */
} Span;

/* The lines around a pixel, and how far it is from the first to the second; a pixel beside the tile is taken as its
 * outermost. */
typedef struct {
  int low, high; /* pixels of the picture */
  float share;
} Between;

static Between between_lines(Span span, int pixel)
{
  const int at = clamp(pixel - span.start, 0, span.length - 1);
  const uchar2 near = span.lines[at];
  Between b;
  b.low = span.start + near.x, b.high = span.start + near.y;
  b.share = near.y > near.x ? (float)(at - near.x) / (float)(near.y - near.x) : 0.0f;
  return b;
}

/* Distance of the outermost line from the tile's border: the upper one (after = 1) or the lower one. */
static float to_border(Span span, int after)
{
  return after ? (float)span.length - 0.5f - (float)span.lines[span.length - 1].x : (float)span.lines[0].x + 0.5f;
}

/* e of the next tile against this one, in which the pixel is, `inside` the border between them. */
static float edge_weight(Span span, Span next, int after, float inside)
{
  const float here = to_border(span, after), there = to_border(next, !after);
  return clamp((here - inside) / (here + there), 0.0f, 1.0f);
}

static float4 tile_color(__global const float4 *image, int width, Between x, Between y)
{
  __global const float4 *low = image + (size_t)y.low * width, *high = image + (size_t)y.high * width;
  const float4 a = low[x.low] + x.share * (low[x.high] - low[x.low]);
  const float4 b = high[x.low] + x.share * (high[x.high] - high[x.low]);
  return a + y.share * (b - a);
}

/* The nearest ray of a tile: keeps it if it is nearer than what was found before. */
static void nearest_ray(Between x, Between y, int px, int py, int *distance, int2 *place)
{
  const int2 ray = (int2)(px - x.low <= x.high - px ? x.low : x.high, py - y.low <= y.high - py ? y.low : y.high);
  const int dx = ray.x - px, dy = ray.y - py;
  if (dx * dx + dy * dy < *distance) *distance = dx * dx + dy * dy, *place = ray;
}

__kernel void tile_join(__global const uchar2 *restrict lines, __global const int2 *restrict tile_lines,
                        __global const int *restrict chosen, const int4 shape, __global float4 *image,
                            __global float *depths)
{
  const int width = shape.x, height = shape.y, size = shape.z, rows_an_item = shape.w;
  const int items = (size + rows_an_item - 1) / rows_an_item;
  const int columns = (width + size - 1) / size, rows = (height + size - 1) / size;
  const int tile = chosen[get_global_id(0) / items];
  const int column = tile % columns, row = tile / columns;
  const int left = column * size, top = row * size;
  const int right = min(left + size, width), bottom = min(top + size, height);
  const int first = top + (int)(get_global_id(0) % items) * rows_an_item;
  for (int y = first; y < min(first + rows_an_item, bottom); ++y)
    for (int x = left; x < right; ++x) {
      const Span ax = {left, right - left, lines + tile_lines[tile].x};
      const Span ay = {top, bottom - top, lines + tile_lines[tile].y};
      const Between own_x = between_lines(ax, x), own_y = between_lines(ay, y);
      if (own_x.low == own_x.high && own_x.low == x && own_y.low == own_y.high && own_y.low == y) continue; /* a ray */
      /* Towards which tile: no outermost line is beyond the middle of its tile. */
      const int after_x = x - left >= ax.length / 2, after_y = y - top >= ay.length / 2;
      const int side = column + (after_x ? 1 : -1), across = row + (after_y ? 1 : -1);
      const int has_side = side >= 0 && side < columns, has_across = across >= 0 && across < rows;
      const float inside_x = after_x ? (float)(right - x) - 0.5f : (float)(x - left) + 0.5f;
      const float inside_y = after_y ? (float)(bottom - y) - 0.5f : (float)(y - top) + 0.5f;
      const int b = has_side ? row * columns + side : tile, c = has_across ? across * columns + column : tile;
      const int d = (has_across ? across : row) * columns + (has_side ? side : column);
      const int side_left = has_side ? side * size : left, across_top = has_across ? across * size : top;
      const int side_length = min(side_left + size, width) - side_left;
      const int across_length = min(across_top + size, height) - across_top;
      const Span bx = {side_left, side_length, lines + tile_lines[b].x}, by = {top, ay.length, lines + tile_lines[b].y};
      const Span cx = {left, ax.length, lines + tile_lines[c].x};
      const Span cy = {across_top, across_length, lines + tile_lines[c].y};
      const Span dx = {side_left, side_length, lines + tile_lines[d].x};
      const Span dy = {across_top, across_length, lines + tile_lines[d].y};
      const float ab = has_side ? edge_weight(ax, bx, after_x, inside_x) : 0.0f;
      const float cd = has_side ? edge_weight(cx, dx, after_x, inside_x) : 0.0f;
      const float ac = has_across ? edge_weight(ay, cy, after_y, inside_y) : 0.0f;
      const float bd = has_across ? edge_weight(by, dy, after_y, inside_y) : 0.0f;
      const float4 weight = (float4)(fmin((1.0f - ab) * (1.0f - ac),
                                          fmax((1.0f - bd) * (1.0f - ab), (1.0f - cd) * (1.0f - ac))),
                                     fmin(ab * (1.0f - bd), fmax((1.0f - ac) * ab, cd * (1.0f - bd))),
                                     fmin((1.0f - cd) * ac, fmax((1.0f - ab) * ac, bd * (1.0f - cd))),
                                     fmin(cd * bd, fmax(ab * bd, ac * cd)));
      const float4 own = tile_color(image, width, own_x, own_y);
      float4 change = 0.0f; /* a sum of differences: where all agree the picture does, exactly */
      int distance = INT_MAX;
      int2 place = (int2)(x, y);
      nearest_ray(own_x, own_y, x, y, &distance, &place);
      if (weight.y > 0.0f) {
        const Between side_x = between_lines(bx, x), side_y = between_lines(by, y);
        change += weight.y * (tile_color(image, width, side_x, side_y) - own);
        nearest_ray(side_x, side_y, x, y, &distance, &place);
      }
      if (weight.z > 0.0f) {
        const Between across_x = between_lines(cx, x), across_y = between_lines(cy, y);
        change += weight.z * (tile_color(image, width, across_x, across_y) - own);
        nearest_ray(across_x, across_y, x, y, &distance, &place);
      }
      if (weight.w > 0.0f) {
        const Between corner_x = between_lines(dx, x), corner_y = between_lines(dy, y);
        change += weight.w * (tile_color(image, width, corner_x, corner_y) - own);
        nearest_ray(corner_x, corner_y, x, y, &distance, &place);
      }
      const size_t pixel = (size_t)y * width + x;
      image[pixel] = own + change / (weight.x + weight.y + weight.z + weight.w);
#if WITH_DEPTH
      depths[pixel] = depths[(size_t)place.y * width + place.x];
#endif
    }
}
