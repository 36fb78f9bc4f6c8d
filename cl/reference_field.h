/* Under the linear filter the field along a ray inside one cell: a cubic in Bernstein form. (Under the cubic filter
 * reference_spline.h gives the same functions.)
 *
 * The trilinear field on the box spanned by the two ends of a segment has eight corner values
 * P_ijk; the segment is that box's diagonal, along which the field is the cubic with Bernstein
 * coefficients P000, (P100 + P010 + P001)/3, (P110 + P101 + P011)/3, P111 (the blossom of the
 * trilinear form). Only linear interpolations occur, so a constant field stays exactly constant.
 */
#ifndef REFERENCE_FIELD_H
#define REFERENCE_FIELD_H

#include "reference_volume.h"

#ifndef REFERENCE_CUBIC

#define REFERENCE_TAPS 8   /* voxels that a cell uses */
#define REFERENCE_DEGREE 3 /* of the field along a ray in a cell */
#define REFERENCE_ENDS 4   /* the most that reference_monotone_ends writes */
#define REFERENCE_ROUNDING 1e-15 /* of the field's value, relative to its largest coefficient */

/* Corner values of cell `index`; corner bits are x = 1, y = 2, z = 4. A segment that lies in one
 * face of the cell (low = high = 0 or 1 on an axis) does not use the corners off that face: they
 * are replaced by those on it, so that what they hold (NaN, say) does not matter. */
static inline void reference_fetch_taps(const ReferenceVolume *volume, const int index[3],
                                        const double low[3], const double high[3],
                                        double corner[REFERENCE_TAPS])
{
    int place[3][2];
    for (int a = 0; a < 3; ++a) {
        int first = index[a];
        int second = min(first + 1, volume->size[a] - 1);
        if (low[a] == 0.0 && high[a] == 0.0)
            second = first;
        if (low[a] == 1.0 && high[a] == 1.0)
            first = second;
        place[a][0] = first;
        place[a][1] = second;
    }
    for (int i = 0; i < REFERENCE_TAPS; ++i)
        corner[i] = reference_fetch(volume, place[0][i & 1], place[1][(i >> 1) & 1],
                                    place[2][i >> 2]);
}

/* Restricts the trilinear field of eight corners to the segment low -> high. */
static inline void reference_blossom(const double corner[8], const double low[3],
                                     const double high[3], double bernstein[4])
{
    double x[8], y[8], p[8];
    for (int i = 0; i < 4; ++i) {
        x[2 * i] = reference_mix(corner[2 * i], corner[2 * i + 1], low[0]);
        x[2 * i + 1] = reference_mix(corner[2 * i], corner[2 * i + 1], high[0]);
    }
    for (int k = 0; k < 2; ++k)
        for (int i = 0; i < 2; ++i) {
            y[4 * k + i] = reference_mix(x[4 * k + i], x[4 * k + 2 + i], low[1]);
            y[4 * k + 2 + i] = reference_mix(x[4 * k + i], x[4 * k + 2 + i], high[1]);
        }
    for (int i = 0; i < 4; ++i) {
        p[i] = reference_mix(y[i], y[4 + i], low[2]);
        p[4 + i] = reference_mix(y[i], y[4 + i], high[2]);
    }
    bernstein[0] = p[0];
    bernstein[1] = p[1] + ((p[2] - p[1]) + (p[4] - p[1])) / 3.0;
    bernstein[2] = p[3] + ((p[5] - p[3]) + (p[6] - p[3])) / 3.0;
    bernstein[3] = p[7];
}

/* The cubic restricted to [from, to] of its range, in Bernstein form again (de Casteljau). */
static inline void reference_restrict(const double whole[4], double from, double to,
                                      double part[4])
{
    double low[3] = {from, from, from}, high[3] = {to, to, to};
    double corner[8] = {whole[0], whole[1], whole[1], whole[2],
                        whole[1], whole[2], whole[2], whole[3]};
    reference_blossom(corner, low, high, part);
}

