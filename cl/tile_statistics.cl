/* What the rays through the corners of a picture's tiles meet (Ljung 2006, section 4.1).
 *
 * Ljung advances a ray by floor(l) + 1 samples, l to the exit of its block. Here it goes from block to block by their
 * faces (Amanatides and Woo 1987): every block that the ray passes through counts once, none twice.
 *
 * index       int2 [blocks], bits 0 .. 3 of a block's second word: 1 + log2 of its samples per axis, or CODE_DROPPED
 * grid        blocks x, y, z; voxels per edge of a block
 * tiles       columns, rows of tiles; edge of a tile in pixels; -
 * statistics  float4 [rows + 1, columns + 1]: greatest, mean and root mean square of the blocks' samples per axis over
 *             an edge, and how many blocks there were; zeros for a ray that misses
 *
 * Compiled with LANES 1.
 */
#include "features.h"
#include "lanes.h"
#include "view.h"
#include "rays.h"

static float block_scale(__global const int2 *index, int block, float edge)
{
  const int code = index[block].y & 15;
  return code == CODE_DROPPED ? 0.0f : (float)(1 << max(code - 1, 0)) / edge;
}

/* A ray along one axis, in blocks. */
typedef struct {
  int at, towards;                /* block, and the way to the next: 1, -1 */
  float origin, inverse, exit;    /* of a step; where the ray leaves the block, in steps */
} Walk;

/* Not accumulated. A ray that does not move on the axis never leaves. */
static void find_exit(Walk *w)
{
  w->exit = w->inverse == 0.0f ? INFINITY : ((float)(w->at + (w->towards > 0)) - w->origin) * w->inverse;
}

static Walk start_walk(float origin, float direction, int blocks)
{
  Walk w;
  w.origin = origin;
  w.at = clamp((int)floor(origin), 0, blocks - 1);
  w.towards = direction < 0.0f ? -1 : 1;
  w.inverse = fabs(direction) < 1e-12f ? 0.0f : 1.0f / direction;
  find_exit(&w);
  return w;
}

static void next_block(Walk *w) { w->at += w->towards, find_exit(w); }

__kernel void tile_statistics(__global const int2 *restrict index, __constant const View *restrict view,
                              const int4 grid,
                              const int4 tiles, __global float4 *restrict statistics)
{
  const int corner = (int)get_global_id(0), columns = tiles.x + 1;
  const int column = corner % columns, row = corner / columns;
  const float px = (float)min(column * tiles.z, view->image.x) - 0.5f;
  const float py = (float)min(row * tiles.z, view->image.y) - 0.5f;
  const Rays ray = make_rays(view, px, py);
  const float edge = (float)grid.w;
  float greatest = 0.0f, sum = 0.0f, squares = 0.0f, count = 0.0f;
  if (ray.length >= 0.0f) {
    Walk x = start_walk((ray.x0 + 0.5f) / edge, ray.dx / edge, grid.x);
    Walk y = start_walk((ray.y0 + 0.5f) / edge, ray.dy / edge, grid.y);
    Walk z = start_walk((ray.z0 + 0.5f) / edge, ray.dz / edge, grid.z);
    for (int left = grid.x + grid.y + grid.z; left > 0; --left) {
      const float scale = block_scale(index, (z.at * grid.y + y.at) * grid.x + x.at, edge);
      greatest = fmax(greatest, scale), sum += scale, squares += scale * scale, count += 1.0f;
      if (fmin(fmin(x.exit, y.exit), z.exit) >= ray.length) break;
      if (x.exit <= y.exit && x.exit <= z.exit) next_block(&x);
      else if (y.exit <= z.exit) next_block(&y);
      else next_block(&z);
      if (x.at < 0 || x.at >= grid.x || y.at < 0 || y.at >= grid.y || z.at < 0 || z.at >= grid.z) break;
    }
  }
  const float share = count > 0.0f ? 1.0f / count : 0.0f;
  statistics[corner] = (float4)(greatest, sum * share, sqrt(squares * share), count);
}
