/* Residual vector quantisation with a depth per sub-block ("rvq"): cuts blocks into sub-blocks, and chooses stages.
 *
 * Of each sub-block the kernel looks for the depth of the least cost D + lambda R: D the squared error of decoded
 * voxels (in 1/256), R bits. The search goes from stage to stage, and ends where even an exact sub-block would cost
 * more than the best so far. It keeps BEAM sequences of codes, each of which goes on with its BEAM nearest codewords (of
 * different lanes, see search_codebook); those of the shortest residuals are kept ("M-search"). Where voxels may be off
 * by `bound` at most, depths that break it do not count. A sub-block may be escaped: its voxels are then stored, or
 * differences that keep the bound.
 *
 * Switches (-D): SIZE 64; SUBS, sub-blocks per octant: 8, or 1 for blocks of 4 samples per axis; BEAM 1, 2 or 4.
 */
#include "nearest_code.h"

#define MOST_STAGES 12
#define ESCAPED 15
#define RAW_SAMPLES 0xff
#define GROUP (8 * SUBS) /* sub-blocks of a work-item */
#define EDGE (SUBS == 8 ? 8 : 4) /* samples per axis of an octant */

/* Cuts blocks into octants and these into sub-blocks. A work-item takes one octant.
 *
 * samples  ushort [blocks][edge][edge][edge], working values
 * work     ushort [octants][SUBS][64], the same by sub-block
 * means    uchar [octants][SUBS + 1]: of each sub-block, and of the octant
 * flat     ulong [octants][2]: sum of squared differences and largest difference of an octant of its mean alone
 * apart    ulong [octants][SUBS][2]: the same of sub-blocks of their means
 * sums     ulong [octants][4]: sum, sum of squares, least and largest of the voxels' steps above the range's lowest
 */
__kernel void cut_blocks(__global const ushort *restrict samples, int edge, int octants, uint levels,
                         __global ushort *restrict work, __global uchar *restrict means,
                         __global ulong *restrict flat, __global ulong *restrict apart,
                         __global ulong *restrict sums)
{
  const int octant = get_global_id(0);
  if (octant >= octants) return;
  const int per_axis = edge / EDGE, inside = octant % (per_axis * per_axis * per_axis);
  const int oz = inside / (per_axis * per_axis) * EDGE, oy = inside / per_axis % per_axis * EDGE,
            ox = inside % per_axis * EDGE;
  __global const ushort *block =
      samples + (size_t)(octant / (per_axis * per_axis * per_axis)) * edge * edge * edge;
  __global ushort *out = work + (size_t)octant * SUBS * 64;
  __global uchar *mean = means + (size_t)octant * (SUBS + 1);
  uint whole = 0;
  for (int sub = 0; sub < SUBS; sub++) {
    const int z = oz + (sub >> 2) * 4, y = oy + (sub >> 1 & 1) * 4, x = ox + (sub & 1) * 4;
    uint4 sum = (uint4)(0);
    for (int row = 0; row < 16; row++) {
      const ushort4 v = vload4(0, block + ((size_t)(z + (row >> 2)) * edge + y + (row & 3)) * edge + x);
      vstore4(v, row, out + sub * 64);
      sum += convert_uint4(v);
    }
    const uint total = sum.x + sum.y + sum.z + sum.w;
    mean[sub] = (uchar)(total >> 14);
    whole += total >> 4; /* 512 values of 16 bits less 4 bits fit */
  }
  mean[SUBS] = (uchar)(whole / SUBS >> 10);
  for (int sub = 0; sub < SUBS; sub++) {
    const int8 level = (int8)(((uint)(mean[sub] << 8) + 128) * levels >> 16);
    ulong8 off = (ulong8)(0);
    uint8 most = (uint8)(0);
    for (int k = 0; k < 8; k++) {
      const int8 d = convert_int8(convert_uint8(vload8(sub * 8 + k, out)) * levels >> 16) - level;
      off += convert_ulong8(convert_uint8(d * d));
      most = max(most, abs(d));
    }
    const ulong4 off4 = off.lo + off.hi;
    const uint4 most4 = max(most.lo, most.hi);
    apart[2 * (octant * SUBS + sub)] = off4.x + off4.y + off4.z + off4.w;
    apart[2 * (octant * SUBS + sub) + 1] = max(max(most4.x, most4.y), max(most4.z, most4.w));
  }
  const int level = (int)(((uint)(mean[SUBS] << 8) + 128) * levels >> 16);
  ulong total = 0, squares = 0, off = 0;
  int lowest = INT_MAX, highest = INT_MIN;
  for (int k = 0; k < SUBS * 8; k++) {
    const int8 v = convert_int8(convert_uint8(vload8(k, out)) * levels >> 16);
    const int8 low4 = v;
    const ulong8 wide = convert_ulong8(v);
    const int8 d = v - level;
    const ulong8 o = convert_ulong8(convert_uint8(d * d)), q = wide * wide;
    const ulong8 sum8 = wide;
    total += sum8.s0 + sum8.s1 + sum8.s2 + sum8.s3 + sum8.s4 + sum8.s5 + sum8.s6 + sum8.s7;
    squares += q.s0 + q.s1 + q.s2 + q.s3 + q.s4 + q.s5 + q.s6 + q.s7;
    off += o.s0 + o.s1 + o.s2 + o.s3 + o.s4 + o.s5 + o.s6 + o.s7;
    const int4 l4 = min(low4.lo, low4.hi), h4 = max(low4.lo, low4.hi);
    const int2 l2 = min(l4.lo, l4.hi), h2 = max(h4.lo, h4.hi);
    lowest = min(lowest, min(l2.x, l2.y));
    highest = max(highest, max(h2.x, h2.y));
  }
  flat[2 * octant] = off;
  flat[2 * octant + 1] = (ulong)max(highest - level, level - lowest);
  sums[4 * octant] = total;
  sums[4 * octant + 1] = squares;
  sums[4 * octant + 2] = (ulong)lowest;
  sums[4 * octant + 3] = (ulong)highest;
}

