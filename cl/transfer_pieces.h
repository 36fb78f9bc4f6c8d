/* The transfer function as linear pieces, and what a chord through them emits and absorbs, in closed form.
 *
 * Opacity and colour are linear between control points. Along a segment the value runs linearly from `front` to
 * `back`, so the segment is a few stretches, one per piece that it crosses: the rest of the piece that it begins in,
 * whole pieces, and the beginning of the piece that it ends in. What each emits and absorbs has a closed form
 * (stretch.h).
 *
 * This is pre-integration (Engel, Kraus and Ertl 2001) without a table: nothing is sampled, so there are no nodes that
 * narrow pieces fall between, and any length of segment costs the same. Its attenuation within the segment is not
 * neglected.
 *
 * The function is a matrix of floats in `table`, a row per property (ROW_...) and a column per piece;
 * clvol/transfer/pieces.py has the same rows. Piece 0 lies below all control points and the last one above them.
 * Packets of 16 look rows of up to 8 or 16 pieces up in a register (TRANSFER_PIECES 8, 16), and where processors can
 * those of up to 256 in several (32 to 256); else they are gathered from memory (TRANSFER_PIECES 0). There are 16 columns
 * at least.
 */
#ifndef TRANSFER_PIECES_H
#define TRANSFER_PIECES_H

#include "lanes.h"
#include "opacity.h"
#include "stretch.h"
#include "view.h"

#define ROW_BEGIN 0          /* value of the control point below; of piece 0, of the one above */
#define ROW_END 1            /* and above; of the last piece, of the one below */
#define ROW_INVERSE 2        /* 1 / (END - BEGIN); 0 where the piece has no length, or no end */
#define ROW_OPACITY 3        /* at BEGIN, */
#define ROW_OPACITY_CHANGE 4 /* and how much more at END */
#define ROW_COLOR 5          /* red, green, blue at BEGIN */
#define ROW_COLOR_CHANGE 8   /* and how much more at END */
#define ROW_LENGTH 11        /* END - BEGIN, also where float32 cannot tell them apart */
#define ROW_DEPTH 12         /* mean of -log(1 - alpha) over the piece, at most OPAQUE_DEPTH */
#define ROW_MOMENT 13        /* M(r) / DEPTH, upwards */
#define ROW_DEPTHS 14        /* sum of LENGTH DEPTH of all pieces before that are not opaque */
#define ROW_COLORS 15        /* and of LENGTH times the mean of the colour times -log(1 - alpha): red, green, blue */
/* the first piece from this one on that is opaque all along; the number of columns where there is none */
#define ROW_NEXT_OPAQUE 18
#define ROW_LAST_OPAQUE 19   /* the last such piece up to this one; -1 where there is none */
#define ROW_UNITS 20         /* length of a step in opacity units, in all columns */
#define ROW_FROM 21          /* BEGIN; without end for piece 0, */
#define ROW_TO 22            /* and END; without end for the last one: the values that belong to the piece */
#define ROW_CLEAR 23         /* 1 - opacity at BEGIN, which float32 cannot get from an opacity near 1, */
#define ROW_CLEAR_CHANGE 24  /* and how much more at END */
#define ROW_ORIGIN 25        /* what all values are counted from, in all columns: a small range may be far from 0 */
#define ROW_SIXTEENTH 26     /* BEGIN of every sixteenth part of the columns, in the first sixteen */
#define PIECE_ROWS 27        /* behind them, where INTEGRAL_TABLE is set: clvol/transfer/integral_table.py */

/* Where a look-up is more than one instruction compilers want it in one place: inlined, it makes frames 2 to 8 % faster on
 * processors with AVX2, and programs take half as long again to compile. */
#if LANES == 16 && !defined(LANES_IN_AVX512)
#define LOOKED_UP RARE
#else
#define LOOKED_UP INLINE
#endif

/* The pieces that one look-up in a register tells apart; 0 where there is none. */
#define IN_REGISTERS (TRANSFER_PIECES <= 16 ? TRANSFER_PIECES : 0)

/* A function's matrix, and how it is looked up. */
typedef struct {
  __global const float *rows;
  intN first;    /* where a lane's own matrix begins in `rows`, in floats; 0 where `in_registers` */
  int columns;   /* a power of two */
  int count;     /* pieces */
  int in_registers;
  float origin;
  int in_memory; /* has columns of its own, whatever TRANSFER_PIECES says of the scene's function */
} Pieces;

