/* The transfer function, exactly: opacity and colour linear between control points.
 *
 * Region r of n + 1 lies between control points r - 1 and r; region 0 lies below the first and
 * region n above the last, with the end points' values. Two points that share a value are a step:
 * the region between them is empty, so at exactly that value the later point holds.
 */
#ifndef REFERENCE_TRANSFER_H
#define REFERENCE_TRANSFER_H

typedef struct {
    __global const double *value;      /* [count], ascending */
    __global const double *opacity;    /* [count], 0...1 */
    __global const double *clearness;  /* [count], 1 - opacity */
    __global const double *color;      /* [count][3], linear light */
    __global const int *visible_below; /* [count + 2]: how many of regions 0 ... r - 1 show */
    int count;
} ReferenceTransfer;

typedef struct {
    double front_value, gap; /* values front_value ... front_value + gap; gap 0: constant */
    double opacity_0, opacity_1;
    double clearness_0, clearness_1;
    double color_0[3], color_step[3];
    double color_change; /* largest |color_step| */
    int is_constant, is_transparent, is_opaque;
} ReferenceRegion;

/* The region that holds s and values just above it. */
static inline int reference_region_above(const ReferenceTransfer *tf, double s)
{
    int low = 0, high = tf->count;
    while (low < high) {
        int middle = (low + high) >> 1;
        if (tf->value[middle] <= s)
            low = middle + 1;
        else
            high = middle;
    }
    return low;
}

/* The region that holds values just below s. */
static inline int reference_region_below(const ReferenceTransfer *tf, double s)
{
    int low = 0, high = tf->count;
    while (low < high) {
        int middle = (low + high) >> 1;
        if (tf->value[middle] < s)
            low = middle + 1;
        else
            high = middle;
    }
    return low;
}

static inline int reference_any_visible(const ReferenceTransfer *tf, int first, int last)
{
    return tf->visible_below[last + 1] != tf->visible_below[first];
}

static inline void reference_load_region(const ReferenceTransfer *tf, int r,
                                         ReferenceRegion *region)
{
    int a = max(r - 1, 0), b = min(r, tf->count - 1);
    region->front_value = tf->value[a];
    region->gap = tf->value[b] - tf->value[a];
    region->opacity_0 = tf->opacity[a];
    region->opacity_1 = tf->opacity[b];
    region->clearness_0 = tf->clearness[a];
    region->clearness_1 = tf->clearness[b];
    region->color_change = 0.0;
    for (int k = 0; k < 3; ++k) {
        region->color_0[k] = tf->color[3 * a + k];
        region->color_step[k] = tf->color[3 * b + k] - tf->color[3 * a + k];
        region->color_change = fmax(region->color_change, fabs(region->color_step[k]));
    }
    region->is_transparent = region->opacity_0 == 0.0 && region->opacity_1 == 0.0;
    region->is_opaque = region->clearness_0 == 0.0 && region->clearness_1 == 0.0;
    region->is_constant = region->gap == 0.0
        || (region->opacity_0 == region->opacity_1 && region->color_change == 0.0);
}

/* Where s stands in its region, 0 ... 1; clamped, so that rounding never leaves the region. */
static inline double reference_region_place(const ReferenceRegion *region, double s)
{
    return region->gap > 0.0 ? clamp((s - region->front_value) / region->gap, 0.0, 1.0) : 0.0;
}

/* -log(1 - opacity), one unit of length. Below one half log1p keeps small opacities; above, the
 * interpolated 1 - opacity keeps what is left of the light where the opacity is all but 1. At
 * exactly 1 the logarithm is infinite but integrable: a bounded stand-in is enough. */
static inline double reference_region_extinction(const ReferenceRegion *region, double place)
{
    double opacity = region->opacity_0 + place * (region->opacity_1 - region->opacity_0);
    double clearness = (1.0 - place) * region->clearness_0 + place * region->clearness_1;
    return opacity < 0.5 ? -log1p(-opacity) : -log(fmax(clearness, DBL_MIN));
}

#endif
