/* Interblock interpolation: values between the outermost samples of blocks of any resolutions, with no voxels stored
 * twice (Ljung, Lundstroem, Ynnerman 2006; its two-dimensional form is Ljung 2006, eq. 5 and 6).
 *
 * Around a place there are eight blocks with a corner in common. Each is sampled with clamping, and the values are
 * blended. Their weight of block j on the edge from i, d the distance to the face between them (i on this side; in
 * blocks), is
 *   e_ij = clamp((delta_i - d) / (delta_i + delta_j), 0, 1),   delta = 1 / (2 samples per axis),
 * and that of a block the product of the e or 1 - e along its own three edges, normalised. Two things are different
 * here:
 *
 * 1. delta_i and delta_j are both taken as the smaller one, m: e_ij = clamp(1/2 - d / (2 m), 0, 1). In a coarse block,
 * even one that is
 *    coarse because it is constant, their blend reaches as far as its own outermost sample, up to half a block: what
 *    is bright behind a face bleeds that far. Here the blend is as wide as the finer one's spacing.
 * 2. The weight of any other block is at most u = max over the axes of clamp(1 - d / delta, 0, 1), delta of the block
 * that holds the
 *    place: 0 inside the hull of that block's samples and 1 at its faces. By their products a coarse block counts
 *    inside the hull of a fine one's samples where only their corners touch (in two dimensions: e12 = e13 = 0, yet e34
 *    e24 > 0).
 *
 * So
 *   - inside the hull of its samples a block is alone, and no other needs to be looked at there: that is most samples;
 *   - the field is continuous: at a face u bounds nothing and both sides agree on m, and at the planes through blocks'
 *   centres,
 *     where the eight blocks change, the ones that leave have no weight;
 *   - equal resolutions give trilinear interpolation of the samples (products are u_x u_y / 4 or less), and a constant
 *   block may
 *     have one sample beside full resolution without any change.
 * The block that holds the place is the origin here; block f = fx + 2 fy + 4 fz lies across the faces whose bits are
 * set. Beyond the volume's faces the outermost blocks stand in for what is not there.
 *
 * Beside a dropped block, which shows nothing and keeps its one value to itself, a block fades from its outermost
 * samples to that value at the face: what is visible does not end at a face, but near its edges, where a second
 * visible block keeps a share up to there.
 */
#ifndef BLEND_BLOCKS_H
#define BLEND_BLOCKS_H

#include "blocks.h"
#include "features.h"
#include "lanes.h"
#include "tally.h"

/* Steps whose samples are taken together. The more, the fuller the vectors of what is blended; but also the more
 * samples are taken in vain behind the place where a ray ends, and long steps have fewer to spare. */
#ifndef QUEUED_STEPS
#define QUEUED_STEPS (STEPPING == STEPPING_FULL ? 12 : 8)
#endif

/* Distances to the nearest faces in blocks, 0 .. 1/2, and whether they are the upper ones. */
typedef struct {
  floatN d;
  intN upper; /* mask */
  intN corner;
} FaceAxis;

INLINE FaceAxis nearest_face(floatN p, intN block, const BlockVolume *v)
{
  FaceAxis a;
  const floatN inside = lane_clamp(p * v->blocks->inverse_edge - TO_FLOAT(block), (floatN)0.0f, (floatN)1.0f);
  a.upper = MASK(inside >= 0.5f);
  a.d = select(inside, 1.0f - inside, a.upper);
  a.corner = block - a.upper;
  return a;
}

/* 1 / (2 delta): samples per axis, of a code; SAMPLES_DROPPED of a dropped block's. */
INLINE floatN samples_of_code(uintN code) { return AS_FLOAT(AS_INT((code + 126u) << 23u)); }
#define SAMPLES_DROPPED 16384.0f

/* The same of the code in the lowest four bits. */
INLINE floatN samples_of_nibble(uintN codes)
{
#if LANES == 16
  return permuted_lanes(samples_of_code(AS_UINT(LANE_INDEX)), AS_INT(codes));
#else
  return samples_of_code(codes & 15u);
#endif
}

/* e of the edge from a block of i samples per axis, on this side of the face, to one of j. `dropped`: one of the two
 * may be. */
