/* Gradients of the field of blocks at many places (gradient_blocks.h). Most of them lie a voxel and more within a block
 * at full resolution, or between such blocks: there voxels are taken one by one, as in gradient.h, and only elsewhere
 * six blended values. Places of a kind are taken together, so that no vector has to do what few of its lanes need.
 */
#ifndef GRADIENT_QUEUE_H
#define GRADIENT_QUEUE_H

#include "gradient_blocks.h"
#include "march.h"

/* Two samples side by side along x, of blocks in buffer number `buffer`. */
INLINE Edge fetch_block_edge(const BlockVolume *v, intN buffer, intN at)
{
  Edge e;
#if VOXEL_BITS == 8
  const uintN w = GATHER_SAMPLES(gather1, at);
  e.v0 = BYTE(w, 0u), e.v1 = BYTE(w, 1u);
#elif VOXEL_BITS == 16
  const uintN w = GATHER_SAMPLES(gather2, at);
  e.v0 = LOW_HALF(w), e.v1 = HIGH_HALF(w);
#else
  e.v0 = AS_FLOAT(GATHER_SAMPLES(gather4, at)), e.v1 = AS_FLOAT(GATHER_SAMPLES(gather4, at + 1));
#if VOXEL_SCALED
  e.v0 *= v->view->voxel_gain, e.v1 *= v->view->voxel_gain;
#endif
#endif
  return e;
}

/* The same gradient where all voxels around lie in one block at full resolution, as inner_lanes() finds them: by the
 * differences of these voxels. (fx, fy, fz): place between the samples at `at`, one to each side of which are there. */
INLINE Gradient inner_block_gradient(const BlockVolume *v, intN buffer, intN at, floatN fx, floatN fy, floatN fz)
{
  const int row = 1 << v->blocks->log_edge, slice = row << v->blocks->log_edge;
  floatN dx[2], dy[2], mean[2]; /* of slices z and z + 1 */
  _Pragma("unroll 1") for (int k = 0; k < 2; ++k) {
    const intN here = at + k * slice;
    const Edge low0 = fetch_block_edge(v, buffer, here - 1), high0 = fetch_block_edge(v, buffer, here + 1);
    const Edge low1 = fetch_block_edge(v, buffer, here + (row - 1));
    const Edge high1 = fetch_block_edge(v, buffer, here + (row + 1));
    const Edge above = fetch_block_edge(v, buffer, here - row), below = fetch_block_edge(v, buffer, here + 2 * row);
    const floatN m0 = mix_corners(low0.v1, high0.v0, fx), m1 = mix_corners(low1.v1, high1.v0, fx);
    dx[k] = mix_corners(mix_corners(high0.v0 - low0.v0, high1.v0 - low1.v0, fy),
                        mix_corners(high0.v1 - low0.v1, high1.v1 - low1.v1, fy), fx);
    dy[k] = mix_corners(m1 - mix_corners(above.v0, above.v1, fx), mix_corners(below.v0, below.v1, fx) - m0, fy);
    mean[k] = mix_corners(m0, m1, fy);
  }
  floatN beside[2]; /* means of slices z - 1 and z + 2 */
  _Pragma("unroll 1") for (int k = 0; k < 2; ++k) {
    const intN there = at + (k ? 2 * slice : -slice);
    const Edge low = fetch_block_edge(v, buffer, there), high = fetch_block_edge(v, buffer, there + row);
    beside[k] = mix_corners(mix_corners(low.v0, low.v1, fx), mix_corners(high.v0, high.v1, fx), fy);
  }
  const Gradient g = {0.5f * mix_corners(dx[0], dx[1], fz), 0.5f * mix_corners(dy[0], dy[1], fz),
                      0.5f * mix_corners(mean[1] - beside[0], beside[1] - mean[0], fz)};
  return finite_gradient(g);
}

#if LANES > 1

#define MOST_PLACES ((4 * MARCH_STEPS + 2) * LANES)
typedef struct {
  int count;
  uint lanes[MOST_PLACES / LANES]; /* of each vector of places those of this kind, as bits */
  float x[MOST_PLACES], y[MOST_PLACES], z[MOST_PLACES]; /* places p of these, one after the other; then gradients */
} GradientQueue;

