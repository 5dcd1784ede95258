/* The energy budget: where the weight of paths ends.
 *
 * Every path starts with a weight of 1, and every bit of it ends in one of the terminations (the enum
 * Termination, in cloudtomo_cl/layout.py): the audit compares their sum with the number of paths. */
#ifndef CLOUDTOMO_BUDGET_H
#define CLOUDTOMO_BUDGET_H

#include "walk/accumulate.h"

/* WEIGHT_UNIT: fixed-point units of a weight of 1. Work groups add into one of BUDGET_COPIES copies of
 * the sums, lest all wait for one address. Both from cloudtomo_cl/layout.py. */
typedef struct {
    /* Volatile, so that they stay in memory: an event adds to one or two, and GPUs lack registers. */
    volatile float absorbed; /* weight, by droplets and molecules */
    volatile float surface;  /* weight, by the surface */
    volatile float killed;   /* less the weight that survived roulettes have given */
    volatile float killed_variance;
    volatile float truncated;            /* radiance, sr^-1 */
    volatile __global Accumulator *sums; /* [copy][Termination] */
} Budget;

inline Budget empty_budget(volatile __global Accumulator *sums)
{
    const Budget budget = {0.0f, 0.0f, 0.0f, 0.0f, 0.0f, sums};
    return budget;
}

inline void budget_absorption(Budget *budget, bool by_surface, float weight)
{
    if (by_surface)
        budget->surface += weight;
    else
        budget->absorbed += weight;
}

/* A roulette between `throughput` and `raised`, or nothing. */
inline void budget_roulette(Budget *budget, float throughput, float raised, bool survives)
{
    budget->killed_variance += throughput * (raised - throughput);
    if (survives)
        budget->killed -= raised - throughput;
}

/* Closes the budget of a path that ended with a throughput. */
inline void budget_termination(const Budget *budget, Termination termination, float throughput)
{
    volatile __global Accumulator *sums = budget->sums + (get_group_id(0) % BUDGET_COPIES) * TERMINATIONS;
    accumulate(sums + TERMINATION_LAUNCHED, WEIGHT_UNIT);
    accumulate(sums + termination, throughput * WEIGHT_UNIT);
    if (budget->absorbed != 0.0f)
        accumulate(sums + TERMINATION_ABSORBED, budget->absorbed * WEIGHT_UNIT);
    if (budget->surface != 0.0f)
        accumulate(sums + TERMINATION_SURFACE, budget->surface * WEIGHT_UNIT);
    if (budget->killed_variance != 0.0f) {
        accumulate(sums + TERMINATION_KILLED, budget->killed * WEIGHT_UNIT);
        accumulate(sums + TERMINATION_KILLED_VARIANCE, budget->killed_variance * WEIGHT_UNIT);
    }
    if (budget->truncated != 0.0f)
        accumulate(sums + TERMINATION_TRUNCATED, budget->truncated * WEIGHT_UNIT);
}

#endif