/* The scene's function, or where there are layers the one that begins `first` floats into `table`. */
INLINE Pieces scene_pieces(__global const float *table, intN first, __constant const View *view)
{
  const Pieces f = {table, first, view->piece_columns, view->piece_count, IN_REGISTERS != 0,
                    table[ROW_ORIGIN * view->piece_columns], 0};
  return f;
}

INLINE floatN piece_row(Pieces f, int row, intN piece)
{
#if LANES == 16
  if (f.in_registers && IN_REGISTERS == 8) return permuted_lanes8(f.rows + 16 * row, piece);
  if (f.in_registers) return permuted_lanes(vload16(row, f.rows), piece);
#ifdef TABLES_IN_REGISTERS
  if (f.in_memory) return AS_FLOAT(gather4(f.rows + row * f.columns, f.first + piece));
  if (TRANSFER_PIECES == 32) return permuted_lanes32(f.rows + row * 32, piece);
  if (TRANSFER_PIECES == 64) return permuted_lanes64(f.rows + row * 64, piece);
  if (TRANSFER_PIECES == 128) return permuted_lanes128(f.rows + row * 128, piece);
  if (TRANSFER_PIECES == 256) return permuted_lanes256(f.rows + row * 256, piece);
#endif
  return AS_FLOAT(gather4(f.rows + row * f.columns, f.first + piece));
#else
  return f.rows[f.first + row * f.columns + piece];
#endif
}

/* The last piece that begins at or below `value`, which is counted from the function's origin, as all values below
 * are. */
INLINE intN piece_of(floatN value, Pieces f)
{
  intN piece = 0;
  if (f.in_registers) {
    _Pragma("unroll") for (int step = IN_REGISTERS >> 1; step > 0; step >>= 1) {
      const intN next = piece + step;
      piece = select(piece, next, MASK(value >= piece_row(f, ROW_BEGIN, next)));
    }
    return piece;
  }
  int step = f.columns >> 1;
#if LANES == 16 && !TRANSFER_LAYERS
  /* The first four times among sixteen of them, which one register holds. */
  const float16 sixteenth = vload16(0, f.rows + ROW_SIXTEENTH * f.columns);
  _Pragma("unroll") for (int k = 8; k > 0; k >>= 1) {
    const intN next = piece + k;
    piece = select(piece, next, MASK(value >= permuted_lanes(sixteenth, next)));
  }
  piece *= f.columns >> 4, step = f.columns >> 5;
#endif
  for (; step > 0; step >>= 1) {
    const intN next = piece + step;
    piece = select(piece, next, MASK(value >= piece_row(f, ROW_BEGIN, next)));
  }
  return piece;
}

/* What a part of a piece emits and absorbs. */
typedef struct {
  floatN r, g, b, depth; /* not premultiplied */
#if LIT_AT_ENDS
  floatN at; /* from where in the part its light comes, 0 .. 1 */
#endif
} PiecePart;

/* Notes that the stretches which were appended since `s` had `before` as opacity lie at `x` of the segment. */
#if LIT_AT_ENDS
#define NOTE_PLACE(s, before, x) (s).place += ((s).a - (before)) * (x);
#else
#define NOTE_PLACE(s, before, x)
#endif

/* The part of `piece` from w0 to w1 (shares of the piece), which is `units` opacity units long, of the lanes in
 * `active`; others' are undefined, and what they would need is not computed. */