INLINE floatN edge_weight(floatN i, floatN j, floatN d, int dropped)
{
  const floatN zero = 0.0f, e = lane_max(0.5f - d * lane_max(i, j), zero);
  if (!dropped) return e;
  const intN here = MASK(i == SAMPLES_DROPPED), there = MASK(j == SAMPLES_DROPPED);
  return select(select(e, lane_max(1.0f - 2.0f * d * i, zero), there & ~here), zero, here & ~there);
}

/* What all eight weights depend on: places relative to the block's faces, and codes of the blocks around the nearest
 * corner. */
typedef struct {
  FaceAxis x, y, z;
  uintN codes, own;
} Around;

INLINE Around blocks_around(const BlockVolume *v, intN bx, intN by, intN bz, floatN px, floatN py, floatN pz,
                            intN active)
{
  Around a;
  a.x = nearest_face(px, bx, v), a.y = nearest_face(py, by, v), a.z = nearest_face(pz, bz, v);
  const int4 count = v->blocks->count;
  const intN corner = (a.z.corner * (count.y + 1) + a.y.corner) * (count.x + 1) + a.x.corner;
  a.codes = gather4(v->corners, corner & active);
  /* Below the corner's plane a block has the number 0 along that axis, above it 1. */
  a.own = (AS_UINT(~a.x.upper) & 1u) | (AS_UINT(~a.y.upper) & 2u) | (AS_UINT(~a.z.upper) & 4u);
  return a;
}

/* Weights of all eight blocks, not yet normalised. Written out: in loops everything would live in memory. Where all
 * are alike parallel edges have the same weight, bit for bit, and u bounds nothing. */
INLINE void blend_weights(const Around *a, intN active, floatN *weight)
{
  const floatN dx = a->x.d, dy = a->y.d, dz = a->z.d;
  if (!any_lane(active & MASK(a->codes != (a->codes & 15u) * 0x11111111u))) {
    const floatN n = samples_of_code(a->codes & 15u);
    const floatN x = edge_weight(n, n, dx, 0), y = edge_weight(n, n, dy, 0), z = edge_weight(n, n, dz, 0);
    const floatN rx = 1.0f - x, ry = 1.0f - y, rz = 1.0f - z;
    weight[0] = rx * ry * rz, weight[1] = x * ry * rz, weight[2] = rx * y * rz, weight[3] = x * y * rz;
    weight[4] = rx * ry * z, weight[5] = x * ry * z, weight[6] = rx * y * z, weight[7] = x * y * z;
    return;
  }
  const int drop = any_lane(active & MASK((a->codes & 0x88888888u) != 0u));
#define SAMPLES(f) samples_of_nibble(a->codes >> ((a->own << 2u) ^ (4u * f##u)))
  const floatN n0 = SAMPLES(0), n1 = SAMPLES(1), n2 = SAMPLES(2), n3 = SAMPLES(3), n4 = SAMPLES(4), n5 = SAMPLES(5);
  const floatN n6 = SAMPLES(6), n7 = SAMPLES(7);
#undef HALF
  const floatN x01 = edge_weight(n0, n1, dx, drop), x23 = edge_weight(n2, n3, dx, drop);
  const floatN x45 = edge_weight(n4, n5, dx, drop), x67 = edge_weight(n6, n7, dx, drop);
  const floatN y02 = edge_weight(n0, n2, dy, drop), y13 = edge_weight(n1, n3, dy, drop);
  const floatN y46 = edge_weight(n4, n6, dy, drop), y57 = edge_weight(n5, n7, dy, drop);
  const floatN z04 = edge_weight(n0, n4, dz, drop), z15 = edge_weight(n1, n5, dz, drop);
  const floatN z26 = edge_weight(n2, n6, dz, drop), z37 = edge_weight(n3, n7, dz, drop);
  const floatN nearest = lane_min(lane_min(dx, dy), dz);
  const floatN u = lane_max(1.0f - 2.0f * nearest * n0, (floatN)0.0f);
  weight[0] = (1.0f - x01) * (1.0f - y02) * (1.0f - z04);
  weight[1] = x01 * (1.0f - y13) * (1.0f - z15);
  weight[2] = (1.0f - x23) * y02 * (1.0f - z26);
  weight[3] = lane_min(x23 * y13 * (1.0f - z37), u);
  weight[4] = (1.0f - x45) * (1.0f - y46) * z04;
  weight[5] = lane_min(x45 * (1.0f - y57) * z15, u);
  weight[6] = lane_min((1.0f - x67) * y46 * z26, u);
  weight[7] = lane_min(x67 * y57 * z37, u);
}