INLINE void queue_gradients(GradientQueue *q, int vector, floatN px, floatN py, floatN pz, intN mask)
{
  const int at = q->count;
  const uint bits = lane_bits(mask);
  pack_lanes(px, bits, q->x + at), pack_lanes(py, bits, q->y + at), pack_lanes(pz, bits, q->z + at);
  q->lanes[vector] = bits, q->count = at + popcount(bits);
}

INLINE void store_gradient(GradientQueue *q, int first, Gradient g)
{
  STORE_LANES(g.x, q->x + first), STORE_LANES(g.y, q->y + first), STORE_LANES(g.z, q->z + first);
}

/* Lanes of places within a block at full resolution, a voxel and more from its outermost samples. */
INLINE intN inner_lanes(const BlockVolume *v, const Record *r, floatN px, floatN py, floatN pz)
{
  const float edge = v->blocks->edge;
  const floatN x = px - edge * TO_FLOAT(r->x), y = py - edge * TO_FLOAT(r->y), z = pz - edge * TO_FLOAT(r->z);
  const floatN least = lane_min(lane_min(x, y), z), most = lane_max(lane_max(x, y), z);
  return MASK(code_of(r) == v->blocks->log_edge + 1) & MASK(least >= 1.5f) & MASK(most < edge - 1.5f);
}

INLINE floatN fetch_block_sample(const BlockVolume *v, intN at)
{
  const intN buffer = 0;
#if VOXEL_BITS == 8
  return BYTE(GATHER_SAMPLES(gather1, at), 0u);
#elif VOXEL_BITS == 16
  return LOW_HALF(GATHER_SAMPLES(gather2, at));
#elif VOXEL_SCALED
  return AS_FLOAT(GATHER_SAMPLES(gather4, at)) * v->view->voxel_gain;
#else
  return AS_FLOAT(GATHER_SAMPLES(gather4, at));
#endif
}

/* One axis of the four voxels around a place: the first one's number, the place between the second and the third, and
 * how many of them are in the block before the nearest face (or 4: all, or 0: none). */
typedef struct {
  intN first, lower; /* first voxel; block before the face */
  floatN f;
  intN before;
} VoxelAxis;

INLINE VoxelAxis voxel_axis(const BlockVolume *v, floatN p, intN corner)
{
  VoxelAxis a;
  const intN cell = TO_INT(p - 0.5f);
  a.f = p - 0.5f - TO_FLOAT(cell), a.first = cell - 1, a.lower = corner - 1;
  a.before = (corner << v->blocks->log_edge) - a.first;
  return a;
}