LOOKED_UP PiecePart part_of_piece(intN piece, floatN w0, floatN w1, floatN units, intN active, Pieces f)
{
#define PIECE_ROW(row) piece_row(f, row, piece)
  const floatN zero = 0.0f, one = 1.0f, q = PIECE_ROW(ROW_CLEAR), q_change = PIECE_ROW(ROW_CLEAR_CHANGE);
  const floatN q0 = lane_max(q + w0 * q_change, zero), q1 = lane_max(q + w1 * q_change, zero), clear = 0.5f * (q0 + q1);
  const floatN opacity = PIECE_ROW(ROW_OPACITY) + 0.5f * (w0 + w1) * PIECE_ROW(ROW_OPACITY_CHANGE);
  /* Thin parts, most of all, take short series; each lane by its own. */
  floatN spread, moment = zero, rate = zero;
  const floatN r = lane_clamp(0.5f * (q1 - q0) * lane_reciprocal(lane_max(clear, (floatN)1e-30f)), -one, one);
  const intN dense = active & MASK(lane_min(q0, q1) < 0.5f);
  if (any_lane(active & ~dense)) {
    spread_and_moment_of_thin(r, &spread, &moment);
    rate = depth_of_thin(opacity) + spread;
  }
  if (any_lane(dense)) {
    floatN wide_spread, wide_moment;
    spread_and_moment(r, &wide_spread, &wide_moment);
    rate = select(rate, depth_of_clear(clear, opacity) + wide_spread, dense),
        moment = select(moment, wide_moment, dense);
  }
  const floatN depth = rate * units;
  moment *= rough_reciprocal(lane_max(rate, (floatN)1e-30f));
  floatN at = emission_position(depth, moment);
  intN thick = active & is_thick(depth, moment);
#if !LIT_AT_ENDS
  thick &= MASK(w0 != w1); /* of one colour */
#endif
  if (any_lane(thick)) {
    const floatN a = PIECE_ROW(ROW_OPACITY), change = PIECE_ROW(ROW_OPACITY_CHANGE);
    const floatN red = fabs(PIECE_ROW(ROW_COLOR_CHANGE)), green = fabs(PIECE_ROW(ROW_COLOR_CHANGE + 1));
    const floatN colors = fabs(w1 - w0) * lane_max(lane_max(red, green), fabs(PIECE_ROW(ROW_COLOR_CHANGE + 2)));
    at = select(at, emission_position_of_thick(q0, q1, a + w0 * change, a + w1 * change, units, depth, moment, colors,
                                               thick), thick);
  }
  const floatN w = w0 + at * (w1 - w0);
  const PiecePart part = {PIECE_ROW(ROW_COLOR) + w * PIECE_ROW(ROW_COLOR_CHANGE),
                          PIECE_ROW(ROW_COLOR + 1) + w * PIECE_ROW(ROW_COLOR_CHANGE + 1),
                          PIECE_ROW(ROW_COLOR + 2) + w * PIECE_ROW(ROW_COLOR_CHANGE + 2), depth
#if LIT_AT_ENDS
                          , at
#endif
  };
#undef PIECE_ROW
  return part;
}

/* Appends all pieces between `low` and `high` (neither of them) for the lanes in `rises`, and in the reverse order for
 * others: pieces go by upwards, and a lane whose value falls has each before, not behind, what it has. `per`: opacity
 * units per value. */
INLINE void append_one_by_one(SegmentColor *s, intN low, intN high, intN rises, floatN per, intN active, Pieces f
#if LIT_AT_ENDS
                              , floatN front, floatN inverse_span
#endif
)
{
  const floatN zero = 0.0f, one = 1.0f;
  SegmentColor m = {zero, zero, zero, zero, zero};
  low = select((intN)f.count, low, active);
  _Pragma("unroll 1") for (int p = 1; p < f.count - 1; ++p) {
    __global const float *row = f.rows + p;
#define UNIFORM_ROW(k) row[(k) * f.columns]
    if (!(UNIFORM_ROW(ROW_DEPTH) > 0.0f)) continue;
    const intN inside = MASK(low < p) & MASK(high > p);
    if (!any_lane(inside)) continue;
    const floatN depth = select(zero, UNIFORM_ROW(ROW_DEPTH) * (UNIFORM_ROW(ROW_LENGTH) * per), inside);
    const floatN moment = UNIFORM_ROW(ROW_MOMENT);
    floatN at = emission_position(depth, select(-moment, moment, rises));
    const intN thick = inside & is_thick(depth, moment);
    if (any_lane(thick)) {
      const floatN q0 = UNIFORM_ROW(ROW_CLEAR), q1 = lane_max(q0 + UNIFORM_ROW(ROW_CLEAR_CHANGE), zero);
      const floatN a0 = UNIFORM_ROW(ROW_OPACITY), a1 = a0 + UNIFORM_ROW(ROW_OPACITY_CHANGE);
      const float red = fabs(UNIFORM_ROW(ROW_COLOR_CHANGE)), green = fabs(UNIFORM_ROW(ROW_COLOR_CHANGE + 1));
      const floatN colors = fmax(fmax(red, green), fabs(UNIFORM_ROW(ROW_COLOR_CHANGE + 2)));
      at = select(at, emission_position_of_thick(select(q1, q0, rises), select(q0, q1, rises), select(a1, a0, rises),
                                                 select(a0, a1, rises), UNIFORM_ROW(ROW_LENGTH) * per, depth,
                                                 select(-moment, (floatN)moment, rises), colors, thick), thick);
    }
    const floatN w = select(1.0f - at, at, rises);
    const floatN opacity = opacity_of_stretch(depth);
    /* What is in front of what: m before the piece, or the piece before m. */
    const floatN share = select(opacity, opacity - m.a * opacity, rises);
    const floatN left = select(1.0f - opacity, (floatN)1.0f, rises);
    m.r = left * m.r + share * (UNIFORM_ROW(ROW_COLOR) + w * UNIFORM_ROW(ROW_COLOR_CHANGE));
    m.g = left * m.g + share * (UNIFORM_ROW(ROW_COLOR + 1) + w * UNIFORM_ROW(ROW_COLOR_CHANGE + 1));
    m.b = left * m.b + share * (UNIFORM_ROW(ROW_COLOR + 2) + w * UNIFORM_ROW(ROW_COLOR_CHANGE + 2));
    m.a = left * m.a + share, m.depth += depth;
#if LIT_AT_ENDS
    /* From the segment's front: pieces begin and end at values. */
    const floatN from = UNIFORM_ROW(ROW_BEGIN), piece_end = UNIFORM_ROW(ROW_END);
    m.place = left * m.place + share * lane_clamp(fabs(from + w * (piece_end - from) - front) * inverse_span, zero, one);
#endif
#undef UNIFORM_ROW
  }
  const floatN left = 1.0f - s->a;
  s->r += left * m.r, s->g += left * m.g, s->b += left * m.b, s->a += left * m.a;
  s->depth += m.depth;
#if LIT_AT_ENDS
  s->place += left * m.place;
#endif
}