/* The block across the nearest face along one axis. */
INLINE intN across(intN block, const FaceAxis *a, int count)
{
  return min(max(block + select((intN)-1, (intN)1, a->upper), (intN)0), (intN)(count - 1));
}

#if LANES == 1

/* The value at p, where `value` is that of the block `r` which holds p. */
INLINE floatN blend_blocks(const BlockVolume *v, const Record *r, floatN px, floatN py, floatN pz, floatN value,
                           Tally *tally)
{
  const Around a = blocks_around(v, r->x, r->y, r->z, px, py, pz, ~0);
  const int4 count = v->blocks->count;
  floatN weight[8], sum = 0.0f, total;
  blend_weights(&a, ~(intN)0, weight);
  total = weight[0];
  int blended = 0;
  for (int f = 1; f < 8; ++f) {
    if (!(weight[f] > 0.0f)) continue;
    const Record other = fetch_record(v, f & 1 ? across(r->x, &a.x, count.x) : r->x,
                                      f & 2 ? across(r->y, &a.y, count.y) : r->y,
                                      f & 4 ? across(r->z, &a.z, count.z) : r->z);
    const BlockPlace s = place_in_block(v, &other, px, py, pz);
    sum += weight[f] * (value_in_block(v, &s) - value), total += weight[f];
    ++tally[COUNT_BLOCK_READS];
    blended = 1;
  }
  tally[COUNT_BLENDED_SAMPLES] += blended;
  return blended ? value + sum / total : value;
}

#else

/* In a packet few samples lie between blocks, and of the seven other blocks one or two have weight: lane by lane most
 * of a vector would do nothing. So places that need blending are queued over several steps of the packet, and worked
 * off 16 at a time: first, of each, one block across a face (of most there is no other), then all other (place, block)
 * pairs, which are queued as well. What comes out stays in the queue's order, and each step takes its own from there.
 * (Without queues blending took more than twice as long.) */
#define QUEUE_LENGTH (LANES * QUEUED_STEPS)
#define PAIRS_LENGTH (6 * QUEUE_LENGTH)

/* Places in blocks whose values are wanted: of the samples of QUEUED_STEPS steps, then of pairs. All addresses come
 * before all fetches: the loads of many vectors are under way at once. */
#define FETCHES (INTERBLOCK ? 8 * QUEUED_STEPS + 1 : QUEUED_STEPS)

typedef struct {
  int at[LANES], shift[LANES];
  uint word1[LANES];
  float fx[LANES], fy[LANES], fz[LANES], value[LANES];
  int kind; /* alike() of their blocks */
} Fetch;

/* Stores where to fetch what is wanted in the blocks `r`; gives the lanes that are beyond the outermost samples. */
INLINE intN place_fetch(const BlockVolume *v, Fetch *f, const Record *r, int kind, floatN px, floatN py, floatN pz)
{
  BlockPlace p;
  f->kind = kind;
  if (kind == ALIKE_NOT) {
    p = place_in_block(v, r, px, py, pz);
    STORE_LANES(p.shift, f->shift);
  } else
    p = place_in_alike_block(v, r, kind, px, py, pz);
  STORE_LANES(p.at, f->at), STORE_LANES(p.fx, f->fx), STORE_LANES(p.fy, f->fy), STORE_LANES(p.fz, f->fz);
  if (kind != ALIKE_FULL) STORE_LANES(p.word1, f->word1), STORE_LANES(p.value, f->value);
  return p.outside;
}

INLINE floatN fetched_value(const BlockVolume *v, const Fetch *f)
{
  BlockPlace p;
  p.at = LOAD_LANES(f->at), p.fx = LOAD_LANES(f->fx), p.fy = LOAD_LANES(f->fy), p.fz = LOAD_LANES(f->fz);
  if (f->kind == ALIKE_FULL) return value_in_alike_block(v, ALIKE_FULL, &p);
  p.word1 = LOAD_LANES(f->word1), p.value = LOAD_LANES(f->value);
  if (f->kind == ALIKE_OR_ONE_VALUE) return value_in_alike_block(v, ALIKE_OR_ONE_VALUE, &p);
  p.shift = LOAD_LANES(f->shift);
  return value_in_block(v, &p);
}

