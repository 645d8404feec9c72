/* Take the spots nearest to a predicted pose. */
#ifndef VERIFY_CORRESPONDENCE_SPOTS_H
#define VERIFY_CORRESPONDENCE_SPOTS_H

#include "verify/measurement/correspondence/kernels/fit.h"

/* Take the spots nearest to a predicted pose (4, 4), where nothing else was found.
 *
 * `sigmas` (3,): the pose's standard uncertainty, m and rad, and that of the shift, px; `bounds`
 * (4 n + 1,): the greatest chi^2, by degrees of freedom. Filled: `state` (85,) and `spot` (2, n),
 * -1 for none. Gives 1, or 0 where what was taken is not likely. */
int64_t follow_alone(const Scene *scene, const double *rig_T_flange, const double *sigmas,
                     const double *bounds, double *state, int64_t *spot);

#endif