/* Appends all pieces between `low` and `high` (neither of them) at once, in their mean colour, from sums over all
 * pieces before each: where there are many, each is thin. What is opaque all along ends the light, and is seen in the
 * colour of the end that it is entered by. */
INLINE void append_at_once(SegmentColor *s, intN low, intN high, intN rises, floatN per, intN active, Pieces f)
{
  const floatN zero = 0.0f, one = 1.0f;
  low = select((intN)-1, low, active), high = select((intN)0, high, active);
  const intN up = TO_INT(piece_row(f, ROW_NEXT_OPAQUE, low + 1));
  const intN down = TO_INT(piece_row(f, ROW_LAST_OPAQUE, max(high - 1, (intN)0)));
  const intN wall = select(down, up, rises), is_wall = active & select(MASK(down > low), MASK(up < high), rises);
  high = select(high, wall, is_wall & rises), low = select(low, wall, is_wall & ~rises);
#define SUM_OF(row) lane_max(piece_row(f, row, high) - piece_row(f, row, low + 1), zero)
  const floatN depths = SUM_OF(ROW_DEPTHS), scale = lane_reciprocal(lane_max(depths, (floatN)1e-30f));
  append_stretch(s, lane_min(SUM_OF(ROW_COLORS) * scale, one), lane_min(SUM_OF(ROW_COLORS + 1) * scale, one),
                 lane_min(SUM_OF(ROW_COLORS + 2) * scale, one), select(zero, depths * per, active));
#undef SUM_OF
  if (any_lane(is_wall)) {
    const intN piece = select((intN)0, wall, is_wall);
    const floatN w = select(one, zero, rises);
#define WALL_COLOR(c) piece_row(f, ROW_COLOR + c, piece) + w * piece_row(f, ROW_COLOR_CHANGE + c, piece)
    append_stretch(s, WALL_COLOR(0), WALL_COLOR(1), WALL_COLOR(2), select(zero, (floatN)OPAQUE_DEPTH, is_wall));
#undef WALL_COLOR
  }
}

#if INTEGRAL_TABLE
#define COLOR_BY_PIECES color_by_pieces
#else
#define COLOR_BY_PIECES color_of_segment
#endif

/* A segment along which the value runs from `front` to `back`, `units` opacity units long, of the lanes in `active`;
 * others' are undefined. One with an end that is not finite is transparent. */