typedef struct {
    double bernstein[4];
    double power[4];
} ReferenceCurve;

/* The power form, which is what gets evaluated. */
static inline void reference_prepare(ReferenceCurve *f)
{
    double d0 = f->bernstein[1] - f->bernstein[0];
    double d1 = f->bernstein[2] - f->bernstein[1];
    double d2 = f->bernstein[3] - f->bernstein[2];
    f->power[0] = f->bernstein[0];
    f->power[1] = 3.0 * d0;
    f->power[2] = 3.0 * (d1 - d0);
    f->power[3] = (d2 - d1) - (d1 - d0);
}

static inline double reference_curve(const ReferenceCurve *f, double w)
{
    return f->power[0] + w * (f->power[1] + w * (f->power[2] + w * f->power[3]));
}

static inline double reference_curve_slope(const ReferenceCurve *f, double w)
{
    return f->power[1] + w * (2.0 * f->power[2] + w * 3.0 * f->power[3]);
}

/* The mean from 0 to w. */
static inline double reference_mean_before(const ReferenceCurve *f, double w)
{
    const double *p = f->power;
    return p[0] + w * (p[1] / 2.0 + w * (p[2] / 3.0 + w * p[3] / 4.0));
}

/* The mean over the whole range. */
static inline double reference_mean(const double b[4])
{
    return b[0] + 0.25 * ((b[1] - b[0]) + (b[2] - b[0]) + (b[3] - b[0]));
}

/* Writes 0, the turning points inside (0, 1) in order, and 1; returns how many. Between two
 * neighbours the cubic is monotone. */
static inline int reference_monotone_ends(const ReferenceCurve *f, double ends[REFERENCE_ENDS])
{
    double d0 = f->bernstein[1] - f->bernstein[0];
    double d1 = f->bernstein[2] - f->bernstein[1];
    double d2 = f->bernstein[3] - f->bernstein[2];
    int count = 1;
    ends[0] = 0.0;
    double largest = fmax(fabs(d0), fmax(fabs(d1), fabs(d2)));
    int monotone = (d0 >= 0.0 && d1 >= 0.0 && d2 >= 0.0) || (d0 <= 0.0 && d1 <= 0.0 && d2 <= 0.0);
    if (!monotone) {
        d0 /= largest;
        d1 /= largest;
        d2 /= largest;
        double a = d0 - 2.0 * d1 + d2, b = 2.0 * (d1 - d0);
        double discriminant = b * b - 4.0 * a * d0;
        if (discriminant > 0.0) {
            double q = -0.5 * (b + copysign(sqrt(discriminant), b));
            double first = q / a, second = d0 / q; /* inf or NaN where a or q is 0: no root there */
            double lower = fmin(first, second), upper = fmax(first, second);
            if (lower > 0.0 && lower < 1.0)
                ends[count++] = lower;
            if (upper > 0.0 && upper < 1.0 && upper > ends[count - 1])
                ends[count++] = upper;
        }
    }
    ends[count++] = 1.0;
    return count;
}

#else
#include "reference_spline.h"
#endif

/* Where the curve takes `value` between low and high, on which it is monotone and which bracket
 * the value: Newton's step where it stays inside the bracket, else bisection. */
static inline double reference_crossing(const ReferenceCurve *f, double value, double low,
                                        double high, int rising)
{
    double w = 0.5 * (low + high);
    for (int i = 0; i < 100; ++i) {
        double miss = reference_curve(f, w) - value;
        if (miss == 0.0)
            return w;
        if ((miss < 0.0) == (rising != 0))
            low = w;
        else
            high = w;
        double next = w - miss / reference_curve_slope(f, w);
        if (!(next > low && next < high))
            next = 0.5 * (low + high);
        if (fabs(next - w) <= 2e-16 || next == low || next == high)
            return next;
        w = next;
    }
    return w;
}

#endif
