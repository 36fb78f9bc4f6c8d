/* How far a ray goes from one sample to the next in a volume of blocks (Ljung 2006, section 3.3), in whole steps.
 *
 * full     1
 * naive    1 / kappa, kappa = samples of the block per axis / its edge in voxels: one step per sample, wherever that
 *          leads
 * limited  min(1 + floor(l), 1 / kappa), l the steps that are left in the block: no farther than the first step in the
 *          next one
 * bounded  min(max(floor(l), 1), n): only single steps cross a face; n the most steps whose error stays within a bound
 *          in that block (`steps`, filled by clvol/transfer/step_bounds.py)
 *
 * Ljung's limit is for samples that stand for their segments. A pre-integrated segment takes the value to run evenly
 * from one end to the other, so a long one across a face would show all that lies between the values of two blocks,
 * over most of the first: there "limited" crosses faces in single steps, too: min(max(floor(l), 1), 1 / kappa).
 */
#ifndef STEP_BLOCKS_H
#define STEP_BLOCKS_H

#include "blocks.h"
#include "classify.h"
#include "features.h"
#include "rays.h"

/* Steps until the ray leaves the block. */
INLINE floatN steps_in_block(const BlockVolume *v, const Rays *ray, const Record *r, floatN t)
{
  const float edge = v->blocks->edge;
  const intN right = MASK(ray->dx > 0.0f), down = MASK(ray->dy > 0.0f), away = MASK(ray->dz > 0.0f);
  const floatN tx = (edge * TO_FLOAT(r->x - right) - ray->x0) * ray->rx + ray->px;
  const floatN ty = (edge * TO_FLOAT(r->y - down) - ray->y0) * ray->ry + ray->py;
  const floatN tz = (edge * TO_FLOAT(r->z - away) - ray->z0) * ray->rz + ray->pz;
  return lane_min(lane_min(tx, ty), tz) - t;
}

/* From a place in block `r`, t steps along the ray. */
INLINE floatN steps_at_once(const BlockVolume *v, const Rays *ray, const Record *r, floatN t)
{
#if STEPPING == STEPPING_FULL
  return 1.0f;
#else
#if STEPPING == STEPPING_BOUNDED
  const intN block = (r->z * v->blocks->count.y + r->y) * v->blocks->count.x + r->x;
  const floatN most = TO_FLOAT(AS_INT(gather1(v->steps, block) & 255u));
#else
  const intN code = code_of(r), coarse = select(code, (intN)1, MASK(code == CODE_DROPPED));
  const floatN most = TO_FLOAT((intN)1 << (v->blocks->log_edge + 1 - coarse));
#endif
#if STEPPING == STEPPING_NAIVE
  return most;
#else
  const floatN left = lane_clamp(steps_in_block(v, ray, r, t), (floatN)0.0f, (floatN)255.0f);
  const float beyond = STEPPING == STEPPING_LIMITED && MIDPOINTS ? 1.0f : 0.0f;
  return lane_max(lane_min(beyond + floor(left), most), (floatN)1.0f);
#endif
#endif
}

#endif