LOOKED_UP SegmentColor COLOR_BY_PIECES(floatN front, floatN back, floatN units, intN active, Pieces f)
{
  const floatN zero = 0.0f, one = 1.0f;
  SegmentColor s = {zero, zero, zero, zero, zero};
#if VOXEL_HOLES
  const intN finite = finite_lanes(front) & finite_lanes(back);
  front = select(zero, front, finite), back = select(zero, back, finite), units = select(zero, units, finite);
  active &= finite;
#endif
  front -= f.origin, back -= f.origin;
  const intN in_front = piece_of(front, f);
  const floatN begin = piece_row(f, ROW_BEGIN, in_front), inverse = piece_row(f, ROW_INVERSE, in_front);
  const floatN w0 = lane_clamp((front - begin) * inverse, zero, one);
  floatN w1 = lane_clamp((back - begin) * inverse, zero, one);
  const intN crosses = active & (MASK(back < piece_row(f, ROW_FROM, in_front)) |
                                 MASK(back >= piece_row(f, ROW_TO, in_front)));
  const intN front_shows = active & MASK(piece_row(f, ROW_DEPTH, in_front) > 0.0f);
  if (!any_lane(crosses)) {
    if (!any_lane(front_shows)) return s; /* between peaks */
    const PiecePart part = part_of_piece(in_front, w0, w1, units, front_shows, f);
    s = first_stretch(part.r, part.g, part.b, part.depth);
    NOTE_PLACE(s, zero, part.at)
    return s;
  }
  /* Pieces in which nothing shows need not be looked at: most often one end of the segment is in such a piece, and
   * then the part at the other end is found in the same pass as those of rays that stay in one piece. */
  const intN behind = piece_of(back, f), rises = MASK(back > front);
  const intN back_shows = crosses & MASK(piece_row(f, ROW_DEPTH, behind) > 0.0f);
  const intN swaps = back_shows & ~front_shows, both = back_shows & front_shows;
  const floatN per = units * lane_reciprocal(lane_max(fabs(back - front), (floatN)1e-30f));
#if LIT_AT_ENDS
  const floatN inverse_span = lane_reciprocal(lane_max(fabs(back - front), (floatN)1e-30f));
#endif
  const floatN leaves_at = select(begin, piece_row(f, ROW_END, in_front), rises);
  const floatN behind_begin = piece_row(f, ROW_BEGIN, behind);
  const floatN enters_at = select(piece_row(f, ROW_END, behind), behind_begin, rises);
  const floatN front_units = select(units, fabs(leaves_at - front) * per, crosses);
  const floatN back_units = fabs(back - enters_at) * per;
  w1 = select(w1, select(zero, one, rises), crosses);
  const floatN last0 = select(one, zero, rises);
  const floatN last1 = lane_clamp((back - behind_begin) * piece_row(f, ROW_INVERSE, behind), zero, one);
  PiecePart last = {zero, zero, zero, zero};
  if (any_lane(front_shows | swaps)) {
    last = part_of_piece(select(in_front, behind, swaps), select(w0, last0, swaps), select(w1, last1, swaps),
                         select(front_units, back_units, swaps), front_shows | swaps, f);
    s = first_stretch(last.r, last.g, last.b, select(zero, last.depth, front_shows));
    NOTE_PLACE(s, zero, last.at * select(one, fabs(leaves_at - front) * inverse_span, crosses))
  }
  const intN low = select(behind, in_front, rises), high = select(in_front, behind, rises);
  const intN passes = crosses & MASK(high - low > 1);
  if (any_lane(passes)) {
#if LIT_AT_ENDS
    /* Of many pieces at once that each are thin: in the middle between the two that the ends are in. */
    const floatN before = s.a;
    if (f.in_registers) {
      append_one_by_one(&s, low, high, rises, per, passes, f, front, inverse_span);
    } else {
      append_at_once(&s, low, high, rises, per, passes, f);
      NOTE_PLACE(s, before, fabs(0.5f * (leaves_at + enters_at) - front) * inverse_span)
    }
#else
    if (f.in_registers)
      append_one_by_one(&s, low, high, rises, per, passes, f);
    else
      append_at_once(&s, low, high, rises, per, passes, f);
#endif
  }
  if (any_lane(back_shows)) {
    if (any_lane(both)) {
      const PiecePart more = part_of_piece(behind, last0, last1, back_units, both, f);
      last.r = select(last.r, more.r, both), last.g = select(last.g, more.g, both),
          last.b = select(last.b, more.b, both);
      last.depth = select(last.depth, more.depth, both);
#if LIT_AT_ENDS
      last.at = select(last.at, more.at, both);
#endif
    }
#if LIT_AT_ENDS
    const floatN before = s.a, enters = fabs(enters_at - front) * inverse_span;
#endif
    append_stretch(&s, last.r, last.g, last.b, select(zero, last.depth, back_shows));
    NOTE_PLACE(s, before, lane_clamp(enters + last.at * (1.0f - enters), zero, one))
  }
  return s;
}