/* Places to be blended, and, once that is done, what with: value += share (other - value). */
typedef struct {
  int count;
  int from[QUEUED_STEPS];   /* first place of each step */
  uint lanes[QUEUED_STEPS]; /* its lanes, as bits */
  float x[QUEUE_LENGTH + LANES], y[QUEUE_LENGTH + LANES], z[QUEUE_LENGTH + LANES];
  float other[QUEUE_LENGTH + LANES], share[QUEUE_LENGTH + LANES];
} PlaceQueue;

/* Other pairs of the places of one vector: six blocks, of each the lanes whose places it has weight for, one after the
 * other. */
#define OTHERS 6

typedef struct {
  int any;
  int from[OTHERS];             /* number of the first pair */
  uint lanes[OTHERS];           /* as bits */
  float weight[OTHERS][LANES];  /* also of the lanes that are not there: 0 */
} OtherPairs;

typedef struct {
  int vectors, count;                 /* of first pairs, one a place; other pairs */
  float slot[PAIRS_LENGTH + LANES];   /* other pairs: bits of the number in the queue of places */
  float block[PAIRS_LENGTH + LANES];  /* and bits of x | y << 10 | z << 20 */
  float first[QUEUED_STEPS][LANES];   /* weights of the first ones, and of all eight */
  float total[QUEUED_STEPS][LANES];
  OtherPairs others[QUEUED_STEPS];
} PairQueue;

/* Places of the lanes in `between`, of one step. */
INLINE void queue_places(PlaceQueue *q, floatN px, floatN py, floatN pz, int step, intN between)
{
  const uint bits = lane_bits(between);
  const int at = q->count;
  q->from[step] = at, q->lanes[step] = bits;
  if (!bits) return;
  pack_lanes(px, bits, q->x + at), pack_lanes(py, bits, q->y + at), pack_lanes(pz, bits, q->z + at);
  q->count = at + popcount(bits);
}

/* The pairs of all places of `q`, and where to fetch what they want: the first ones' vectors, then the others'.
 * Returns how many vectors. */
