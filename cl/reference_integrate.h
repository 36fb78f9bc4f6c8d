/* Emission and absorption along one ray, piece by piece, to a tolerance.
 *
 * Volume rendering integral: C = int c tau exp(-D) dt, D(t) = int tau, A = 1 - exp(-D). On a piece
 * where colour and opacity are linear in one parameter p (0...1 between two control points),
 *     C_piece = c_a (1 - exp(-D)) + (c_1 - c_0) int (p - p_a) tau exp(-D) dt,
 * where a is the piece's front: one scalar integral serves three channels, a constant colour needs
 * none, and where p hardly changes no accuracy of it is needed.
 *
 * Error control: each piece is integrated by a Gauss-Kronrod pair (G3/K7, then G7/K15, then
 * bisected); the estimate is the difference of the pair in D and in the colour integral, plus the
 * miss in the identity int tau exp(-D) dt = 1 - exp(-D), which catches a spike that both rules
 * step over. The estimate is weighted by what is left of the light. A piece may miss by the
 * tolerance's share of its length; a thousandth of the tolerance is granted to any piece, since next to a
 * logarithmic singularity (opacity 1) no error proportional to the length can be had. Where the
 * rounding of the field's value alone, through a steep or nearly opaque stretch of the transfer
 * function, makes up the estimate, halving is of no use and is not tried. All accepted estimates
 * are summed for the caller, and pieces that missed their share are counted.
 */
#ifndef REFERENCE_INTEGRATE_H
#define REFERENCE_INTEGRATE_H

#include "reference_field.h"
#include "reference_rules.h"
#include "reference_transfer.h"

#define REFERENCE_MAX_DEPTH 64
#define REFERENCE_MAX_SPLITS 200000u /* bisections a ray: the bound on its work */
#define REFERENCE_LN2 0.693147180559945309

typedef struct {
    double optical_depth, transmittance;
    double color[3];
    double median;           /* world distance where the opacity reaches one half */
    double error;            /* sum of the accepted estimates */
    double error_per_length; /* allowed, world length */
    double error_floor;      /* allowed for any piece */
    double opacity_unit;
    uint samples, pieces, splits, failed;
} ReferenceRay;

static inline double reference_error_allowed(const ReferenceRay *ray, double length)
{
    return fmax(ray->error_per_length * length, ray->error_floor);
}

static inline int reference_may_split(const ReferenceRay *ray, int top, double a, double middle,
                                      double b)
{
    return top + 1 < REFERENCE_MAX_DEPTH && middle > a && middle < b
        && ray->splits < REFERENCE_MAX_SPLITS;
}

static inline void reference_absorb(ReferenceRay *ray, double optical_depth)
{
    ray->optical_depth += optical_depth;
    ray->transmittance = exp(-ray->optical_depth);
    ray->pieces += 1;
}

static inline int reference_holds_median(const ReferenceRay *ray, double optical_depth)
{
    return isinf(ray->median) && ray->optical_depth + optical_depth >= REFERENCE_LN2;
}

static inline void reference_add_opaque(ReferenceRay *ray, const double color[3], double t)
{
    for (int k = 0; k < 3; ++k)
        ray->color[k] += ray->transmittance * color[k];
    ray->median = fmin(ray->median, t);
    ray->optical_depth = INFINITY;
    ray->transmittance = 0.0;
    ray->pieces += 1;
}

/* Constant colour and extinction (of one opacity unit) from t_front over `length`. */
static inline void reference_add_constant(ReferenceRay *ray, double extinction,
                                          const double color[3], double t_front, double length)
{
    double optical_depth = extinction * (length / ray->opacity_unit);
    double opacity = -expm1(-optical_depth);
    if (reference_holds_median(ray, optical_depth))
        ray->median = t_front
            + length * clamp((REFERENCE_LN2 - ray->optical_depth) / optical_depth, 0.0, 1.0);
    for (int k = 0; k < 3; ++k)
        ray->color[k] += ray->transmittance * opacity * color[k];
    reference_absorb(ray, optical_depth);
}

/* ---- classified after interpolation ------------------------------------------------------ */

/* One Gauss-Kronrod pair on [a, b] of the curve's range; returns the error estimate of what the
 * piece adds behind unit transmittance. `scale`: opacity units in the curve's whole range. */