#if INTEGRAL_TABLE

/* The same by differences of tabulated integral functions of INTEGRAL_TABLE entries, linear in between: of the extinction,
 * and of colour times extinction, whose attenuation inside the segment is left out (Engel, Kraus and Ertl 2001, section
 * 3.2). So a dense segment may emit more than white; its opacity is right. */
INLINE floatN integral_entry(Pieces f, int function, intN node)
{
  return AS_FLOAT(gather4(f.rows + PIECE_ROWS * f.columns + 2 + function, f.first + 4 * node));
}

LOOKED_UP SegmentColor color_of_segment(floatN front, floatN back, floatN units, intN active, Pieces f)
{
  if (f.in_memory) return color_by_pieces(front, back, units, active, f); /* of a further field: it has no table */
  const floatN zero = 0.0f, last = (floatN)(float)(INTEGRAL_TABLE - 1);
#if VOXEL_HOLES
  const intN finite = finite_lanes(front) & finite_lanes(back);
  front = select(zero, front, finite), back = select(zero, back, finite), units = select(zero, units, finite);
#endif
  __global const float *head = f.rows + PIECE_ROWS * f.columns;
  const floatN first = AS_FLOAT(gather4(head, f.first)) + f.origin, per_value = AS_FLOAT(gather4(head + 1, f.first));
  const floatN a = lane_clamp((lane_min(front, back) - first) * per_value, zero, last);
  const floatN b = lane_clamp((lane_max(front, back) - first) * per_value, zero, last), span = b - a;
  const intN low = min(TO_INT(a), (intN)(INTEGRAL_TABLE - 2)), high = min(TO_INT(b), (intN)(INTEGRAL_TABLE - 2));
  const intN one = MASK(low == high) | MASK(span <= 0.0f);
  const floatN inverse = 1.0f / select((floatN)1.0f, span, MASK(span > 0.0f));
  const floatN from = TO_FLOAT(low + 1) - a, to = b - TO_FLOAT(high);
  floatN mean[4];
  _Pragma("unroll 1") for (int k = 0; k < 4; ++k) {
    /* The rest of the first interval, whole ones, and the part of the last one: small differences stay exact. */
    const floatN low0 = integral_entry(f, k, low), low1 = integral_entry(f, k, low + 1);
    const floatN high0 = integral_entry(f, k, high), high1 = integral_entry(f, k, high + 1);
    const floatN sum = from * (low1 - low0) + (high0 - low1) + to * (high1 - high0);
    mean[k] = select(sum * inverse, low1 - low0, one) * per_value * units;
  }
  const floatN depth = lane_max(mean[0], zero);
  const SegmentColor s = {lane_max(mean[1], zero), lane_max(mean[2], zero), lane_max(mean[3], zero),
                          opacity_of_stretch(depth), depth};
  return s;
}

#endif

/* Extinction (per opacity unit) and colour of a value, not multiplied; transparent where it is not finite. */
INLINE void classify_value(floatN value, Pieces f, floatN *r, floatN *g, floatN *b, floatN *extinction)
{
#if VOXEL_HOLES
  const intN finite = finite_lanes(value);
  value = select((floatN)0.0f, value, finite);
#endif
  value -= f.origin;
  const intN piece = piece_of(value, f);
#define PIECE_ROW(row) piece_row(f, row, piece)
  const floatN w = lane_clamp((value - PIECE_ROW(ROW_BEGIN)) * PIECE_ROW(ROW_INVERSE), (floatN)0.0f, (floatN)1.0f);
  *r = PIECE_ROW(ROW_COLOR) + w * PIECE_ROW(ROW_COLOR_CHANGE), *g = PIECE_ROW(ROW_COLOR + 1) + w *
      PIECE_ROW(ROW_COLOR_CHANGE + 1);
  *b = PIECE_ROW(ROW_COLOR + 2) + w * PIECE_ROW(ROW_COLOR_CHANGE + 2);
  const floatN clear = lane_max(PIECE_ROW(ROW_CLEAR) + w * PIECE_ROW(ROW_CLEAR_CHANGE), (floatN)0.0f);
  *extinction = depth_of_clear(clear, PIECE_ROW(ROW_OPACITY) + w * PIECE_ROW(ROW_OPACITY_CHANGE));
#undef PIECE_ROW
#if VOXEL_HOLES
  *extinction = select((floatN)0.0f, *extinction, finite);
#endif
}

