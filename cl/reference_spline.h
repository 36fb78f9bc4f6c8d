/* The field along a ray inside one cell under the cubic filter, as a polynomial of degree 9.
 *
 * The voxels are the coefficients of a uniform tricubic B-spline with its knots at the voxel centres
 * (no prefilter: the field smooths, and stays between the voxels' values); beyond the volume the
 * nearest voxel counts. In a cell 4^3 coefficients are used. The polar form (blossom) of the spline
 * at the ends of a segment gives the Bernstein coefficients P_ijk of its box, and the segment is
 * that box's diagonal: coefficient m of the field along it is the mean of the P_ijk with i + j + k = m,
 * weighted by binomials (3 i)(3 j)(3 k) / (9 m). (Ramshaw 1989.) Only
 * interpolations between neighbours occur, so a constant field stays exactly constant.
 *
 * Everything else is done on Bernstein coefficients too: at degree 9 powers would cost digits.
 */
#ifndef REFERENCE_SPLINE_H
#define REFERENCE_SPLINE_H

#include "reference_volume.h"

#define REFERENCE_TAPS 64  /* voxels that a cell uses */
#define REFERENCE_DEGREE 9 /* of the field along a ray in a cell */
#define REFERENCE_ENDS 20  /* the most that reference_monotone_ends writes */
#define REFERENCE_ROUNDING 4e-15 /* of the field's value, relative to its largest coefficient */
#define REFERENCE_LEAST_PART 1e-12 /* of a cell: turning points nearer to each other are one */

__constant double reference_binomial_8[9] = {1, 8, 28, 56, 70, 56, 28, 8, 1};
__constant double reference_binomial_9[10] = {1, 9, 36, 84, 126, 126, 84, 36, 9, 1};

/* The coefficients of cell `index`, x fastest. A segment that lies in one face of the cell (low =
 * high = 0 or 1 on an axis) gives those farthest from it no weight: their neighbours take their
 * place, so that what they hold (NaN, say) does not matter. */
static inline void reference_fetch_taps(const ReferenceVolume *volume, const int index[3],
                                        const double low[3], const double high[3],
                                        double tap[REFERENCE_TAPS])
{
    int place[3][4];
    for (int a = 0; a < 3; ++a) {
        for (int i = 0; i < 4; ++i)
            place[a][i] = clamp(index[a] + i - 1, 0, volume->size[a] - 1);
        if (low[a] == 0.0 && high[a] == 0.0)
            place[a][3] = place[a][2];
        if (low[a] == 1.0 && high[a] == 1.0)
            place[a][0] = place[a][1];
    }
    for (int k = 0; k < 4; ++k)
        for (int j = 0; j < 4; ++j)
            for (int i = 0; i < 4; ++i)
                tap[16 * k + 4 * j + i] =
                    reference_fetch(volume, place[0][i], place[1][j], place[2][k]);
}

/* Replaces the four spline coefficients c[0], c[stride], ... of a cell by the Bernstein coefficients
 * of the piece from u = low to u = high: the polar form at (low, low, low), (low, low, high),
 * (low, high, high) and (high, high, high). */
static inline void reference_spline_piece(double *c, int stride, double low, double high)
{
    double c0 = c[0], d0 = c[stride] - c0;
    double c1 = c[stride], d1 = c[2 * stride] - c1;
    double c2 = c[2 * stride], d2 = c[3 * stride] - c2;
    double low0 = c0 + (low + 2.0) / 3.0 * d0, high0 = c0 + (high + 2.0) / 3.0 * d0;
    double low1 = c1 + (low + 1.0) / 3.0 * d1, high1 = c1 + (high + 1.0) / 3.0 * d1;
    double low2 = c2 + low / 3.0 * d2, high2 = c2 + high / 3.0 * d2;
    double ll0 = low0 + (low + 1.0) / 2.0 * (low1 - low0), ll1 = low1 + low / 2.0 * (low2 - low1);
    double lh0 = low0 + (high + 1.0) / 2.0 * (low1 - low0), lh1 = low1 + high / 2.0 * (low2 - low1);
    double hh0 = high0 + (high + 1.0) / 2.0 * (high1 - high0);
    double hh1 = high1 + high / 2.0 * (high2 - high1);
    c[0] = ll0 + low * (ll1 - ll0);
    c[stride] = ll0 + high * (ll1 - ll0);
    c[2 * stride] = lh0 + high * (lh1 - lh0);
    c[3 * stride] = hh0 + high * (hh1 - hh0);
}

