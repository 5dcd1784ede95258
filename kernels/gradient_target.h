/* Where derivatives go that make up the gradient of a cost. */
#ifndef CLOUDTOMO_GRADIENT_TARGET_H
#define CLOUDTOMO_GRADIENT_TARGET_H

#include "walk/accumulate.h"

typedef struct {
    float adjoint; /* derivative of the cost with respect to the path's radiance, scaled */
    volatile __global Accumulator *gradient; /* [x][y][z] */
} Target;

inline void deposit(const Target *target, int index, float derivative)
{
    accumulate(target->gradient + index, target->adjoint * derivative);
}

#endif