/* The bits of packed residuals that hold steps from `lowest` to `highest`, in two's complement. */
inline int residual_bits(int lowest, int highest, int bound)
{
  const int step = 2 * bound + 1, least = -((bound - lowest) / step), most = (highest + bound) / step;
  int bits = 0;
  if (least < 0 || most > 0)
    for (bits = 1; -(1 << (bits - 1)) > least || (1 << (bits - 1)) - 1 < most;) bits++;
  return bits;
}

/* The best choice for a sub-block so far. */
typedef struct {
  long cost;
  ulong squares;
  int bits, depth, escape, largest;
} Choice;

/* Considers `depth` stages; whether that is better. */
inline int consider(Choice *choice, Miss miss, int depth, long lambda, long weight, int bound, int packed)
{
  const int largest = max(miss.highest, -miss.lowest);
  int improved = 0;
  if (largest <= bound) {
    const long cost = weight * (long)miss.squares + lambda * (8 * depth);
    if (cost < choice->cost) {
      const Choice better = {cost, miss.squares, 8 * depth, depth, 0, largest};
      *choice = better;
      improved = 1;
    }
  }
  const int bits = residual_bits(miss.lowest, miss.highest, packed);
  const int size = 8 + 8 * depth + 64 * bits;
  if (bits <= 8 && lambda * size < choice->cost) {
    const Choice better = {lambda * size, 0, size, ESCAPED, depth | bits << 4, packed};
    *choice = better;
    improved = 1;
  }
  return improved;
}

/* The sequences of codes that a sub-block's search keeps. */
typedef struct {
  uchar codes[BEAM][MOST_STAGES];
} Kept;

/* Goes one stage on for a sub-block: from `number` sequences, whose residuals (int [BEAM][64]) and codes are replaced
 * by the BEAM best of those that go on with `next` [number][BEAM]. */