/* Restricts the spline of 64 coefficients to the segment low -> high. */
static inline void reference_blossom(const double tap[REFERENCE_TAPS], const double low[3],
                                     const double high[3], double bernstein[REFERENCE_DEGREE + 1])
{
    double box[REFERENCE_TAPS];
    for (int i = 0; i < REFERENCE_TAPS; ++i)
        box[i] = tap[i];
    for (int i = 0; i < 16; ++i)
        reference_spline_piece(box + i, 16, low[2], high[2]);
    for (int k = 0; k < 4; ++k)
        for (int i = 0; i < 4; ++i)
            reference_spline_piece(box + 16 * k + i, 4, low[1], high[1]);
    for (int i = 0; i < 16; ++i)
        reference_spline_piece(box + 4 * i, 1, low[0], high[0]);

    const double binomial_3[4] = {1.0, 3.0, 3.0, 1.0};
    double first[REFERENCE_DEGREE + 1], sum[REFERENCE_DEGREE + 1];
    for (int m = 0; m <= REFERENCE_DEGREE; ++m) {
        /* One P_ijk with i + j + k = m; the mean counts from there. */
        int i = min(m, 3), j = min(m - i, 3), k = m - i - j;
        first[m] = box[16 * k + 4 * j + i];
        sum[m] = 0.0;
    }
    for (int k = 0; k < 4; ++k)
        for (int j = 0; j < 4; ++j)
            for (int i = 0; i < 4; ++i)
                sum[i + j + k] += binomial_3[i] * binomial_3[j] * binomial_3[k]
                    * (box[16 * k + 4 * j + i] - first[i + j + k]);
    for (int m = 0; m <= REFERENCE_DEGREE; ++m)
        bernstein[m] = first[m] + sum[m] / reference_binomial_9[m];
}

/* Bernstein coefficients of the part [from, to], to > 0, in place (de Casteljau, twice). */
static inline void reference_restrict_in_place(double *b, int degree, double from, double to)
{
    for (int r = 1; r <= degree; ++r)
        for (int i = degree; i >= r; --i)
            b[i] = b[i - 1] + to * (b[i] - b[i - 1]);
    double left = from / to;
    for (int r = 1; r <= degree; ++r)
        for (int i = 0; i <= degree - r; ++i)
            b[i] = b[i] + left * (b[i + 1] - b[i]);
}

static inline void reference_restrict(const double whole[REFERENCE_DEGREE + 1], double from,
                                      double to, double part[REFERENCE_DEGREE + 1])
{
    for (int i = 0; i <= REFERENCE_DEGREE; ++i)
        part[i] = whole[i];
    reference_restrict_in_place(part, REFERENCE_DEGREE, from, to);
}

/* sum of c[i] w^i (1 - w)^(degree - i): Bernstein coefficients that have their binomials in them. */
static inline double reference_bernstein(const double *c, int degree, double w)
{
    double rest = 1.0 - w, power = w, sum = c[0] * rest;
    for (int i = 1; i < degree; ++i) {
        sum = (sum + power * c[i]) * rest;
        power *= w;
    }
    return sum + power * c[degree];
}

typedef struct {
    double bernstein[REFERENCE_DEGREE + 1];
    double change[REFERENCE_DEGREE + 1]; /* from bernstein[0], with binomials */
    double slope[REFERENCE_DEGREE];      /* with binomials */
} ReferenceCurve;

static inline void reference_prepare(ReferenceCurve *f)
{
    const double *b = f->bernstein;
    for (int i = 0; i <= REFERENCE_DEGREE; ++i)
        f->change[i] = reference_binomial_9[i] * (b[i] - b[0]);
    for (int i = 0; i < REFERENCE_DEGREE; ++i)
        f->slope[i] = 9.0 * reference_binomial_8[i] * (b[i + 1] - b[i]);
}

static inline double reference_curve(const ReferenceCurve *f, double w)
{
    return f->bernstein[0] + reference_bernstein(f->change, REFERENCE_DEGREE, w);
}

static inline double reference_curve_slope(const ReferenceCurve *f, double w)
{
    return reference_bernstein(f->slope, REFERENCE_DEGREE - 1, w);
}

/* The mean from 0 to w: its coefficients are the means of the first, the first two, ... ones. Here as everywhere
 * from b[0] on, so that a constant keeps its value. */
