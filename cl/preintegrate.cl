/* Tables of classified ray segments.
 *
 * P4 sec. 8 (Engel, Ertl): the value runs linearly from s_f to s_b along a segment of length d,
 *   a = 1 - exp(-int tau),   C = int c tau exp(-int tau),   tau = -log(1 - alpha) / opacity_unit.
 * The transfer function is piecewise linear in alpha and c, so a segment is a few pieces. In a piece, with x from 0 to 1:
 *   T(x) = int_0^x tau is elementary, since int -log q dq is;
 *   C = c_b A(1) - (c_b - c_a) int_0^1 A(x) dx,  A = 1 - exp(-T)   (by parts: c is linear),
 * which leaves one smooth bounded integral a piece for all channels, with no singularity where alpha reaches 1. It is done by
 * Gauss-Legendre rules of 8 points; where T(1) is large, on intervals halved towards the front, where all happens.
 * Unlike the paper, attenuation inside the segment is not neglected, and nothing is sampled uniformly.
 *
 * Where the device has doubles (WITH_DOUBLE) entries are right to the last bit of their floats; else to about 1e-6.
 */
#if WITH_DOUBLE
#pragma OPENCL EXTENSION cl_khr_fp64 : enable
typedef double real;
#else
typedef float real;
#endif

__constant real gauss_node[8] = {0.0198550717512319, 0.1016667612931866, 0.2372337950418355, 0.4082826787521751,
                                 0.5917173212478249, 0.7627662049581645, 0.8983332387068134, 0.9801449282487681};
__constant real gauss_weight[8] = {0.0506142681451881, 0.1111905172266872, 0.1568533229389437, 0.1813418916891810,
                                   0.1813418916891810, 0.1568533229389437, 0.1111905172266872, 0.0506142681451881};

/* Mean of -log(1 - alpha) while alpha runs linearly from a to b: 0 .. infinity (only if both are 1). qa, qb: 1 - a, 1 - b. */
inline real mean_depth(real a, real b, real qa, real qb)
{
  const real sum = qa + qb, difference = qa - qb;
  if (sum <= 0) return INFINITY;
  if (fabs(difference) > (real)0.1 * sum) {
    const real la = qa > 0 ? qa * log(qa) : 0, lb = qb > 0 ? qb * log(qb) : 0;
    return 1 - (la - lb) / difference;
  }
  const real r2 = (difference / sum) * (difference / sum);
  return -log1p((real)-0.5 * (a + b)) + r2 * ((real)(1.0 / 6) + r2 * ((real)(1.0 / 20) + r2 * (real)(1.0 / 42)));
}

typedef struct {
  real a, qa, da; /* opacity, 1 - opacity at the front; change of opacity to the back */
  real units;     /* length in opacity units */
} Piece;

inline real piece_depth(Piece p, real x)
{
  return p.units * x * mean_depth(p.a, p.a + x * p.da, p.qa, p.qa - x * p.da);
}

/* The two-point rule, for pieces that are thin and change little: its error is of order depth^5 and change^4. */
inline real mean_opacity_of_thin(Piece p)
{
  return (real)-0.5 * (expm1(-piece_depth(p, (real)0.2113248654051871)) + expm1(-piece_depth(p, (real)0.7886751345948129)));
}

inline real mean_opacity_over(Piece p, real from, real to)
{
  real sum = 0;
  for (int k = 0; k < 8; ++k)
    sum -= gauss_weight[k] * expm1(-piece_depth(p, from + (to - from) * gauss_node[k]));
  return (to - from) * sum;
}

/* Where opacity comes near 1 at an end of the piece, T has a logarithm there: x = S(u), a step whose derivatives
 * vanish at both ends, smooths it away. */
inline real mean_opacity_near_opaque(Piece p, real from, real to)
{
  real sum = 0;
  for (int half_ = 0; half_ < 2; ++half_)
    for (int k = 0; k < 8; ++k) {
      const real u = (real)0.5 * (half_ + gauss_node[k]);
      const real x = u * u * u * (10 - u * (15 - 6 * u)), slope = 30 * u * u * (1 - u) * (1 - u);
      sum -= (real)0.5 * gauss_weight[k] * slope * expm1(-piece_depth(p, from + (to - from) * x));
    }
  return (to - from) * sum;
}

inline real mean_opacity_of_part(Piece p, real from, real to)
{
  const real q0 = p.qa - from * p.da, q1 = p.qa - to * p.da;
  return fmin(q0, q1) < (real)0.1 * fmax(q0, q1) ? mean_opacity_near_opaque(p, from, to)
                                                 : mean_opacity_over(p, from, to);
}

/* int_0^1 A(x) dx, where T(1) = depth. */
inline real mean_opacity(Piece p, real depth)
{
  if (depth <= (real)0.02 && fabs(p.da) <= (real)0.02 * p.qa) return mean_opacity_of_thin(p);
  if (depth <= 2) return mean_opacity_of_part(p, 0, 1);
  real sum = 0, to = 1;
  for (int halvings = 0; halvings < 200; ++halvings) {
    const real from = to / 2, at_from = piece_depth(p, from);
    if (at_from > 40)
      sum += to - from; /* opaque all along */
    else
      sum += mean_opacity_of_part(p, from, to);
    to = from;
    if (at_from <= 1) break;
  }
  return sum + mean_opacity_of_part(p, 0, to);
}