INLINE int queue_pairs(const BlockVolume *v, const PlaceQueue *q, PairQueue *p, Fetch *fetches, Tally *tally)
{
  const int4 count = v->blocks->count;
  const int places = q->count;
  int pairs = 0;
  p->vectors = (places + LANES - 1) / LANES;
  _Pragma("unroll 1") for (int k = 0; k < p->vectors; ++k) {
    const int first = k * LANES;
    const intN active = MASK(LANE_INDEX < places - first);
    const floatN zero = 0.0f, half_ = 0.5f;
    const floatN px = select(half_, LOAD_LANES(q->x + first), active);
    const floatN py = select(half_, LOAD_LANES(q->y + first), active);
    const floatN pz = select(half_, LOAD_LANES(q->z + first), active);
    const intN bx = block_of(px, v, count.x), by = block_of(py, v, count.y), bz = block_of(pz, v, count.z);
    const Around a = blocks_around(v, bx, by, bz, px, py, pz, active);
    floatN weight[8];
    blend_weights(&a, active, weight);
    const intN ax = across(bx, &a.x, count.x), ay = across(by, &a.y, count.y), az = across(bz, &a.z, count.z);
    const intN by_x = MASK(weight[1] > zero), by_y = MASK(weight[2] > zero) & ~by_x;
    const intN by_z = MASK(weight[4] > zero) & ~by_x & ~by_y;
    const Record r = fetch_record(v, select(bx, ax, by_x), select(by, ay, by_y), select(bz, az, by_z));
    place_fetch(v, fetches + k, &r, alike(v, &r), px, py, pz);
    const floatN first_weight = select(select(select(zero, weight[4], by_z), weight[2], by_y), weight[1], by_x);
    const floatN others = weight[3] + weight[5] + weight[6] + weight[7] + select(zero, weight[2], by_x) +
                          select(zero, weight[4], by_x | by_y);
    STORE_LANES(first_weight, p->first[k]), STORE_LANES(weight[0] + first_weight + others, p->total[k]);
    count_lanes(&tally[COUNT_BLENDED_SAMPLES], active & (by_x | by_y | by_z | MASK(others > zero)));
    count_lanes(&tally[COUNT_BLOCK_READS], active & (by_x | by_y | by_z));
    OtherPairs *o = p->others + k;
    o->any = any_lane(active & MASK(others > zero));
    if (!o->any) continue;
    const floatN slot = AS_FLOAT(first + LANE_INDEX);
    const intN ay10 = ay << 10, az20 = az << 20, by10 = by << 10, bz20 = bz << 20;
    int block[OTHERS][LANES];
    STORE_LANES(select(zero, weight[2], by_x), o->weight[0]), STORE_LANES(bx + ay10 + bz20, block[0]);
    STORE_LANES(select(zero, weight[4], by_x | by_y), o->weight[1]), STORE_LANES(bx + by10 + az20, block[1]);
    STORE_LANES(weight[3], o->weight[2]), STORE_LANES(ax + ay10 + bz20, block[2]);
    STORE_LANES(weight[5], o->weight[3]), STORE_LANES(ax + by10 + az20, block[3]);
    STORE_LANES(weight[6], o->weight[4]), STORE_LANES(bx + ay10 + az20, block[4]);
    STORE_LANES(weight[7], o->weight[5]), STORE_LANES(ax + ay10 + az20, block[5]);
    _Pragma("unroll 1") for (int j = 0; j < OTHERS; ++j) {
      const uint bits = lane_bits(active & MASK(LOAD_LANES(o->weight[j]) > zero));
      o->lanes[j] = bits;
      if (!bits) continue;
      pack_lanes(slot, bits, p->slot + pairs), pack_lanes(AS_FLOAT(LOAD_LANES(block[j])), bits, p->block + pairs);
      o->from[j] = pairs, pairs += popcount(bits);
    }
  }
  p->count = pairs;
  tally[COUNT_BLOCK_READS] += AS_UINT(select((intN)0, (intN)pairs, MASK(LANE_INDEX == 0)));
  fetches += p->vectors;
  _Pragma("unroll 1") for (int first = 0; first < pairs; first += LANES, ++fetches) {
    const intN active = MASK(LANE_INDEX < pairs - first);
    const intN slot = AS_INT(LOAD_LANES(p->slot + first)) & active;
    const intN block = AS_INT(LOAD_LANES(p->block + first)) & active;
    const Record r = fetch_record(v, block & 1023, (block >> 10) & 1023, block >> 20);
    place_fetch(v, fetches, &r, ALIKE_NOT, gather_private(q->x, slot), gather_private(q->y, slot),
                gather_private(q->z, slot));
  }
  return p->vectors + (pairs + LANES - 1) / LANES;
}

/* From the values of all pairs to what each place is blended with. Differences to the first one: equal values stay as
 * they are. */
INLINE void blend_pairs(PlaceQueue *q, const PairQueue *p, const float *of_pairs)
{
  const float *of_others = of_pairs + p->vectors * LANES;
  _Pragma("unroll 1") for (int k = 0; k < p->vectors; ++k) {
    const floatN first = LOAD_LANES(of_pairs + k * LANES), total = LOAD_LANES(p->total[k]);
    floatN weight = LOAD_LANES(p->first[k]), other = first;
    const OtherPairs *o = p->others + k;
    if (o->any) {
      floatN sum = 0.0f;
      _Pragma("unroll 1") for (int j = 0; j < OTHERS; ++j) {
        if (!o->lanes[j]) continue;
        const floatN own = LOAD_LANES(o->weight[j]);
        sum += own * (unpack_lanes(of_others + o->from[j], o->lanes[j]) - first);
        weight += own;
      }
      other += sum / select((floatN)1.0f, weight, MASK(weight > 0.0f));
    }
    STORE_LANES(other, q->other + k * LANES), STORE_LANES(weight / total, q->share + k * LANES);
  }
}

/* Values of one step, of which those between blocks are blended. */
INLINE floatN blended_value(const PlaceQueue *q, int step, floatN value)
{
  const uint bits = q->lanes[step];
  if (!bits) return value;
  const floatN other = unpack_lanes(q->other + q->from[step], bits);
  const floatN share = unpack_lanes(q->share + q->from[step], bits);
  return select(value, value + share * (other - value), MASK(share > 0.0f));
}

#endif

#endif