static inline double reference_mean_before(const ReferenceCurve *f, double w)
{
    double c[REFERENCE_DEGREE + 1], sum = 0.0;
    for (int i = 0; i <= REFERENCE_DEGREE; ++i) {
        sum += f->bernstein[i] - f->bernstein[0];
        c[i] = reference_binomial_9[i] * (sum / (i + 1.0));
    }
    return f->bernstein[0] + reference_bernstein(c, REFERENCE_DEGREE, w);
}

/* The mean over the whole range. */
static inline double reference_mean(const double b[REFERENCE_DEGREE + 1])
{
    double sum = 0.0;
    for (int i = 1; i <= REFERENCE_DEGREE; ++i)
        sum += b[i] - b[0];
    return b[0] + sum / (REFERENCE_DEGREE + 1.0);
}

/* How often the coefficients change sign; their first and last sign, 0 if all are 0. */
static inline int reference_sign_changes(const double *c, int count, int *first, int *last)
{
    int changes = 0;
    *first = *last = 0;
    for (int i = 0; i < count; ++i) {
        int sign = (c[i] > 0.0) - (c[i] < 0.0);
        if (sign != 0) {
            changes += *last != 0 && sign != *last;
            *first = *first == 0 ? sign : *first;
            *last = sign;
        }
    }
    return changes;
}

static inline void reference_add_end(double ends[REFERENCE_ENDS], int *count, double w)
{
    if (w > ends[*count - 1] && w < 1.0 && *count < REFERENCE_ENDS - 1)
        ends[(*count)++] = w;
}

/* Writes 0, the turning points inside (0, 1) in order, and 1; returns how many. Between two
 * neighbours the curve is monotone.
 *
 * The slope has at most as many zeros in a part of the range as its Bernstein coefficients there have
 * changes of sign (variation diminishing): none, nothing to do; one, bisection finds it; more,
 * the part is halved. What is left at the smallest parts, and what lies below rounding, changes the
 * value by less than rounding: an end too many, or one that is a little off, does no harm. */
static inline int reference_monotone_ends(const ReferenceCurve *f, double ends[REFERENCE_ENDS])
{
    const double *b = f->bernstein;
    double difference[REFERENCE_DEGREE], largest = 0.0, far_end[48];
    for (int i = 0; i <= REFERENCE_DEGREE; ++i)
        largest = fmax(largest, fabs(b[i]));
    for (int i = 0; i < REFERENCE_DEGREE; ++i)
        difference[i] = b[i + 1] - b[i];
    int count = 1, top = 0, sign = 0;
    double from = 0.0;
    ends[0] = 0.0;
    far_end[0] = 1.0;
    while (top >= 0) {
        double to = far_end[top], part[REFERENCE_DEGREE], size = 0.0;
        for (int i = 0; i < REFERENCE_DEGREE; ++i)
            part[i] = difference[i];
        if (from > 0.0 || to < 1.0)
            reference_restrict_in_place(part, REFERENCE_DEGREE - 1, from, to);
        for (int i = 0; i < REFERENCE_DEGREE; ++i)
            size = fmax(size, fabs(part[i]));
        if (size * (to - from) > 0.1 * DBL_EPSILON * largest) {
            int first, last;
            int changes = reference_sign_changes(part, REFERENCE_DEGREE, &first, &last);
            if (changes > 1 && to - from > REFERENCE_LEAST_PART) {
                far_end[++top] = 0.5 * (from + to);
                continue;
            }
            if (sign != 0 && first != sign) /* a zero where two parts meet */
                reference_add_end(ends, &count, from);
            if (changes > 1)
                reference_add_end(ends, &count, 0.5 * (from + to));
            if (changes == 1) {
                double low = 0.0, high = 1.0;
                for (int i = 0; i < REFERENCE_DEGREE; ++i)
                    part[i] *= reference_binomial_8[i];
                while (high - low > 1e-10) {
                    double middle = 0.5 * (low + high);
                    if (reference_bernstein(part, REFERENCE_DEGREE - 1, middle) * first > 0.0)
                        low = middle;
                    else
                        high = middle;
                }
                reference_add_end(ends, &count, from + 0.5 * (low + high) * (to - from));
            }
            sign = last;
        }
        from = to;
        --top;
    }
    ends[count++] = 1.0;
    return count;
}

#endif