/* The gradient between eight blocks at full resolution. `whole_rows`: each row of four voxels lies in one block. */
INLINE Gradient beside_block_gradient(const BlockVolume *v, VoxelAxis x, VoxelAxis y, VoxelAxis z, int whole_rows,
                                      intN active)
{
  const int log_edge = v->blocks->log_edge, within = (1 << log_edge) - 1;
  const int4 count = v->blocks->count;
  intN start[8]; /* first samples of the eight; of whole rows only every second one is needed */
  for (int k = 0; k < 8; k += 1 + whole_rows) {
    const intN on_x = whole_rows ? select((intN)0, (intN)1, MASK(x.before <= 0)) : (intN)(k & 1);
    const intN bx = min(x.lower + on_x, (intN)(count.x - 1)), by = min(y.lower + (k >> 1 & 1), (intN)(count.y - 1));
    const intN bz = min(z.lower + (k >> 2), (intN)(count.z - 1));
    const intN block = (max(bz, (intN)0) * count.y + max(by, (intN)0)) * count.x + max(bx, (intN)0);
    start[k] = AS_INT(gather4(v->index, 2 * (block & active)));
  }
  intN xs[4];
  for (int i = 0; i < 4; ++i) xs[i] = (x.first + i) & within;
  floatN gx[2], gy[2], mean[4];
  _Pragma("unroll") for (int l = 0; l < 4; ++l) {
    const int middle = l == 1 || l == 2;
    const intN behind = MASK(z.before <= l), zs = ((z.first + l) & within) << 2 * log_edge;
    floatN slope[4], m[4]; /* of rows along x: differences and means */
    _Pragma("unroll") for (int j = 0; j < 4; ++j) {
      if (!middle && (j == 0 || j == 3)) continue;
      const int sloped = middle && (j == 1 || j == 2);
      const intN below = MASK(y.before <= j), at = zs + (((y.first + j) & within) << log_edge);
      const intN near = at + select(select(start[0], start[4], behind), select(start[2], start[6], behind), below);
      floatN v0 = 0.0f, v1, v2, v3 = 0.0f;
      if (whole_rows && sloped) {
        const Edge low = fetch_block_edge(v, (intN)0, (near + xs[0]) & active);
        const Edge high = fetch_block_edge(v, (intN)0, (near + xs[2]) & active);
        v0 = low.v0, v1 = low.v1, v2 = high.v0, v3 = high.v1;
      } else if (whole_rows) {
        const Edge inner = fetch_block_edge(v, (intN)0, (near + xs[1]) & active);
        v1 = inner.v0, v2 = inner.v1;
      } else {
        const intN far = at + select(select(start[1], start[5], behind), select(start[3], start[7], behind), below);
        v1 = fetch_block_sample(v, (xs[1] + select(near, far, MASK(x.before <= 1))) & active);
        v2 = fetch_block_sample(v, (xs[2] + select(near, far, MASK(x.before <= 2))) & active);
        if (sloped) {
          v0 = fetch_block_sample(v, (xs[0] + select(near, far, MASK(x.before <= 0))) & active);
          v3 = fetch_block_sample(v, (xs[3] + select(near, far, MASK(x.before <= 3))) & active);
        }
      }
      m[j] = mix_corners(v1, v2, x.f);
      if (sloped) slope[j] = mix_corners(v2 - v0, v3 - v1, x.f);
    }
    mean[l] = mix_corners(m[1], m[2], y.f);
    if (middle) {
      gx[l - 1] = mix_corners(slope[1], slope[2], y.f);
      gy[l - 1] = mix_corners(m[2] - m[0], m[3] - m[1], y.f);
    }
  }
  const Gradient g = {0.5f * mix_corners(gx[0], gx[1], z.f), 0.5f * mix_corners(gy[0], gy[1], z.f),
                      0.5f * mix_corners(mean[2] - mean[0], mean[3] - mean[1], z.f)};
  return finite_gradient(g);
}

/* Turns places into gradients. */
INLINE void take_gradients_beside(const BlockVolume *v, GradientQueue *q, int whole_rows, Tally *tally)
{
  const int4 blocks = v->blocks->count;
  _Pragma("unroll 1") for (int first = 0; first < q->count; first += LANES) {
    const intN active = MASK(first + LANE_INDEX < q->count);
    const floatN px = select((floatN)1.5f, LOAD_LANES(q->x + first), active);
    const floatN py = select((floatN)1.5f, LOAD_LANES(q->y + first), active);
    const floatN pz = select((floatN)1.5f, LOAD_LANES(q->z + first), active);
    const VoxelAxis x = voxel_axis(v, px, nearest_face(px, block_of(px, v, blocks.x), v).corner);
    const VoxelAxis y = voxel_axis(v, py, nearest_face(py, block_of(py, v, blocks.y), v).corner);
    const VoxelAxis z = voxel_axis(v, pz, nearest_face(pz, block_of(pz, v, blocks.z), v).corner);
    store_gradient(q, first, beside_block_gradient(v, x, y, z, whole_rows, active));
    count_lanes(&tally[COUNT_BLOCK_READS], active);
  }
}

