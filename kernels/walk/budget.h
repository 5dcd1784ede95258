/* The energy budget: where the weight of paths ends.
 *
 * Every path starts with a weight of 1, and every bit of it ends in one of the terminations (the enum
 * Termination, in cloudtomo_cl/opencl/layout.py): the audit compares their sum with the number of paths. */
#ifndef CLOUDTOMO_BUDGET_H
#define CLOUDTOMO_BUDGET_H

#include "walk/accumulate.h"
#include "walk/kept.h"

/* WEIGHT_UNIT: fixed-point units of a weight of 1. Work groups add into one of BUDGET_COPIES copies of
 * the sums, lest all wait for one address. Both from cloudtomo_cl/opencl/layout.py. On GPUs, where an atomic sum of
 * every path would bound them, a group adds up its own first.
 *
 *   GROUP_BUDGET(name, sums)            declares what paths of a group add to, in a kernel; not in a branch
 *   close_group_budget(name, sums)      when all its paths have ended */
#ifdef CLOUDTOMO_REGENERATES
#define SUM_SPACE __local
#define ADD_UNITS add_units_in_group
#include "walk/add_fixed_point.h"
typedef volatile __local Accumulator *BudgetSums; /* [Termination] */
#define add_to_budget add_units_in_group
#define GROUP_BUDGET(name, sums) \
    __local Accumulator name[TERMINATIONS]; \
    clear_group_budget(name)

inline void clear_group_budget(volatile __local Accumulator *group)
{
    for (uint n = get_local_id(0); n < TERMINATIONS; n += get_local_size(0))
        group[n] = 0;
    barrier(CLK_LOCAL_MEM_FENCE);
}

inline void close_group_budget(volatile __local Accumulator *group, volatile __global Accumulator *sums)
{
    volatile __global Accumulator *copy = sums + (get_group_id(0) % BUDGET_COPIES) * TERMINATIONS;
    barrier(CLK_LOCAL_MEM_FENCE);
    for (uint n = get_local_id(0); n < TERMINATIONS; n += get_local_size(0)) {
        const Accumulator sum = group[n];
        add_units(copy + n, is_addend(sum) ? sum : OVERFLOWN);
    }
}
#else
typedef volatile __global Accumulator *BudgetSums; /* [Termination] */
#define add_to_budget add_units
#define GROUP_BUDGET(name, sums) BudgetSums name = sums + (get_group_id(0) % BUDGET_COPIES) * TERMINATIONS
inline void close_group_budget(BudgetSums group, volatile __global Accumulator *sums) {}
#endif

typedef struct {
    /* Volatile, so that they stay in memory: an event adds to one or two, and GPUs lack registers. */
    volatile float absorbed; /* weight, by droplets and molecules */
    volatile float surface;  /* weight, by the surface */
    volatile float killed;   /* less the weight that survived roulettes have given */
    volatile float killed_variance;
    volatile float truncated; /* radiance, sr^-1 */
} Budget;

inline void clear_budget(KEPT Budget *budget)
{
    budget->absorbed = 0.0f;
    budget->surface = 0.0f;
    budget->killed = 0.0f;
    budget->killed_variance = 0.0f;
    budget->truncated = 0.0f;
}

inline void budget_absorption(KEPT Budget *budget, bool by_surface, float weight)
{
    if (by_surface)
        budget->surface += weight;
    else
        budget->absorbed += weight;
}

/* A roulette between `throughput` and `raised`, or nothing. */
inline void budget_roulette(KEPT Budget *budget, float throughput, float raised, bool survives)
{
    budget->killed_variance += throughput * (raised - throughput);
    if (survives)
        budget->killed -= raised - throughput;
}

/* Adds the budget of a path that ended with a throughput. */
inline void budget_termination(const KEPT Budget *budget, Termination termination, float throughput, BudgetSums sums)
{
    add_to_budget(sums + TERMINATION_LAUNCHED, units_of(WEIGHT_UNIT));
    add_to_budget(sums + termination, units_of(throughput * WEIGHT_UNIT));
    if (budget->absorbed != 0.0f)
        add_to_budget(sums + TERMINATION_ABSORBED, units_of(budget->absorbed * WEIGHT_UNIT));
    if (budget->surface != 0.0f)
        add_to_budget(sums + TERMINATION_SURFACE, units_of(budget->surface * WEIGHT_UNIT));
    if (budget->killed_variance != 0.0f) {
        add_to_budget(sums + TERMINATION_KILLED, units_of(budget->killed * WEIGHT_UNIT));
        add_to_budget(sums + TERMINATION_KILLED_VARIANCE, units_of(budget->killed_variance * WEIGHT_UNIT));
    }
    if (budget->truncated != 0.0f)
        add_to_budget(sums + TERMINATION_TRUNCATED, units_of(budget->truncated * WEIGHT_UNIT));
}

#endif
