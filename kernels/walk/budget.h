/* The energy budget: how the weight of paths ends.
 *
 * Every path starts with a weight of 1, and every part of it ends in one of the terminations (the enum
 * Termination, in cloudtomo_cl/opencl/layout.py): the audit compares their sum with the number of paths. */
#ifndef CLOUDTOMO_BUDGET_H
#define CLOUDTOMO_BUDGET_H

#include "walk/accumulate.h"
#include "walk/kept.h"

/* WEIGHT_UNIT: fixed-point units of a weight of 1. Work groups add into one of BUDGET_COPIES copies of
 * the sums, so that they do not all wait for one address. Both are from cloudtomo_cl/opencl/layout.py. On GPUs atomic
 * sums of every path would limit the speed, so that a group first adds up its paths in local memory.
 *
 *   GROUP_BUDGET(name, sums)            declares, in a kernel but in no branch, the sums to which a group's paths add
 *   close_group_budget(name, sums)      is called when all paths of the group have ended */
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
    volatile float absorbed; /* weight absorbed by droplets and molecules */
    volatile float surface;  /* weight absorbed by the surface */
    volatile float
        killed; /* less what survived roulettes have added; and what was left to branches, less what they took */
    volatile float killed_variance; /* variance of the killed weight */
    volatile float truncated;       /* radiance cut off by truncation, sr^-1 */
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

/* Records a roulette that raises `throughput` to `raised`, or ends the path. */
inline void budget_roulette(KEPT Budget *budget, float throughput, float raised, bool survives)
{
    budget->killed_variance += throughput * (raised - throughput);
    if (survives)
        budget->killed -= raised - throughput;
}

/* Records that a path has left the throughput `given` to branches, of which one, or none, has taken `taken`: as a
 * roulette, a game with the mean 0; the square is its variance. */
inline void budget_branch(KEPT Budget *budget, float given, float taken)
{
    budget->killed += given - taken;
    budget->killed_variance += (given - taken) * (given - taken);
}

/* Adds what ended with a throughput: a path, or a branch of one. */
inline void budget_termination(Termination termination, float throughput, BudgetSums sums)
{
    add_to_budget(sums + termination, units_of(throughput * WEIGHT_UNIT));
}

/* Adds the budget of a path that has ended with all its branches. */
inline void budget_path(const KEPT Budget *budget, BudgetSums sums)
{
    add_to_budget(sums + TERMINATION_LAUNCHED, units_of(WEIGHT_UNIT));
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
