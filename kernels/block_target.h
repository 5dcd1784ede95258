/* Where derivatives go that are summed over blocks of pixels and voxels. */
#ifndef CLOUDTOMO_BLOCK_TARGET_H
#define CLOUDTOMO_BLOCK_TARGET_H

#include "walk/accumulate.h"

typedef struct {
    volatile __global Accumulator *sums; /* [block]: of the pixel's block, units of DERIVATIVE_UNIT per sr^-1 km */
    const __global int *column;          /* of every voxel of the grid, or -1 */
    const __global int *block;           /* of every column */
} Target;

inline void deposit(const Target *target, int index, float derivative)
{
    const int column = target->column[index];
    if (column >= 0)
        accumulate(target->sums + target->block[column], DERIVATIVE_UNIT * derivative);
}

#endif