typedef struct {
  real opacity;
  real color[3]; /* premultiplied */
  real depth;    /* -log(1 - opacity), which the opacity forgets where it rounds to 1 */
} Segment;

/* Transfer function at a value inside piece k: (opacity, 1 - opacity), colour. */
typedef struct {
  real opacity, clear;
  real color[3];
} Point;

/* Control point k as reals: value, opacity, 1 - opacity, red, green, blue. */
#define CONTROL_SIZE 6

inline Point control_point(__global const real *control, int k)
{
  Point p;
  __global const real *c = control + k * CONTROL_SIZE;
  p.opacity = c[1], p.clear = c[2];
  for (int i = 0; i < 3; ++i) p.color[i] = c[3 + i];
  return p;
}

inline Point point_inside(__global const real *control, int k, real value)
{
  __global const real *c = control + k * CONTROL_SIZE, *n = c + CONTROL_SIZE;
  const real w = n[0] > c[0] ? clamp((value - c[0]) / (n[0] - c[0]), (real)0, (real)1) : 0;
  Point p;
  p.opacity = c[1] + w * (n[1] - c[1]), p.clear = c[2] + w * (n[2] - c[2]);
  for (int i = 0; i < 3; ++i) p.color[i] = c[3 + i] + w * (n[3 + i] - c[3 + i]);
  return p;
}

/* Appends, behind what `s` holds, a piece of `units` opacity units with opacity and colour linear from a to b. */
inline void append_piece(Segment *s, Point a, Point b, real units)
{
  const real through = 1 - s->opacity;
  if (!(units > 0) || (a.opacity <= 0 && b.opacity <= 0)) return;
  const Piece p = {a.opacity, a.clear, b.opacity - a.opacity, units};
  const real depth = units * mean_depth(a.opacity, b.opacity, a.clear, b.clear);
  s->depth += depth;
  if (through <= 0) return;
  if (isinf(depth)) { /* opaque at once */
    for (int i = 0; i < 3; ++i) s->color[i] += through * a.color[i];
    s->opacity = 1;
    return;
  }
  const real opacity = -expm1(-depth);
  const real mean = a.opacity == b.opacity && depth > (real)1e-3 ? 1 - opacity / depth : mean_opacity(p, depth);
  for (int i = 0; i < 3; ++i) s->color[i] += through * (b.color[i] * opacity - (b.color[i] - a.color[i]) * mean);
  s->opacity += through * opacity;
}

/* The segment along which the value runs from s_f to s_b; kf, kb: the pieces that hold them (value of point k <= s). */
inline Segment integrate_segment(__global const real *control, real s_f, real s_b, int kf, int kb, real units)
{
  Segment s = {0, {0, 0, 0}, 0};
  const real low = fmin(s_f, s_b), high = fmax(s_f, s_b), span = high - low;
  if (!(span > 0)) {
    const Point p = point_inside(control, kf, s_f);
    append_piece(&s, p, p, units);
    return s;
  }
  const int up = s_b > s_f;
  for (int k = kf; up ? k <= kb : k >= kb; k += up ? 1 : -1) {
    const real from = fmax(control[k * CONTROL_SIZE], low), to = fmin(control[(k + 1) * CONTROL_SIZE], high);
    if (!(to > from)) continue; /* a step, or a piece that is only touched */
    const Point a = point_inside(control, k, from), b = point_inside(control, k, to);
    append_piece(&s, up ? a : b, up ? b : a, units * ((to - from) / span));
  }
  return s;
}

/* An opaque segment's optical depth: zero times it is zero, and any share of it that counts is opaque. */
#define OPAQUE_DEPTH 1e15f

/* What a shorter piece is made from: (mean colour, optical depth) instead of (premultiplied colour, opacity). A transparent
 * segment has a colour too, that at its front: look-ups between it and its neighbours would be darkened by black. */
inline float4 color_and_depth(Segment s, Point front)
{
  if (!(s.opacity > 0)) return (float4)((float)front.color[0], (float)front.color[1], (float)front.color[2], 0.0f);
  const float depth = fmin((float)s.depth, OPAQUE_DEPTH);
  return (float4)((float)(s.color[0] / s.opacity), (float)(s.color[1] / s.opacity), (float)(s.color[2] / s.opacity), depth);
}

inline float4 premultiplied(Segment s)
{
  return (float4)((float)s.color[0], (float)s.color[1], (float)s.color[2], (float)s.opacity);
}

/* control  [points, 6]: value ascending, opacity, 1 - opacity, linear red, green, blue; the first and last points lie below and
 *          above every node
 * nodes    [n] values of the class nodes, ascending
 * pieces   [n] for each node the last control point whose value is <= the node's
 * units    [slices] length of a segment in opacity units
 * table    float4 [slices, n + 2, n + 2]: row = value at the front, column = at the back; slice 0 premultiplied, the others
 *          color_and_depth(). The last two rows and columns are transparent: what is not a number looks up there.
 */