inline void go_on(__global int *restrict residual, Kept *kept, int number, const int next[][BEAM], int stage,
                  __global const char *restrict entries, int shift)
{
  ulong lengths[BEAM];
  int best[BEAM];
  for (int b = 0; b < BEAM; b++) {
    lengths[b] = ULONG_MAX;
    best[b] = 0;
  }
  for (int c = 0; BEAM > 1 && c < number * BEAM; c++) {
    ulong length = length_without(residual + c / BEAM * 64, entries + next[c / BEAM][c % BEAM] * 64, shift);
    int at = c;
    for (int b = 0; b < BEAM; b++)
      if (length < lengths[b]) {
        const ulong longer = lengths[b];
        const int other = best[b];
        lengths[b] = length;
        best[b] = at;
        length = longer;
        at = other;
      }
  }
  if (BEAM == 1) {
    subtract(residual, entries + next[0][0] * 64, shift);
    kept->codes[0][stage] = (uchar)next[0][0];
    return;
  }
  int left[BEAM][64];
  const Kept before = *kept;
  for (int b = 0; b < BEAM; b++) {
    const int from = best[b] / BEAM, code = next[from][best[b] % BEAM];
    for (int k = 0; k < 64; k++) left[b][k] = residual[from * 64 + k] - ((int)entries[code * 64 + k] << shift);
    for (int j = 0; j < MOST_STAGES; j++) kept->codes[b][j] = before.codes[from][j];
    kept->codes[b][stage] = (uchar)code;
  }
  for (int b = 0; b < BEAM; b++)
    for (int k = 0; k < 64; k++) residual[b * 64 + k] = left[b][k];
}

/* Chooses stages, a work-item for eight octants.
 *
 * work, means, flat  as cut_blocks wrote them
 * odd       uchar [octants][SUBS]: whether a sub-block has voxels that working values do not express
 * codebook  float [stages][64][ENTRIES]; norms float [stages][ENTRIES]; entries char [stages][ENTRIES][64]
 * lambdas   long [octants]; bounds int [octants]: in the unit of differences
 * weight    256, or 0 where bits alone count
 * packed    the bound of packed residuals, whose steps are 2 packed + 1
 * raw_bits  per voxel
 * residual  int [octants][SUBS][BEAM][64]: scratch
 * depths    uchar [octants][SUBS]; escapes uchar [octants][SUBS]: stages and bits, or RAW_SAMPLES
 * codes     uchar [octants][SUBS][MOST_STAGES]
 * split     uchar [octants]
 * found     ulong [octants][3]: squared error, bits and largest error of the octant as chosen
 */