/* Opacity of a step through a value of opacity `a`, at most view->opacity_limit (clvol/transfer/step_opacity.py). */
INLINE floatN step_opacity(floatN a, __constant const View *view)
{
  if (view->step_units == 1.0f) return a;
  const float4 low = view->opacity_terms, high = view->opacity_more;
  floatN p = high.w;
  p = p * a + high.z, p = p * a + high.y, p = p * a + high.x;
  p = p * a + low.w, p = p * a + low.z, p = p * a + low.y, p = p * a + low.x;
  return p * a;
}

/* Of 1 .. 8 steps, from that of one: 1 - (1 - o)^n, without losing the digits of a small o. */
INLINE floatN opacity_of_steps(floatN one, intN steps)
{
  const floatN two = one * (2.0f - one), four = two * (2.0f - two), eight = four * (2.0f - four);
  floatN sum = select((floatN)0.0f, one, MASK((steps & 1) != 0));
  sum = select(sum, sum + (two - two * sum), MASK((steps & 2) != 0));
  sum = select(sum, sum + (four - four * sum), MASK((steps & 4) != 0));
  return select(sum, eight, MASK((steps & 8) != 0));
}

/* Colour, not multiplied, and opacity of a value over `steps` (1 .. 8) whole steps; of lanes in `active`. Without
 * logarithm and exponential where opacities are not large. */
INLINE void color_of_steps(floatN value, intN steps, int one_step, intN active, Pieces f, __constant const View *view,
                           floatN *r, floatN *g, floatN *b, floatN *opacity)
{
#if VOXEL_HOLES
  const intN finite = finite_lanes(value);
  value = select((floatN)0.0f, value, finite);
#endif
  value -= f.origin;
  const intN piece = piece_of(value, f);
#define PIECE_ROW(row) piece_row(f, row, piece)
  const floatN w = lane_clamp((value - PIECE_ROW(ROW_BEGIN)) * PIECE_ROW(ROW_INVERSE), (floatN)0.0f, (floatN)1.0f);
  *r = PIECE_ROW(ROW_COLOR) + w * PIECE_ROW(ROW_COLOR_CHANGE), *g = PIECE_ROW(ROW_COLOR + 1) + w *
      PIECE_ROW(ROW_COLOR_CHANGE + 1);
  *b = PIECE_ROW(ROW_COLOR + 2) + w * PIECE_ROW(ROW_COLOR_CHANGE + 2);
  const floatN stated = PIECE_ROW(ROW_OPACITY) + w * PIECE_ROW(ROW_OPACITY_CHANGE);
  floatN found = step_opacity(stated, view);
  if (!one_step) found = opacity_of_steps(found, steps);
  const intN dense = active & MASK(stated > view->opacity_limit);
  if (any_lane(dense)) {
    const floatN clear = lane_max(PIECE_ROW(ROW_CLEAR) + w * PIECE_ROW(ROW_CLEAR_CHANGE), (floatN)0.0f);
    const floatN units = one_step ? (floatN)view->step_units : view->step_units * TO_FLOAT(steps);
    found = select(found, opacity_of_depth(depth_of_clear(clear, stated) * units), dense);
  }
#undef PIECE_ROW
#if VOXEL_HOLES
  found = select((floatN)0.0f, found, finite);
#endif
  *opacity = found;
}

/* A segment of one value. */
LOOKED_UP SegmentColor color_of_value(floatN value, floatN units, Pieces f)
{
  floatN r, g, b, extinction;
  classify_value(value, f, &r, &g, &b, &extinction);
  return first_stretch(r, g, b, extinction * units);
}

/* The scene's function's length of a step in opacity units. */
INLINE floatN units_of_step(Pieces f, __constant const View *view)
{
#if TRANSFER_LAYERS
  return piece_row(f, ROW_UNITS, (intN)0);
#else
  return (floatN)view->step_units;
#endif
}

#endif