__kernel void preintegrate_table(__global const real *restrict control, __global const real *restrict nodes,
                                 __global const int *restrict pieces, __global const real *restrict units, int n,
                                 __global float4 *restrict table)
{
  const int back = get_global_id(0), front = get_global_id(1), slice = get_global_id(2);
  float4 rgba = 0.0f;
  if (front < n && back < n) {
    const Segment s = integrate_segment(control, nodes[front], nodes[back], pieces[front], pieces[back], units[slice]);
    rgba = slice == 0 ? premultiplied(s) : color_and_depth(s, point_inside(control, pieces[front], nodes[front]));
  }
  table[((size_t)slice * (n + 2) + front) * (n + 2) + back] = rgba;
}

/* For evenly spaced nodes a table takes two steps instead of one pass over all control points for each entry: a segment over
 * k cells between nodes gives each of them 1 / k of its length, whatever the rest of the segment is.
 *
 * cells  real [slices, n - 1, n - 1, 8]: (span k - 1, cell) -> premultiplied colour of the cell crossed upwards, its opacity;
 *        the same downwards, its optical depth
 */
__kernel void cell_segments(__global const real *restrict control, __global const real *restrict nodes,
                            __global const int *restrict pieces, __global const real *restrict units, int n,
                            __global real *restrict cells)
{
  const int cell = get_global_id(0), span = get_global_id(1) + 1, slice = get_global_id(2);
  const real length = units[slice] / span;
  __global real *out = cells + 8 * (((size_t)slice * (n - 1) + (span - 1)) * (n - 1) + cell);
  const Segment up = integrate_segment(control, nodes[cell], nodes[cell + 1], pieces[cell], pieces[cell + 1], length);
  const Segment down = integrate_segment(control, nodes[cell + 1], nodes[cell], pieces[cell + 1], pieces[cell], length);
  for (int i = 0; i < 3; ++i) out[i] = up.color[i], out[4 + i] = down.color[i];
  out[3] = up.opacity, out[7] = up.depth;
}

/* As preintegrate_table, from cell_segments. The first block of cells serves slices 0
 * and 1, which have the same length. */
__kernel void compose_table(__global const real *restrict control, __global const real *restrict nodes,
                            __global const int *restrict pieces, __global const real *restrict units, int n,
                            __global const real *restrict cells, __global float4 *restrict table)
{
  const int back = get_global_id(0), front = get_global_id(1), slice = get_global_id(2);
  float4 rgba = 0.0f;
  if (front < n && back < n) {
    Segment s = {0, {0, 0, 0}, 0};
    if (front == back) {
      s = integrate_segment(control, nodes[front], nodes[front], pieces[front], pieces[front], units[slice]);
    } else {
      const int up = back > front, span = up ? back - front : front - back;
      const int block = slice > 0 ? slice - 1 : 0;
      __global const real *row = cells + 8 * (((size_t)block * (n - 1) + (span - 1)) * (n - 1));
      for (int k = 0; k < span; ++k) {
        __global const real *c = row + 8 * (up ? front + k : front - 1 - k);
        const real through = 1 - s.opacity;
        for (int i = 0; i < 3; ++i) s.color[i] += through * c[(up ? 0 : 4) + i];
        s.opacity += through * c[3];
        s.depth += c[7];
      }
    }
    rgba = slice == 0 ? premultiplied(s) : color_and_depth(s, point_inside(control, pieces[front], nodes[front]));
  }
  table[((size_t)slice * (n + 2) + front) * (n + 2) + back] = rgba;
}

/* table  float4 [slices, n + 2]: a segment of constant value; slice 0 premultiplied, the others color_and_depth() */
__kernel void classify_table(__global const real *restrict control, __global const real *restrict nodes,
                             __global const int *restrict pieces, __global const real *restrict units, int n,
                             __global float4 *restrict table)
{
  const int node = get_global_id(0), slice = get_global_id(1);
  float4 rgba = 0.0f;
  if (node < n) {
    const Segment s = integrate_segment(control, nodes[node], nodes[node], pieces[node], pieces[node], units[slice]);
    rgba = slice == 0 ? premultiplied(s) : color_and_depth(s, point_inside(control, pieces[node], nodes[node]));
  }
  table[slice * (n + 2) + node] = rgba;
}

/* table  float4 [n + 2]: emission and extinction of a constant value over one step: (c tau h, tau h) */
__kernel void extinction_table(__global const real *restrict control, __global const real *restrict nodes,
                               __global const int *restrict pieces, __global const real *restrict units, int n,
                               __global float4 *restrict table)
{
  const int node = get_global_id(0);
  float4 e = 0.0f;
  if (node < n) {
    const Point p = point_inside(control, pieces[node], nodes[node]);
    const float depth = fmin((float)(units[0] * mean_depth(p.opacity, p.opacity, p.clear, p.clear)), OPAQUE_DEPTH);
    e = (float4)((float)p.color[0] * depth, (float)p.color[1] * depth, (float)p.color[2] * depth, depth);
  }
  table[node] = e;
}