__kernel void choose_codes(__global const ushort *restrict work, __global const uchar *restrict means,
                           __global const ulong *restrict flat, __global const uchar *restrict odd,
                           __global const float *restrict codebook, __global const float *restrict norms,
                           __global const char *restrict entries, __global const int *restrict shifts,
                           __global const long *restrict lambdas, __global const int *restrict bounds, long weight,
                           int packed, int raw_bits, uint levels, int octants, int stages,
                           __global int *restrict residual, __global uchar *restrict depths,
                           __global uchar *restrict escapes, __global uchar *restrict codes,
                           __global uchar *restrict split, __global ulong *restrict found)
{
  const int first = get_global_id(0) * 8, last = min(octants, first + 8);
  Choice choices[GROUP];
  Kept kept[GROUP];
  int active[GROUP], count = 0;
  float rows[4 * SIZE];
  for (int octant = first; octant < last; octant++) {
    const long lambda = lambdas[octant];
    const int bound = bounds[octant];
    int any_odd = 0;
    for (int sub = 0; sub < SUBS; sub++) any_odd |= odd[octant * SUBS + sub];
    /* An octant of one mean may cost no more than one that is split and exact. */
    split[octant] = SUBS == 1 || any_odd || flat[2 * octant + 1] > (ulong)bound ||
                    weight * (long)flat[2 * octant] + 8 * lambda > 96 * lambda;
    if (!split[octant]) continue;
    for (int sub = 0; sub < SUBS; sub++) {
      const int at = octant * SUBS + sub, mean = (means[octant * (SUBS + 1) + sub] << 8) + 128;
      Choice *choice = choices + (at - first * SUBS);
      const int size = 8 + 64 * raw_bits;
      const Choice raw = {lambda * size, 0, size, ESCAPED, RAW_SAMPLES, 0};
      *choice = raw;
      if (odd[at]) continue;
      __global int *r = residual + (size_t)at * (BEAM * 64);
      for (int k = 0; k < 8; k++) vstore8(convert_int8(vload8(k, work + (size_t)at * 64)) - mean, k, r);
      consider(choice, measure(work + (size_t)at * 64, r, levels), 0, lambda, weight, bound, packed);
      if (8 * lambda < choice->cost) active[count++] = at;
    }
  }
  for (int stage = 0; stage < stages && count; stage++) {
    const int shift = shifts[stage], number = stage ? BEAM : 1, together = 4 / number;
    __global const char *words = entries + (size_t)stage * (ENTRIES * 64);
    int left = 0;
    for (int i = 0; i < count; i += together) {
      for (int v = 0; v < 4; v++) {
        const size_t from = (size_t)active[min(i + v / number, count - 1)] * BEAM + v % number;
        as_compared(residual + from * 64, shift, rows + v * 64);
      }
      int16 keys[4];
      int next[4][BEAM];
      search_codebook(rows, codebook + stage * (64 * ENTRIES), norms + stage * ENTRIES, keys);
      for (int v = 0; v < 4; v++)
        for (int b = 0; b < BEAM; b++) next[v][b] = take_nearest(keys + v);
      const int end = min(together, count - i);
      for (int v = 0; v < end; v++) {
        const int at = active[i + v], octant = at / SUBS;
        Choice *choice = choices + (at - first * SUBS);
        Kept *own = kept + (at - first * SUBS);
        __global int *r = residual + (size_t)at * (BEAM * 64);
        go_on(r, own, number, next + v * number, stage, words, shift);
        for (int b = 0; b < BEAM; b++) {
          const Miss miss = measure(work + (size_t)at * 64, r + b * 64, levels);
          if (consider(choice, miss, stage + 1, lambdas[octant], weight, bounds[octant], packed))
            for (int j = 0; j <= stage; j++) codes[(size_t)at * MOST_STAGES + j] = own->codes[b][j];
        }
        if (8 * (stage + 2) * lambdas[octant] < choice->cost) active[left++] = at;
      }
    }
    count = left;
  }
  for (int octant = first; octant < last; octant++) {
    const long lambda = lambdas[octant];
    const ulong off = flat[2 * octant], off_most = flat[2 * octant + 1];
    long cost = 0;
    ulong squares = 0, largest = 0;
    int bits = 0;
    if (split[octant]) {
      int any_odd = 0;
      for (int sub = 0; sub < SUBS; sub++) {
        const Choice choice = choices[(octant - first) * SUBS + sub];
        cost += choice.cost + lambda * (SUBS == 1 ? 16 : 12);
        bits += choice.bits + (SUBS == 1 ? 16 : 12);
        squares += choice.squares;
        largest = max(largest, (ulong)choice.largest);
        any_odd |= odd[octant * SUBS + sub];
        depths[octant * SUBS + sub] = (uchar)choice.depth;
        escapes[octant * SUBS + sub] = (uchar)choice.escape;
      }
      split[octant] = SUBS == 1 || any_odd || off_most > (ulong)bounds[octant] ||
                      weight * (long)off + 8 * lambda > cost;
    }
    if (!split[octant]) {
      squares = off;
      bits = 8;
      largest = off_most;
      for (int sub = 0; sub < SUBS; sub++) depths[octant * SUBS + sub] = escapes[octant * SUBS + sub] = 0;
    }
    found[3 * octant] = squares;
    found[3 * octant + 1] = (ulong)bits;
    found[3 * octant + 2] = largest;
  }
}