#define REFERENCE_DEFINE_RULE(K, G, N, M, PAD, GPAD)                                               \
    static inline double reference_rule_##K(const ReferenceCurve *f,                               \
                                            const ReferenceRegion *region,                         \
                                            double a, double b, double scale, double front_place,  \
                                            double *optical_depth, double *moment)                 \
    {                                                                                              \
        double place[N], density[N], depth[PAD], gauss_depth[GPAD];                                \
        double width = b - a, total = 0.0, gauss_total = 0.0, spread = 0.0;                        \
        for (int i = 0; i < N; ++i) {                                                              \
            place[i] = reference_region_place(region,                                              \
                reference_curve(f, a + width * reference_##K##_node[i]));                          \
            density[i] = width * scale * reference_region_extinction(region, place[i]);            \
            total += reference_##K##_weight[i] * density[i];                                       \
            place[i] -= front_place;                                                               \
            spread = fmax(spread, fabs(place[i]));                                                 \
        }                                                                                          \
        for (int j = 0; j < M; ++j)                                                                \
            gauss_total += reference_##G##_weight[j] * density[2 * j + 1];                         \
        *optical_depth = total;                                                                    \
        *moment = 0.0;                                                                             \
        double depth_error = fabs(total - gauss_total);                                            \
        double error = exp(-fmax(total - depth_error, 0.0)) * fmin(depth_error, 1.0);              \
        if (region->color_change == 0.0)                                                           \
            return error;                                                                          \
        for (int i = 0; i < PAD; ++i)                                                              \
            depth[i] = 0.0;                                                                        \
        for (int j = 0; j < N; ++j)                                                                \
            for (int i = 0; i < PAD; ++i)                                                          \
                depth[i] += reference_##K##_antiderivative[PAD * j + i] * density[j];              \
        for (int i = 0; i < GPAD; ++i)                                                             \
            gauss_depth[i] = 0.0;                                                                  \
        for (int j = 0; j < M; ++j)                                                                \
            for (int i = 0; i < GPAD; ++i)                                                         \
                gauss_depth[i] +=                                                                  \
                    reference_##G##_antiderivative[GPAD * j + i] * density[2 * j + 1];             \
        double identity = 0.0, gauss_moment = 0.0;                                                 \
        for (int i = 0; i < N; ++i) {                                                              \
            double light = reference_##K##_weight[i] * density[i] * exp(-fmax(depth[i], 0.0));     \
            identity += light;                                                                     \
            *moment += light * place[i];                                                           \
        }                                                                                          \
        for (int j = 0; j < M; ++j)                                                                \
            gauss_moment += reference_##G##_weight[j] * density[2 * j + 1] * place[2 * j + 1]      \
                * exp(-fmax(gauss_depth[j], 0.0));                                                 \
        return error + region->color_change                                                        \
            * (fabs(*moment - gauss_moment) + spread * fabs(identity + expm1(-total)));            \
    }

REFERENCE_DEFINE_RULE(K7, G3, 7, 3, 8, 4)
REFERENCE_DEFINE_RULE(K15, G7, 15, 7, 16, 8)

static inline double reference_optical_depth(const ReferenceCurve *f,
                                             const ReferenceRegion *region, double a, double b,
                                             double scale)
{
    double total = 0.0;
    for (int i = 0; i < 15; ++i) {
        double s = reference_curve(f, a + (b - a) * reference_K15_node[i]);
        total += reference_K15_weight[i]
            * reference_region_extinction(region, reference_region_place(region, s));
    }
    return (b - a) * scale * total;
}

/* Where in [a, b] the optical depth from a reaches `target`: Newton's step inside a shrinking
 * bracket whose near end carries the depth already passed. */
static inline double reference_find_depth(const ReferenceCurve *f, const ReferenceRegion *region,
                                          double a, double b, double scale, double target)
{
    double low = a, high = b, w = 0.5 * (a + b);
    for (int i = 0; i < 100; ++i) {
        double passed = reference_optical_depth(f, region, low, w, scale);
        double miss = target - passed;
        if (miss > 0.0) {
            low = w;
            target = miss;
        } else {
            high = w;
        }
        double slope = scale
            * reference_region_extinction(region,
                                          reference_region_place(region, reference_curve(f, w)));
        double next = w + miss / slope;
        if (!(next > low && next < high))
            next = 0.5 * (low + high);
        if (fabs(next - w) <= 1e-15 || next == low || next == high)
            return next;
        w = next;
    }
    return w;
}

/* What rounding of the field's value near w does to what `amount` opacity units of `optical_depth`
 * show: d(-log q) = dq / q, and of a deep piece only the first unit of depth is seen. */
static inline double reference_rounding(const ReferenceCurve *f, const ReferenceRegion *region,
                                        double w, double amount, double optical_depth)
{
    const double *b = f->bernstein;
    double value = 0.0;
    for (int i = 0; i <= REFERENCE_DEGREE; ++i)
        value = fmax(value, fabs(b[i]));
    double place = reference_region_place(region, reference_curve(f, w));
    double clearness = (1.0 - place) * region->clearness_0 + place * region->clearness_1;
    double rounding = fmin(REFERENCE_ROUNDING * value / region->gap, 1.0)
        * fabs(region->clearness_1 - region->clearness_0);
    return amount * rounding / (fmax(clearness, DBL_MIN) * fmax(optical_depth, 1.0));
}

/* Adds the part [from, to] of a cell's curve, on which the value stays in one region.
 * t_front, length: world distance of the curve's 0 and the length of its whole range. */
static inline void reference_add_smooth(ReferenceRay *ray, const ReferenceCurve *f, double from,
                                        double to, const ReferenceRegion *region, double t_front,
                                        double length)
{
    double scale = length / ray->opacity_unit;
    double far_end[REFERENCE_MAX_DEPTH];
    int top = 0;
    double a = from;
    far_end[0] = to;
    while (top >= 0) {
        double b = far_end[top], optical_depth, moment;
        double allowed = reference_error_allowed(ray, length * (b - a));
        double front_place = reference_region_place(region, reference_curve(f, a));
        double error = ray->transmittance
            * reference_rule_K7(f, region, a, b, scale, front_place, &optical_depth, &moment);
        ray->samples += 7;
        if (!(error <= allowed)) {
            error = ray->transmittance
                * reference_rule_K15(f, region, a, b, scale, front_place, &optical_depth, &moment);
            ray->samples += 15;
        }
        if (!(error <= allowed)) {
            double middle = 0.5 * (a + b);
            if (reference_may_split(ray, top, a, middle, b)
                && error > ray->transmittance
                        * reference_rounding(f, region, middle, scale * (b - a), optical_depth)) {
                far_end[++top] = middle;
                ray->splits += 1;
                continue;
            }
            ray->failed += 1;
        }
        ray->error += error;
        if (reference_holds_median(ray, optical_depth))
            ray->median = t_front + length
                * reference_find_depth(f, region, a, b, scale,
                                       REFERENCE_LN2 - ray->optical_depth);
        double opacity = -expm1(-optical_depth);
        for (int k = 0; k < 3; ++k)
            ray->color[k] += ray->transmittance
                * (opacity * (region->color_0[k] + front_place * region->color_step[k])
                   + moment * region->color_step[k]);
        reference_absorb(ray, optical_depth);
        if (ray->transmittance < ray->error_floor)
            return;
        a = b;
        --top;
    }
}

/* Adds the part [from, to] on which the value stays in region r. */
static inline void reference_add_region(ReferenceRay *ray, const ReferenceTransfer *tf,
                                        const ReferenceCurve *f, double from, double to, int r,
                                        double t_front, double length)
{
    ReferenceRegion region;
    if (!(to > from) || !reference_any_visible(tf, r, r))
        return;
    reference_load_region(tf, r, &region);
    if (region.is_transparent)
        return;
    if (region.is_opaque || region.is_constant) {
        double color[3];
        double place = reference_region_place(&region, reference_curve(f, from));
        for (int k = 0; k < 3; ++k)
            color[k] = region.color_0[k] + place * region.color_step[k];
        ray->samples += 1;
        if (region.is_opaque)
            reference_add_opaque(ray, color, t_front + from * length);
        else
            reference_add_constant(ray, reference_region_extinction(&region, 0.0), color,
                                   t_front + from * length, (to - from) * length);
        return;
    }
    reference_add_smooth(ray, f, from, to, &region, t_front, length);
}

/* Adds `length` of one and the same value. */
static inline void reference_add_value(ReferenceRay *ray, const ReferenceTransfer *tf, double s,
                                       double t_front, double length)
{
    int r = reference_region_above(tf, s);
    ReferenceRegion region;
    if (!reference_any_visible(tf, r, r))
        return;
    reference_load_region(tf, r, &region);
    double place = reference_region_place(&region, s), color[3];
    for (int k = 0; k < 3; ++k)
        color[k] = region.color_0[k] + place * region.color_step[k];
    ray->samples += 1;
    double clearness = (1.0 - place) * region.clearness_0 + place * region.clearness_1;
    if (clearness == 0.0)
        reference_add_opaque(ray, color, t_front);
    else
        reference_add_constant(ray, reference_region_extinction(&region, place), color, t_front,
                               length);
}

/* Splits a cell's curve where it crosses control points and adds the pieces in order. */
static inline void reference_add_curve(ReferenceRay *ray, const ReferenceTransfer *tf,
                                       ReferenceCurve *f, double t_front, double length)
{
    const double *b = f->bernstein;
    double smallest = b[0], largest = b[0];
    for (int i = 1; i <= REFERENCE_DEGREE; ++i) {
        smallest = fmin(smallest, b[i]);
        largest = fmax(largest, b[i]);
    }
    if (smallest == largest) {
        reference_add_value(ray, tf, smallest, t_front, length);
        return;
    }
    int first = reference_region_above(tf, smallest), last = reference_region_above(tf, largest);
    if (!reference_any_visible(tf, first, last))
        return;
    reference_prepare(f);
    if (first == last) {
        reference_add_region(ray, tf, f, 0.0, 1.0, first, t_front, length);
        return;
    }
    double ends[REFERENCE_ENDS];
    int count = reference_monotone_ends(f, ends);
    for (int m = 0; m + 1 < count; ++m) {
        double place = ends[m], end = ends[m + 1];
        double front = m == 0 ? b[0] : reference_curve(f, place);
        double back = m + 2 == count ? b[REFERENCE_DEGREE] : reference_curve(f, end);
        int rising = back > front;
        int r = rising ? reference_region_above(tf, front) : reference_region_below(tf, front);
        while (place < end && ray->transmittance >= ray->error_floor) {
            int inside = rising ? (r == tf->count || tf->value[r] >= back)
                                : (r == 0 || tf->value[r - 1] <= back);
            double next = end;
            if (!inside)
                next = reference_crossing(f, tf->value[rising ? r : r - 1], place, end, rising);
            reference_add_region(ray, tf, f, place, next, r, t_front, length);
            if (inside)
                break;
            place = next;
            r += rising ? 1 : -1;
        }
        if (ray->transmittance < ray->error_floor)
            return;
    }
}

/* ---- classified before interpolation ----------------------------------------------------- */

/* Extinction (of one opacity unit) and emission along a segment, in Bernstein form. */
typedef struct {
    double extinction[REFERENCE_DEGREE + 1];
    double emission[3][REFERENCE_DEGREE + 1];
} ReferenceMedium;

/* G7/K15 on [a, b]; the optical depth is exact, a polynomial. Returns the error estimate. */
static inline double reference_rule_medium(const ReferenceMedium *whole, double a, double b,
                                           double scale, double *optical_depth, double color[3])
{
    ReferenceCurve extinction, emission[3];
    double amount = scale * (b - a);
    reference_restrict(whole->extinction, a, b, extinction.bernstein);
    reference_prepare(&extinction);
    *optical_depth = amount * reference_mean(extinction.bernstein);
    double gauss[3], identity = 0.0;
    for (int k = 0; k < 3; ++k) {
        reference_restrict(whole->emission[k], a, b, emission[k].bernstein);
        reference_prepare(&emission[k]);
        color[k] = gauss[k] = 0.0;
    }
    for (int i = 0; i < 15; ++i) {
        double x = reference_K15_node[i];
        double depth = amount * x * reference_mean_before(&extinction, x);
        double light = amount * exp(-fmax(depth, 0.0));
        identity += reference_K15_weight[i] * light * reference_curve(&extinction, x);
        for (int k = 0; k < 3; ++k) {
            double emitted = light * reference_curve(&emission[k], x);
            color[k] += reference_K15_weight[i] * emitted;
            if (i & 1)
                gauss[k] += reference_G7_weight[i >> 1] * emitted;
        }
    }
    double error = fabs(identity + expm1(-*optical_depth));
    for (int k = 0; k < 3; ++k)
        error = fmax(error, fabs(color[k] - gauss[k]));
    return error;
}

static inline double reference_find_medium_depth(const ReferenceMedium *medium, double scale,
                                                 double a, double b, double target)
{
    double low = a, high = b;
    for (int i = 0; i < 200 && high - low > 1e-16; ++i) {
        double middle = 0.5 * (low + high), e[REFERENCE_DEGREE + 1];
        if (middle == low || middle == high)
            break;
        reference_restrict(medium->extinction, low, middle, e);
        double passed = scale * (middle - low) * reference_mean(e);
        if (passed < target) {
            low = middle;
            target -= passed;
        } else {
            high = middle;
        }
    }
    return high;
}

static inline void reference_add_medium(ReferenceRay *ray, const ReferenceMedium *medium,
                                        double t_front, double length)
{
    double scale = length / ray->opacity_unit;
    double far_end[REFERENCE_MAX_DEPTH];
    int top = 0;
    double a = 0.0;
    far_end[0] = 1.0;
    while (top >= 0) {
        double b = far_end[top], optical_depth, color[3];
        double allowed = reference_error_allowed(ray, length * (b - a));
        double error = ray->transmittance
            * reference_rule_medium(medium, a, b, scale, &optical_depth, color);
        ray->samples += 15;
        if (!(error <= allowed)) {
            double middle = 0.5 * (a + b);
            if (reference_may_split(ray, top, a, middle, b)) {
                far_end[++top] = middle;
                ray->splits += 1;
                continue;
            }
            ray->failed += 1;
        }
        ray->error += error;
        if (reference_holds_median(ray, optical_depth))
            ray->median = t_front + length
                * reference_find_medium_depth(medium, scale, a, b,
                                              REFERENCE_LN2 - ray->optical_depth);
        for (int k = 0; k < 3; ++k)
            ray->color[k] += ray->transmittance * color[k];
        reference_absorb(ray, optical_depth);
        if (ray->transmittance < ray->error_floor)
            return;
        a = b;
        --top;
    }
}

/* Classifies a cell's voxels (of finite values) and adds the segment low -> high. A voxel of
 * opacity 1 makes the whole open segment opaque; its colour is the limit of emission over
 * extinction at the segment's front, where the opaque voxels alone count. */
static inline void reference_add_classified(ReferenceRay *ray, const ReferenceTransfer *tf,
                                            const double tap[REFERENCE_TAPS],
                                            const double low[3],
                                            const double high[3], double t_front, double length)
{
    double extinction[REFERENCE_TAPS], emission[3][REFERENCE_TAPS], opaque[REFERENCE_TAPS];
    int any_visible = 0, any_opaque = 0;
    for (int i = 0; i < REFERENCE_TAPS; ++i) {
        ReferenceRegion region;
        reference_load_region(tf, reference_region_above(tf, tap[i]), &region);
        double place = reference_region_place(&region, tap[i]);
        double clearness = (1.0 - place) * region.clearness_0 + place * region.clearness_1;
        opaque[i] = clearness == 0.0 ? 1.0 : 0.0;
        extinction[i] = clearness == 0.0 ? 1.0 : reference_region_extinction(&region, place);
        for (int k = 0; k < 3; ++k)
            emission[k][i] =
                (region.color_0[k] + place * region.color_step[k]) * extinction[i];
        any_opaque |= clearness == 0.0;
        any_visible |= extinction[i] > 0.0;
    }
    if (!any_visible)
        return;
    ReferenceMedium medium;
    if (any_opaque)
        for (int i = 0; i < REFERENCE_TAPS; ++i) {
            extinction[i] = opaque[i];
            for (int k = 0; k < 3; ++k)
                emission[k][i] *= opaque[i];
        }
    reference_blossom(extinction, low, high, medium.extinction);
    for (int k = 0; k < 3; ++k)
        reference_blossom(emission[k], low, high, medium.emission[k]);
    if (!any_opaque) {
        reference_add_medium(ray, &medium, t_front, length);
        return;
    }
    int i = 0;
    while (i < REFERENCE_DEGREE && !(medium.extinction[i] > 0.0))
        ++i;
    double color[3];
    for (int k = 0; k < 3; ++k)
        color[k] = medium.emission[k][i] / medium.extinction[i];
    ray->samples += 1;
    reference_add_opaque(ray, color, t_front);
}

#endif
