/* The gradient of the field of blocks: central differences, over a voxel to each side, of the values that blend_blocks.h
 * makes. They are continuous wherever these are, across the faces of blocks of any two resolutions; and where voxels are
 * at full resolution they are the voxels' own differences interpolated, as in gradient.h. Beyond the volume's faces the
 * field goes on in a straight line, f(-d) = 2 f(0) - f(d), which makes the differences there one-sided.
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
    const Edge low1 = fetch_block_edge(v, buffer, here + (row - 1)), high1 = fetch_block_edge(v, buffer, here + (row + 1));
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

/* Gradients at places in arrays. Most places lie a voxel and more within a block at full resolution, or between such
 * blocks: there voxels are taken one by one, as in gradient.h, and only elsewhere six blended values. Places of a kind
 * are taken together, so that no vector of them has to do what few of its lanes need. */
#define MOST_PLACES (34 * LANES)
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

/* The gradient between eight blocks at full resolution. */
INLINE Gradient beside_block_gradient(const BlockVolume *v, VoxelAxis x, VoxelAxis y, VoxelAxis z, intN active)
{
  const int log_edge = v->blocks->log_edge, within = (1 << log_edge) - 1;
  const int4 count = v->blocks->count;
  intN start[8];
  _Pragma("unroll") for (int k = 0; k < 8; ++k) {
    const intN bx = min(x.lower + (k & 1), (intN)(count.x - 1)), by = min(y.lower + (k >> 1 & 1), (intN)(count.y - 1));
    const intN bz = min(z.lower + (k >> 2), (intN)(count.z - 1));
    const intN block = (max(bz, (intN)0) * count.y + max(by, (intN)0)) * count.x + max(bx, (intN)0);
    start[k] = AS_INT(gather4(v->index, 2 * (block & active)));
  }
  intN xs[4];
  for (int i = 0; i < 4; ++i) xs[i] = (x.first + i) & within;
  floatN gx[2], gy[2], mean[4], m[4]; /* m: of rows, means along x */
  _Pragma("unroll") for (int l = 0; l < 4; ++l) {
    const intN behind = MASK(z.before <= l), zs = ((z.first + l) & within) << 2 * log_edge;
    const intN s00 = select(start[0], start[4], behind), s10 = select(start[1], start[5], behind);
    const intN s01 = select(start[2], start[6], behind), s11 = select(start[3], start[7], behind);
    const int middle = l == 1 || l == 2;
    floatN slope[4];
    _Pragma("unroll") for (int j = 0; j < 4; ++j) {
      if (!middle && (j == 0 || j == 3)) continue;
      const intN below = MASK(y.before <= j), at = zs + (((y.first + j) & within) << log_edge);
      const intN near = at + select(s00, s01, below), far = at + select(s10, s11, below);
      const floatN v1 = fetch_block_sample(v, (xs[1] + select(near, far, MASK(x.before <= 1))) & active);
      const floatN v2 = fetch_block_sample(v, (xs[2] + select(near, far, MASK(x.before <= 2))) & active);
      m[j] = mix_corners(v1, v2, x.f);
      if (middle && (j == 1 || j == 2)) {
        const floatN v0 = fetch_block_sample(v, (xs[0] + select(near, far, MASK(x.before <= 0))) & active);
        const floatN v3 = fetch_block_sample(v, (xs[3] + select(near, far, MASK(x.before <= 3))) & active);
        slope[j] = mix_corners(v2 - v0, v3 - v1, x.f);
      }
    }
    mean[l] = mix_corners(m[1], m[2], y.f);
    if (middle) gx[l - 1] = mix_corners(slope[1], slope[2], y.f), gy[l - 1] = mix_corners(m[2] - m[0], m[3] - m[1], y.f);
  }
  const Gradient g = {0.5f * mix_corners(gx[0], gx[1], z.f), 0.5f * mix_corners(gy[0], gy[1], z.f),
                      0.5f * mix_corners(mean[2] - mean[0], mean[3] - mean[1], z.f)};
  return finite_gradient(g);
}

/* In: `count` lattice points. Out: the gradients there. Behind them there is room for a vector. */
INLINE void blocks_gradients(const BlockVolume *v, int count, float *gx, float *gy, float *gz, Tally *tally)
{
  const float4 upper = v->view->upper;
  const int4 blocks = v->blocks->count;
  const float edge = v->blocks->edge;
  const int log_edge = v->blocks->log_edge;
  const floatN half_ = 0.5f, zero = 0.0f;
  GradientQueue inner, beside, others;
  inner.count = beside.count = others.count = 0;
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
    intN between = 0;
#if INTERBLOCK && SAMPLE_BUFFERS == 1
    if (any_lane(inside & ~within) && log_edge >= 3) {
      const Around a = blocks_around(v, here.x, here.y, here.z, px, py, pz, inside);
      between = inside & ~within & MASK(a.codes == (uint)(log_edge + 1) * 0x11111111u);
    }
#endif
    queue_gradients(&inner, vector, px, py, pz, within), queue_gradients(&beside, vector, px, py, pz, between);
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
  _Pragma("unroll 1") for (int first = 0; first < beside.count; first += LANES) {
    const intN active = MASK(first + LANE_INDEX < beside.count);
    const floatN px = select((floatN)1.5f, LOAD_LANES(beside.x + first), active);
    const floatN py = select((floatN)1.5f, LOAD_LANES(beside.y + first), active);
    const floatN pz = select((floatN)1.5f, LOAD_LANES(beside.z + first), active);
    const VoxelAxis x = voxel_axis(v, px, nearest_face(px, block_of(px, v, blocks.x), v).corner);
    const VoxelAxis y = voxel_axis(v, py, nearest_face(py, block_of(py, v, blocks.y), v).corner);
    const VoxelAxis z = voxel_axis(v, pz, nearest_face(pz, block_of(pz, v, blocks.z), v).corner);
    store_gradient(&beside, first, beside_block_gradient(v, x, y, z, active));
    count_lanes(&tally[COUNT_BLOCK_READS], active);
  }
  _Pragma("unroll 1") for (int first = 0; first < others.count; first += LANES) {
    const intN active = MASK(first + LANE_INDEX < others.count);
    const floatN x = select(zero, LOAD_LANES(others.x + first) - half_, active);
    const floatN y = select(zero, LOAD_LANES(others.y + first) - half_, active);
    const floatN z = select(zero, LOAD_LANES(others.z + first) - half_, active);
    store_gradient(&others, first, blocks_gradient(v, x, y, z, active, tally));
  }
  int from_inner = 0, from_beside = 0, from_others = 0;
  vector = 0;
  _Pragma("unroll 1") for (int first = 0; first < count; first += LANES, ++vector) {
    const uint a = inner.lanes[vector], b = beside.lanes[vector], c = others.lanes[vector];
    /* Lanes that a queue does not have are 0. */
#define ALL_LANES(x) \
  (unpack_lanes(inner.x + from_inner, a) + unpack_lanes(beside.x + from_beside, b) + unpack_lanes(others.x + from_others, c))
    STORE_LANES(ALL_LANES(x), gx + first), STORE_LANES(ALL_LANES(y), gy + first), STORE_LANES(ALL_LANES(z), gz + first);
#undef ALL_LANES
    from_inner += popcount(a), from_beside += popcount(b), from_others += popcount(c);
  }
}

#endif

#endif