/* In: `count` lattice points. Out: the gradients there. Behind them there is room for a vector. */
INLINE void blocks_gradients(const BlockVolume *v, int count, float *gx, float *gy, float *gz, Tally *tally)
{
  const float4 upper = v->view->upper;
  const int4 blocks = v->blocks->count;
  const float edge = v->blocks->edge;
  const int log_edge = v->blocks->log_edge;
  const floatN half_ = 0.5f, zero = 0.0f;
  GradientQueue inner, rows, beside, others;
  inner.count = rows.count = beside.count = others.count = 0;
  Record here = record_at(v, half_, half_, half_);
  int kind = alike(v, &here), vector = 0;
  _Pragma("unroll 1") for (int first = 0; first < count; first += LANES, ++vector) {
    const intN all = MASK(first + LANE_INDEX < count);
    const floatN px = half_ + lane_clamp(select(zero, LOAD_LANES(gx + first), all), zero, (floatN)upper.x);
    const floatN py = half_ + lane_clamp(select(zero, LOAD_LANES(gy + first), all), zero, (floatN)upper.y);
    const floatN pz = half_ + lane_clamp(select(zero, LOAD_LANES(gz + first), all), zero, (floatN)upper.z);
    move_record(v, &here, &kind, px, py, pz);
    /* Not within a voxel of the volume's faces, where differences are one-sided. */
    const intN inside = all & MASK(px >= 1.5f) & MASK(py >= 1.5f) & MASK(pz >= 1.5f) & MASK(px < upper.x - 0.5f) &
        MASK(py < upper.y - 0.5f) & MASK(pz < upper.z - 0.5f);
    const intN within = inside & inner_lanes(v, &here, px, py, pz);
    intN between = 0, whole_rows = 0;
#if INTERBLOCK && SAMPLE_BUFFERS == 1
    if (any_lane(inside & ~within) && log_edge >= 3) {
      const Around a = blocks_around(v, here.x, here.y, here.z, px, py, pz, inside);
      between = inside & ~within & MASK(a.codes == (uint)(log_edge + 1) * 0x11111111u);
      const floatN x = px - edge * TO_FLOAT(here.x);
      whole_rows = between & MASK(x >= 1.5f) & MASK(x < edge - 1.5f);
    }
#endif
    queue_gradients(&inner, vector, px, py, pz, within), queue_gradients(&rows, vector, px, py, pz, whole_rows);
    queue_gradients(&beside, vector, px, py, pz, between & ~whole_rows);
    queue_gradients(&others, vector, px, py, pz, all & ~within & ~between);
  }
  _Pragma("unroll 1") for (int first = 0; first < inner.count; first += LANES) {
    const intN active = MASK(first + LANE_INDEX < inner.count);
    const floatN px = select((floatN)1.5f, LOAD_LANES(inner.x + first), active);
    const floatN py = select((floatN)1.5f, LOAD_LANES(inner.y + first), active);
    const floatN pz = select((floatN)1.5f, LOAD_LANES(inner.z + first), active);
    move_record(v, &here, &kind, px, py, pz);
    const floatN ux = px - edge * TO_FLOAT(here.x) - 0.5f, uy = py - edge * TO_FLOAT(here.y) - 0.5f;
    const floatN uz = pz - edge * TO_FLOAT(here.z) - 0.5f;
    const intN ix = TO_INT(ux), iy = TO_INT(uy), iz = TO_INT(uz);
    /* Where there is nothing to do, somewhere in the buffer. */
    const intN at = ((((iz << log_edge) + iy) << log_edge) + ix) + (AS_INT(here.word0) & active);
    store_gradient(&inner, first, inner_block_gradient(v, AS_INT((here.word1 >> 4u) & 3u) & active, at,
                                                       ux - TO_FLOAT(ix), uy - TO_FLOAT(iy), uz - TO_FLOAT(iz)));
    count_lanes(&tally[COUNT_BLOCK_READS], active);
  }
  take_gradients_beside(v, &rows, 1, tally), take_gradients_beside(v, &beside, 0, tally);
  _Pragma("unroll 1") for (int first = 0; first < others.count; first += LANES) {
    const intN active = MASK(first + LANE_INDEX < others.count);
    const floatN x = select(zero, LOAD_LANES(others.x + first) - half_, active);
    const floatN y = select(zero, LOAD_LANES(others.y + first) - half_, active);
    const floatN z = select(zero, LOAD_LANES(others.z + first) - half_, active);
    store_gradient(&others, first, blocks_gradient(v, x, y, z, active, tally));
  }
  int from_inner = 0, from_rows = 0, from_beside = 0, from_others = 0;
  vector = 0;
  _Pragma("unroll 1") for (int first = 0; first < count; first += LANES, ++vector) {
    const uint a = inner.lanes[vector], b = rows.lanes[vector], c = beside.lanes[vector], d = others.lanes[vector];
    /* Lanes that a queue does not have are 0. */
#define ALL_LANES(x)                                                                      \
  ((unpack_lanes(inner.x + from_inner, a) + unpack_lanes(rows.x + from_rows, b)) +       \
   (unpack_lanes(beside.x + from_beside, c) + unpack_lanes(others.x + from_others, d)))
    STORE_LANES(ALL_LANES(x), gx + first), STORE_LANES(ALL_LANES(y), gy + first), STORE_LANES(ALL_LANES(z), gz + first);
#undef ALL_LANES
    from_inner += popcount(a), from_rows += popcount(b), from_beside += popcount(c), from_others += popcount(d);
  }
}

#endif

#endif
